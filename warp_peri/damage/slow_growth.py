"""Slow growth of cracks: the most stretched bond breaks first, one event after the other.

The body is linear between events, so each state of damage has one load at which the next bond is at
its limit; what a growing crack spends follows from the largest of them (theory, C7).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from warp_peri.damage.cut_solid import CutSolid, westergaard
from warp_peri.damage.lattice_body import LatticeBody, box, cracked, lattice_body
from warp_peri.damage.operator import unit_toughness
from warp_peri.damage.solid import (
    BrittleCrystal,
    CrystalBonds,
    check_breakable,
    check_no_fail,
)
from warp_peri.dynamics.motion import Motion
from warp_peri.errors import InputError
from warp_peri.lps.model import Model
from warp_peri.points.arrays import check_whole, checked

TOGETHER = 1e-6
"""Bonds so close to the most stretched one break with it: mirror images, to rounding."""


def grow(
    model: Model | CrystalBonds,
    body: LatticeBody,
    held: ArrayLike,
    u: np.ndarray,
    *,
    events: int,
    stretches: ArrayLike = 1.0,
    cracks: Sequence[ArrayLike] = (),
    no_fail: np.ndarray | None = None,
    progress: bool = False,
) -> Motion:
    """Break the bond most stretched beside its limit, and its mirror images, event by event.

    Args:
        model: positive on the lattice; others are refused.
        body: the body.
        held: components of the displacement that are given, shape [N] or [N, 2] bool.
        u: their values at unit load, shape [N, 2].
        events: how many, fewer when the body comes apart.
        stretches: critical ones of the bonds of a ball, shape [B], of which the load is told.
        cracks: polylines open from the start.
        no_fail: nodes whose bonds do not break, shape [N] bool.
        progress: shows a bar.

    Returns:
        A motion whose time is the load, the factor of u at which each event's bond breaks, over the
        critical stretch where none is given. Its histories are load, energy: elastic at unit load before each event
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
        stretch = (xi * reach).sum(axis=-1) / r**2 / np.asarray(stretches)
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


class Cleavage(NamedTuple):
    """Largest load while a crack has grown by each spacing, [n], and G of unit load."""

    loads: np.ndarray
    release: float


def cleaved(
    solid: BrittleCrystal,
    spacing: float,
    *,
    cells: int,
    length: int,
    apart: ArrayLike | None = None,
    progress: bool = False,
) -> Cleavage:
    """A long strip of a crystal, half of it cut along its middle, whose edges are moved apart.

    Ahead of the crack all columns store the same, behind it nothing, so that G is what a column
    stores (C29). In space the strain is plane.

    Args:
        solid: the crystal; the crack grows between node rows across the second axis.
        spacing: h.
        cells: height of what is free, in spacings.
        length: spacings of growth.
        apart: by which the edges are moved apart at unit load [length], [d]; along the second axis
            by a spacing where none is given.
        progress: shows a bar.
    """
    h, d, wide = spacing, solid.dimension, 2 * cells + 2 * length
    u_of = h * np.eye(d)[1] if apart is None else checked("apart", apart, float, (d,))

    def body_of(wide: int) -> tuple[LatticeBody, np.ndarray, np.ndarray]:
        reach = 2 * int(np.ceil(solid.horizon / h))
        x = box((wide * h, (cells + reach) * h, h)[:d], h)
        held = np.abs(x[:, 1]) > cells * h / 2
        body = lattice_body(x, h, solid.horizon, endless=d == 3)
        return body, held, np.outer(np.sign(x[:, 1]) * held / 2, u_of)

    body, held, u = body_of(wide)
    energies = []
    for more in (0, 2):
        whole, grips, pulled = body_of(wide + more)
        cut = CutSolid(solid, whole, grips)
        energies.append(cut.energy(cut.solve(None, pulled)))
    release = (energies[1] - energies[0]) / (2 * h ** (d - 1))
    line: list[tuple[float, ...]] = [(-wide * h, 0), (-length * h, 0)]
    if d == 3:
        line = [(*end, z) for end, z in zip([*line, *line[::-1]], (-wide, -wide, wide, wide))]
    up = body.classes.steps[:, 1]
    each = int(up[up > 0].sum())  # bonds of a cut, by spacing
    stretches = solid.stretches(body.classes)
    how: dict[str, Any] = {"cracks": [line], "stretches": stretches, "progress": progress}
    growth = grow(solid.model, body, held, u, events=2 * length * each, **how)
    grown = np.concatenate([[0], growth["broken"][:-1]]) / (2 * each)
    loads = [
        growth.time[(grown >= k) & (grown < k + 1)].max() for k in range(min(length, int(grown[-1])))
    ]
    return Cleavage(np.array(loads), float(release))


def apparent_toughness(
    model: Model | BrittleCrystal, spacing: float, *, cells: int = 20, length: int = 3
) -> float:
    """What a growing crack spends over the toughness of (C6) behind its critical stretch.

    A central crack in a plane under tension, `cells` spacings from its middle to the collar and 0.4
    of that long to each side, grown by `length` spacings; the largest load of each spacing counts,
    and their mean, with G from the energies. Divide a stretch by the root of this to calibrate it
    (C7). In space the strain is plane, and the front straight: it advances as one, which a bent
    front does not; there this is an upper end. A crystal is cleaved as a strip, and what it spends
    is told over 2γ of the plane across the second axis.

    Args:
        model: positive on the lattice; or a crystal with its planes.
        spacing: h; the ratio of horizon to spacing is what matters.
        cells: from the middle to the collar.
        length: spacings of growth that are averaged.
    """
    if isinstance(model, BrittleCrystal):
        found = cleaved(replace(model, spent=1.0), spacing, cells=cells, length=length + 1)
        return float(np.square(found.loads[1:]).mean() * found.release / model.toughness)
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
    up = body.classes.steps[:, 1]
    each = int(up[up > 0].sum())
    growth = grow(model, body, held, u, events=length * each + 1, cracks=[crack])
    grown = growth["broken"] / (4 * each)  # spacings of each tip; an event is 4 directed bonds
    peaks = []
    for k in range(int(grown[-1])):
        cycle = (grown >= k) & (grown < k + 1)
        ends = np.interp([k, k + 1], grown, growth["energy"])
        released = (ends[0] - ends[1]) / (2 * h ** (d - 1))  # at unit load
        peaks.append(growth.time[cycle].max() ** 2 * released)
    return float(np.mean(peaks) / unit_toughness(model, body.classes))
