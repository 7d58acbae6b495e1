"""Slow growth of cracks: the most stretched bond breaks first, one event after the other.

The body is linear between events, so each state of damage has one load at which the next bond is at
its limit; what a growing crack spends follows from the largest of them (theory, C7).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from warp_peri.damage.cut_solid import CutSolid, westergaard
from warp_peri.damage.lattice_body import LatticeBody, box, cracked, lattice_body
from warp_peri.damage.operator import unit_toughness
from warp_peri.damage.solid import check_breakable, check_no_fail
from warp_peri.dynamics.motion import Motion
from warp_peri.errors import InputError
from warp_peri.lps.model import Model
from warp_peri.points.arrays import check_whole
from warp_peri.points.families import BondClasses

TOGETHER = 1e-6
"""Bonds so close to the most stretched one break with it: mirror images, to rounding."""


def grow(
    model: Model,
    body: LatticeBody,
    held: ArrayLike,
    u: np.ndarray,
    *,
    events: int,
    cracks: Sequence[ArrayLike] = (),
    no_fail: np.ndarray | None = None,
    progress: bool = False,
) -> Motion:
    """Break the most stretched bond, and its mirror images, event by event.

    Args:
        model: positive on the lattice; others are refused.
        body: the body.
        held: components of the displacement that are given, shape [N] or [N, 2] bool.
        u: their values at unit load, shape [N, 2].
        events: how many, fewer when the body comes apart.
        cracks: polylines open from the start.
        no_fail: nodes whose bonds do not break, shape [N] bool.
        progress: shows a bar.

    Returns:
        A motion whose time is the load, the factor of u at which each event's bond breaks, over the
        critical stretch. Its histories are load, energy: elastic at unit load before each event
        [stress · area], and broken: bonds up to it, both directions. The details are the neighbours
        at the end, shape [N, B].

    Raises InputError for a body that CutSolid refuses, and another `no_fail`.
    """
    check_whole("events", events, 1)
    check_breakable(model, body.classes)
    neighbour = cracked(body, cracks)
    xi, r = body.xi, body.r
    safe = check_no_fail(no_fail, len(body.x))
    loads: list[float] = []
    energies, counts = [], []
    start, end = int((neighbour >= 0).sum()), np.zeros_like(body.x)
    for _ in tqdm(range(events), disable=not progress, unit="event"):
        try:
            solid = CutSolid(model, body, held, neighbour=neighbour)
        except InputError:
            if not loads:
                raise
            break  # a piece has come off
        field = solid.solve(None, u)
        reach = field[neighbour] - field[:, None]
        stretch = (xi * reach).sum(axis=-1) / r**2
        stretch[(neighbour < 0) | safe[:, None] | safe[np.maximum(neighbour, 0)]] = -np.inf
        largest = float(stretch.max())
        if not largest > 0:
            break
        loads.append(1 / largest)
        energies.append(solid.energy(field))
        counts.append(start - int((neighbour >= 0).sum()))
        chosen = stretch > largest * (1 - TOGETHER)
        neighbour = np.where(chosen, -1 - neighbour, neighbour)
        end = field * loads[-1]
    history = dict(zip(("load", "energy", "broken"), map(np.array, (loads, energies, counts))))
    return Motion(history["load"], end, None, history, neighbour)


def apparent_toughness(model: Model, spacing: float, *, cells: int = 20, length: int = 3) -> float:
    """What a growing crack spends over the toughness of (C6) behind its critical stretch.

    A central crack in a plane under tension, `cells` spacings from its middle to the collar and 0.4
    of that long to each side, grown by `length` spacings; the largest load of each spacing counts,
    and their mean, with G from the energies. Divide a stretch by the root of this to calibrate it
    (C7). In space the strain is plane, and the front straight: it advances as one, which a bent
    front does not; there this is an upper end.

    Args:
        model: positive on the lattice.
        spacing: h; the ratio of horizon to spacing is what matters.
        cells: from the middle to the collar.
        length: spacings of growth that are averaged.
    """
    h, reach, d = spacing, int(np.ceil(model.horizon / spacing)), model.dimension
    side = 2 * (cells + 2 * reach) * h
    half = round(0.4 * cells) * h
    x = box((side, side, h)[:d], h)
    held = (np.abs(x) > cells * h).any(axis=1)
    u = np.zeros_like(x)
    u[:, :2] = westergaard(x, half, 1.0, model.lam, model.mu)
    crack: list[tuple[float, ...]] = [(-half, 0), (half, 0)]
    if d == 3:  # along the front all layers are alike
        ends = side * np.array([-1.0, 1.0])
        crack = [(tip, 0, z) for tip, z in zip((-half, -half, half, half), [*ends, *ends[::-1]])]
    body = lattice_body(x, h, model.horizon, endless=d == 3)
    events = length * cut_by_spacing(body.classes) + 1  # an event is 4 directed bonds
    growth = grow(model, body, held, u, events=events, cracks=[crack])
    return spent(growth, body.classes, tips=2) / unit_toughness(model, body.classes)


def cut_by_spacing(classes: BondClasses) -> int:
    """Bonds that a straight crack cuts as it grows by a spacing."""
    up = classes.steps[:, 1]
    return int(up[up > 0].sum())


def spent(growth: Motion, classes: BondClasses, *, tips: int) -> float:
    """G at a unit critical stretch of a growth along a row, the mean of each spacing's largest.

    Args:
        growth: of `grow`, by one spacing or more.
        classes: of its body.
        tips: that grow alike.
    """
    grown = growth["broken"] / (2 * tips * cut_by_spacing(classes))  # spacings of each tip
    peaks = []
    for k in range(int(grown[-1])):
        cycle = (grown >= k) & (grown < k + 1)
        ends = np.interp([k, k + 1], grown, growth["energy"])
        area = tips * classes.spacing ** (classes.steps.shape[1] - 1)
        peaks.append(growth.time[cycle].max() ** 2 * (ends[0] - ends[1]) / area)  # at unit load
    return float(np.mean(peaks))
