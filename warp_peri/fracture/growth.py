"""Slow growth of cracks: the most stretched bond breaks first, one event after the other.

The body is linear between events, so each state of damage has one load at which the next bond is at
its limit; what a growing crack spends follows from the largest of them (theory, C7).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from warp_peri.errors import InputError
from warp_peri.fracture.body import LatticeBody, box_nodes, cracked, lattice_body, through
from warp_peri.fracture.bonds import check_breakable, unit_toughness
from warp_peri.fracture.statics import CutSolid, check_no_fail
from warp_peri.materials.lps import LPSMaterial
from warp_peri.points.arguments import Count, Positive, typed
from warp_peri.points.families import BondClasses
from warp_peri.solvers.motion import Motion

MOST = 40
"""Iterations of an event after which the body is factorised anew."""
TOGETHER = 1e-6
"""Bonds so close to the most stretched one break with it: mirror images, to rounding."""


def grow(
    model: LPSMaterial,
    body: LatticeBody,
    held: ArrayLike,
    u: np.ndarray,
    *,
    events: Count,
    cracks: Sequence[ArrayLike] = (),
    no_fail: np.ndarray | None = None,
    corrected: bool = False,
    progress: bool = False,
) -> Motion:
    """Break the bond most stretched, and its mirror images, event by event.

    Args:
        model, body, held, corrected: as of CutSolid; a model that changes sign is refused.
        u: the held components at unit load, shape [N, d].
        events: how many, fewer when the body comes apart.
        cracks, no_fail: open from the start; nodes whose bonds do not break, shape [N] bool.
        progress: shows a bar.

    Returns:
        A motion whose time is the load, the factor of u at which each event's bond breaks, over the
        critical stretch. Its histories are load, energy: elastic at unit load before each event
        [stress · area], and broken: bonds up to it, both directions. The details are the neighbours
        at the end, shape [N, B].

    Raises InputError as CutSolid, and for another `no_fail`.
    """
    check_breakable(model, body.classes)
    table, rows = cracked(body, cracks), list[tuple[float, float, int]]()
    end, safe = np.zeros_like(body.x), check_no_fail(no_fail, len(body.x))
    node, bond = np.nonzero(table >= 0)
    far, xi, square = table[node, bond], body.xi[bond], body.r[bond] ** 2
    safe, near = safe[node] | safe[far], None
    for _ in tqdm(range(events), disable=not progress, unit="event"):
        try:
            cut = CutSolid(model, body, held, neighbour=table, corrected=corrected, near=near)
        except InputError:
            if not rows:
                raise
            break  # a piece has come off
        found = cut.solve(None, u)
        near = cut.factors if max(found.iterations, default=0) <= MOST else None
        left = table[node, bond] >= 0
        along = ((found.u[far] - found.u[node]) * xi).sum(axis=1)
        stretch = np.where(left & ~safe, along / square, 0.0)
        if not (largest := float(stretch.max())) > 0:
            break
        rows.append((1 / largest, float(cut.energy(found.u)), int(np.sum(~left))))
        end, table = found.u / largest, table.copy()
        lost = stretch > largest * (1 - TOGETHER)
        table[node[lost], bond[lost]] = -1 - far[lost]
    load, energy, broken = np.array(rows).reshape(-1, 3).T
    history = {"load": load, "energy": energy, "broken": broken.astype(int)}
    return Motion(load, end, None, history, table)


@typed
def apparent_toughness(
    model: LPSMaterial, spacing: Positive, *, cells: Count = 20, length: Count = 3
) -> float:
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
    x = box_nodes((side, side, h)[:d], h)
    held = (np.abs(x) > cells * h).any(axis=1)
    u = np.zeros_like(x)
    u[:, :2] = _westergaard(x, half, model.lam, model.mu)
    crack = through(-half, half, side, d)
    body = lattice_body(x, h, model.horizon, endless=d == 3)
    events = length * cut_by_spacing(body.classes) + 1  # an event is 4 directed bonds
    growth = grow(model, body, held, u, events=events, cracks=[crack])
    return spent(growth, body.classes, tips=2) / unit_toughness(model, body.classes)


def _westergaard(x: np.ndarray, half: float, lam: float, mu: float) -> np.ndarray:
    """Displacement around a crack |x| < half in a plane under unit tension, [N, 2] (1939)."""
    y, z = x[:, 1], x[:, 0] + 1j * x[:, 1]
    root, kolosov = np.sqrt(z - half) * np.sqrt(z + half), (lam + 3 * mu) / (lam + mu)
    u = (kolosov - 1) / 2 * root.real - y * (z / root).imag
    v = (kolosov + 1) / 2 * root.imag - y * (z / root).real
    return np.column_stack([u, v]) / (2 * mu)


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
