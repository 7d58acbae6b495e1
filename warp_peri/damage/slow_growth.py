"""Slow growth of cracks: the most stretched bond breaks first, one event after the other.

The body is linear between events, so each state of damage has one load at which the next bond is at
its limit; what a growing crack spends follows from the largest of them (theory, C7).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from tqdm import tqdm

from warp_peri.damage.cut_solid import CutSolid, check_pieces
from warp_peri.damage.lattice_body import LatticeBody, box, cracked, lattice_body
from warp_peri.damage.operator import bonds_of, dilatations, stretch_rows, unit_toughness
from warp_peri.damage.solid import check_breakable, check_no_fail
from warp_peri.dynamics.motion import Motion
from warp_peri.errors import InputError
from warp_peri.materials.lps import Model
from warp_peri.points.arrays import check_whole
from warp_peri.points.families import BondClasses

MOST_LOST, LEFT = 200, 1e-9
"""Rank beyond which a body is factorised anew, and the residual that its changed factors may leave
over the largest force."""
TOGETHER = 1e-6
"""Bonds so close to the most stretched one break with it: mirror images, to rounding."""


class _Weakened:
    """A cut solid that loses bonds, by its first factors and a change of low rank (C28).

    Attributes:
        field, energy: of the body at rest.
        holds: whether they are to be had this way still.
    """

    def __init__(self, solid: CutSolid, u: np.ndarray) -> None:
        self.solid, self.holds = solid, True
        self._bonds = bonds_of(solid.model, solid.body.classes)
        self.field = solid.solve(None, u)
        self.energy, self._first = solid.energy(self.field), self.field.ravel()
        count = self._first.size
        self._pairs, self._theta = sp.csr_array((0, count)), sp.csr_array((0, count))
        self._answers: list[np.ndarray] = [np.zeros((int(solid.free.sum()), 0))] * 2
        self._ends, self._kinds = np.zeros((0, 2), int), np.zeros(0, int)
        self._nodes = np.zeros(0, int)

    def lose(self, node: np.ndarray, bond: np.ndarray) -> None:
        """Come to rest without these bonds, given from both of their ends."""
        body, neighbour = self.solid.body, self.solid.neighbour
        once = node < neighbour[node, bond]
        node, bond = node[once], bond[once]
        ends = np.stack([node, neighbour[node, bond]], axis=1)
        self._ends, self._kinds = np.vstack([self._ends, ends]), np.append(self._kinds, bond)
        self._pairs = self._more(0, self._pairs, stretch_rows(body, node, bond, ends[:, 1]))
        if self._bonds.excess != 0:
            new = np.setdiff1d(ends, self._nodes)
            self._nodes = np.append(self._nodes, new)
            rows = dilatations(body, self._bonds.share, neighbour, new)
            self._theta = self._more(1, self._theta, rows)
        self.holds = len(self._kinds) + len(self._nodes) <= MOST_LOST and self._settled()

    def _more(self, which: int, rows: sp.csr_array, new: sp.csr_array) -> sp.csr_array:
        felt = new[:, self.solid.free].toarray().T
        answers = self.solid.factors.solve(np.ascontiguousarray(felt))
        self._answers[which] = np.hstack([self._answers[which], answers])
        return sp.csr_array(sp.vstack([rows, new]))

    def _settled(self) -> bool:
        """Find the rest; whether it is one."""
        solid, (stiffness, share, excess) = self.solid, self._bonds
        pairs, nodes = len(self._kinds), len(self._nodes)
        change = np.zeros((pairs + nodes,) * 2)
        change[range(pairs), range(pairs)] = -2 * stiffness[self._kinds]
        if nodes:
            part = np.zeros((nodes, pairs))
            order = np.argsort(self._nodes)
            for side in self._ends.T:
                place = order[np.searchsorted(self._nodes, side, sorter=order)]
                part[place, range(pairs)] = share[self._kinds]
            change[:pairs, :pairs] += excess * part.T @ part
            change[:pairs, pairs:] = -excess * part.T
            change[pairs:, :pairs] = -excess * part
        rows = sp.csr_array(sp.vstack([self._pairs, self._theta]))
        answers = np.hstack(self._answers)
        inner = np.eye(len(change)) + rows[:, solid.free] @ answers @ change
        try:
            felt = change @ np.linalg.solve(inner, rows @ self._first)
        except np.linalg.LinAlgError:
            return False
        flat = self._first.copy()
        flat[solid.free] -= answers @ felt
        strains = rows @ flat
        held, pull = solid.matrix @ flat, change @ strains
        left = (held + rows.T @ pull)[solid.free]
        self.field = flat.reshape(self.field.shape)
        cell = solid.body.spacing**solid.body.dimension
        self.energy = float(cell * (flat @ held + strains @ pull) / 2)
        return bool(np.abs(left).max() <= LEFT * np.abs(held).max())


def grow(
    model: Model,
    body: LatticeBody,
    held: ArrayLike,
    u: np.ndarray,
    *,
    events: int,
    cracks: Sequence[ArrayLike] = (),
    no_fail: np.ndarray | None = None,
    corrected: bool = False,
    progress: bool = False,
) -> Motion:
    """Break the bond most stretched, and its mirror images, event by event.

    Args:
        model: positive on the lattice; others are refused.
        body: the body.
        held: components of the displacement that are given, shape [N] or [N, 2] bool.
        u: their values at unit load, shape [N, 2].
        events: how many, fewer when the body comes apart.
        cracks: polylines open from the start.
        no_fail: nodes whose bonds do not break, shape [N] bool.
        corrected: as of CutSolid; the body is then factorised anew at each event.
        progress: shows a bar.

    Returns:
        A motion whose time is the load, the factor of u at which each event's bond breaks, over the
        critical stretch. Its histories are load, energy: elastic at unit load
        before each event [stress · area], and broken: bonds up to it, both directions. The details
        are the neighbours at the end, shape [N, B].

    Raises InputError for a body that CutSolid refuses, and another `no_fail`.
    """
    events = check_whole("events", events, 1)
    check_breakable(model, body.classes)
    neighbour = cracked(body, cracks)
    xi, r = body.xi, body.r
    safe, given = check_no_fail(no_fail, len(body.x)), np.asarray(held, bool)
    given = np.repeat(given[:, None], body.dimension, axis=1) if given.ndim == 1 else given
    loads: list[float] = []
    energies, counts = [], []
    start, end = int((neighbour >= 0).sum()), np.zeros_like(body.x)
    weak: _Weakened | None = None
    for _ in tqdm(range(events), disable=not progress, unit="event"):
        try:
            check_pieces(body, neighbour, given)
            if weak is None or not weak.holds:
                how: dict[str, Any] = {"neighbour": neighbour, "corrected": corrected}
                weak = _Weakened(CutSolid(model, body, held, **how), u)
        except InputError:
            if not loads:
                raise
            break  # a piece has come off
        field = weak.field
        reach = field[neighbour] - field[:, None]
        stretch = (xi * reach).sum(axis=-1) / r**2
        stretch[(neighbour < 0) | safe[:, None] | safe[np.maximum(neighbour, 0)]] = -np.inf
        largest = float(stretch.max())
        if not largest > 0:
            break
        loads.append(1 / largest)
        energies.append(weak.energy)
        counts.append(start - int((neighbour >= 0).sum()))
        chosen = stretch > largest * (1 - TOGETHER)
        if corrected:
            weak = None
        else:
            weak.lose(*np.nonzero(chosen))
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
    u[:, :2] = _westergaard(x, half, model.lam, model.mu)
    crack: list[tuple[float, ...]] = [(-half, 0), (half, 0)]
    if d == 3:  # along the front all layers are alike
        ends = side * np.array([-1.0, 1.0])
        crack = [(tip, 0, z) for tip, z in zip((-half, -half, half, half), [*ends, *ends[::-1]])]
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
