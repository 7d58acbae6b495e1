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
from warp_peri.fracture.bonds import (
    bonds_of,
    check_breakable,
    corrections,
    stretch_matrix,
    unit_toughness,
)
from warp_peri.fracture.statics import CutSolid, by_component, check_no_fail, check_pieces
from warp_peri.materials.lps import LPSMaterial
from warp_peri.points.arguments import Count, Positive, typed
from warp_peri.points.arrays import check_whole
from warp_peri.points.families import BondClasses
from warp_peri.solvers.conjugate_gradients import definite
from warp_peri.solvers.motion import Motion

MOST, TOLERANCE = 40, 1e-11
"""Iterations of an event after which the body is factorised anew, and what is left of the forces
that its lost bonds set free."""
TOGETHER = 1e-6
"""Bonds so close to the most stretched one break with it: mirror images, to rounding."""


class _Losing:
    """A body that loses bonds and comes to rest again: its first factors stand before conjugate
    gradients.

    Args:
        model, body, held, corrected: as of CutSolid.
        neighbour: with broken bonds, shape [N, B].

    Attributes:
        node, far: where the bonds begin and end that were there at first, [E].
        alive: which of them are left.
        neighbour: with those broken that are not.
        u: displacement at rest, shape [N, d].
    """

    def __init__(
        self,
        model: LPSMaterial,
        body: LatticeBody,
        held: np.ndarray,
        neighbour: np.ndarray,
        corrected: bool,
    ) -> None:
        self._model, self._body, self._held, self.neighbour = model, body, held, neighbour
        self._corrected, self._bonds = corrected, bonds_of(model, body.classes)
        self._rows, place = stretch_matrix(body, neighbour)
        self.node, self._bond = np.divmod(place, neighbour.shape[1])
        self.far, self.alive = neighbour.ravel()[place], np.ones(len(place), bool)
        self._solid: CutSolid | None = None

    def lose(self, which: np.ndarray) -> None:
        """These bonds, [E] bool."""
        self.alive, self.neighbour = self.alive & ~which, self.neighbour.copy()
        self.neighbour[self.node[which], self._bond[which]] = -1 - self.far[which]

    def rest(self, u: np.ndarray) -> None:
        """Come to rest with the held components of u. Raises InputError where a piece is loose."""
        body, solid = self._body, self._solid
        if self._corrected:
            self._more = corrections(body, self.neighbour, self._bonds)
        if solid is None:
            self._solid = CutSolid(
                self._model, body, self._held, neighbour=self.neighbour, corrected=self._corrected
            )
            self.u = self._solid.solve_array(None, u)
            return
        check_pieces(body, self.neighbour, self._held)
        free, factors = solid.free, solid.factors

        def inverse(left: np.ndarray) -> np.ndarray:
            found = np.zeros_like(left)
            found[free] = factors.solve(left[free])
            return found

        left = free * -self.force(self.u.ravel())
        more, record = definite(lambda v: free * self.force(v), inverse, left, TOLERANCE)
        self.u = self.u + more.reshape(self.u.shape)
        if record.iterations > MOST:
            self._solid = None

    def stretch(self) -> np.ndarray:
        """e/r² of the bonds, shape [E]; 0 of those lost."""
        return np.asarray(
            self.alive * (self._rows @ self.u.ravel()) / self._body.r[self._bond] ** 2
        )

    def energy(self) -> float:
        """Elastic energy [stress · length^d]."""
        cell = self._body.spacing**self._body.dimension
        return float(cell / 2 * self.u.ravel() @ self.force(self.u.ravel()))

    def force(self, u: np.ndarray) -> np.ndarray:
        """L u of (C4), flat [d N]."""
        (stiffness, share, excess), bond = self._bonds, self._bond
        along = self.alive * (self._rows @ u)
        theta = np.bincount(self.node, share[bond] * along, len(self.neighbour))
        pull = stiffness[bond] * along + excess * share[bond] * theta[self.node]
        found = self._rows.T @ (self.alive * pull)
        return np.asarray(found + self._more @ u if self._corrected else found)


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
        model: positive on the lattice; others are refused.
        body: the body.
        held: components of the displacement that are given, shape [N] or [N, 2] bool.
        u: their values at unit load, shape [N, 2].
        events: how many, fewer when the body comes apart.
        cracks: polylines open from the start.
        no_fail: nodes whose bonds do not break, shape [N] bool.
        corrected: as of CutSolid.
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
    losing = _Losing(
        model, body, by_component(held, body.x.shape), cracked(body, cracks), corrected
    )
    safe, rows = check_no_fail(no_fail, len(body.x)), list[tuple[float, float, int]]()
    safe, end = safe[losing.node] | safe[losing.far], np.zeros_like(body.x)
    for _ in tqdm(range(events), disable=not progress, unit="event"):
        try:
            losing.rest(u)
        except InputError:
            if not rows:
                raise
            break  # a piece has come off
        stretch = np.where(safe, 0.0, losing.stretch())
        if not (largest := float(stretch.max())) > 0:
            break
        rows.append((1 / largest, losing.energy(), int(np.sum(~losing.alive))))
        losing.lose(stretch > largest * (1 - TOGETHER))
        end = losing.u / largest
    load, energy, broken = np.array(rows).reshape(-1, 3).T
    history = {"load": load, "energy": energy, "broken": broken.astype(int)}
    return Motion(load, end, None, history, losing.neighbour)


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
