"""Bonds that soften before they break, pulled slowly until the body comes apart (C16, C18).

Strength and toughness belong to the material, the horizon to the numbers: `at_horizon` gives the
law of bonds at another horizon that has both.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import hyp1f1
from tqdm import tqdm

from warp_peri.core.record import OnLinear
from warp_peri.dynamics.motion import Motion
from warp_peri.errors import InputError
from warp_peri.fracture.body import LatticeBody, cracked, crossing_bonds, size_and_normal
from warp_peri.fracture.bonds import bonds_of, check_breakable, stretch_rows, unit_toughness
from warp_peri.fracture.statics import check_horizon, check_no_fail, check_pieces, symmetric_factors
from warp_peri.materials.lps import Model
from warp_peri.points.arrays import checked, is_number, is_positive
from warp_peri.points.families import bond_classes

NEWTON = 40
TOLERANCE = 1e-8
SETTLED = 0.01
"""Change of a bond's share of its pull below which damage counts as at rest."""


@dataclass(frozen=True)
class BondLaw:
    """How a bond pulls: k d exp(−β s), s = d/r² > 0, and k d in compression (C16).

    Attributes:
        softness: β ≥ 0; it would pull hardest at s = 1/β.
        stretch: s₀ at which it begins to fail; inf for never.
        tail: stretch beyond s₀ over which its pull falls to nothing, linearly; 0 breaks at once.

    Raises InputError unless β ≥ 0, s₀ > 0 and the tail ≥ 0.
    """

    softness: float
    stretch: float = np.inf
    tail: float = 0.0

    def __post_init__(self) -> None:
        for name, value, positive in (
            ("softness: expected a finite number ≥ 0", self.softness, False),
            ("stretch: expected a number > 0", self.stretch, True),
            ("tail: expected a finite number ≥ 0", self.tail, False),
        ):
            fine = is_number(value) and (value > 0 if positive else 0 <= value < np.inf)
            if not fine:
                raise InputError(f"{name}, got {value!r}")

    def pull(self, s: np.ndarray) -> np.ndarray:
        """Pull over k r² of a bond that has not begun to fail."""
        return np.asarray(pull_of(s, self.softness, np))

    def share(self, worst: np.ndarray) -> np.ndarray:
        """What is left of that pull after a largest stretch, from 1 to 0."""
        return np.asarray(share_of(worst, self.softness, np.float64(self.stretch), self.tail, np))

    def spent(self) -> float:
        """Energy that a bond takes to break, over k r²; s₀²/2 without softness and tail (C18).

        Of a bond that never fails what it takes to pull it to any length: 1/β², or inf.
        """
        b, s = self.softness, self.stretch
        if np.isinf(s):
            return 1 / b**2 if b else np.inf
        before = s * s / 2 * hyp1f1(2, 3, -b * s)  # [1 − e^(−βs) (1 + βs)]/β² without cancellation
        return float(before + self.pull(np.array(s)) * self.tail / 2)

    def at_horizon(self, times: float) -> BondLaw:
        """The law with the same strength and toughness at a horizon so many times as long (C18).

        A bond that stores more than its part of the toughness before it fails has no tail left, and
        fails earlier: then the strength gives way.

        Raises InputError for a law that never fails, or times not > 0.
        """
        if not (np.isfinite(self.stretch) and is_positive(times)):
            raise InputError(
                "at_horizon: expected a law with a finite stretch and a number > 0, got "
                f"{self.stretch} and {times}"
            )
        goal = self.spent() / times
        abrupt = BondLaw(self.softness, self.stretch)
        if abrupt.spent() <= goal:
            peak = float(self.pull(np.array(self.stretch)))
            return BondLaw(self.softness, self.stretch, 2 * (goal - abrupt.spent()) / peak)
        least = np.sqrt(2 * goal) * (1 - 1e-9)  # spends less than the goal, softness or not
        earlier = brentq(
            lambda s: BondLaw(self.softness, s).spent() / goal - 1,
            least,
            self.stretch,
            xtol=1e-14 * self.stretch,
        )
        return BondLaw(self.softness, float(earlier))


def pull_of(s: Any, softness: Any, of: Any) -> Any:
    """As BondLaw.pull, of NumPy or torch."""
    return s * of.exp(-softness * of.clip(s, 0, None))


def share_of(worst: Any, softness: Any, stretch: Any, tail: Any, of: Any) -> Any:
    """As BondLaw.share, of NumPy or torch; a tail of 0 breaks at once, and has no gradient."""
    beyond = worst > stretch
    if tail == 0 or not beyond.any():
        return of.where(beyond, 0.0, of.ones_like(worst))
    fall = of.clip(1 - (worst - stretch) / tail, 0, None)
    whole = pull_of(of.where(beyond, worst, 1.0), softness, of)
    ends = pull_of(stretch, softness, of) * fall / whole
    return of.where(beyond, of.clip(ends, None, 1), 1.0)


@dataclass(frozen=True, eq=False, repr=False)
class SoftSolid(OnLinear, format="warp_peri.soft_solid"):
    """A solid whose bonds soften and fail by one law (C16).

    Attributes:
        model: λ = μ, positive on the lattice.
        law: of the bonds.

    Raises InputError for a model with another λ.
    """

    model: Model
    law: BondLaw

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.model.lam != self.model.mu:
            raise InputError("model: expected λ = μ, bonds without a dilatation")

    @property
    def linear(self) -> Model:
        """The solid before anything softens."""
        return self.model

    def toughness(self, spacing: float) -> float:
        """G_c of a straight cut between rows of nodes so far apart [stress length], (C6, C18)."""
        classes = bond_classes(spacing, self.model.horizon, dimension=self.model.dimension)
        return 2 * unit_toughness(self.model, classes) * self.law.spent()


class SoftBody:
    """A bond-based body whose bonds soften and fail by one law.

    Args:
        model: λ = μ, positive on the lattice.
        body: the body.
        law: of the bonds.
        held: components of the displacement that are given, shape [N, d] bool.
        cracks: polylines open from the start.
        no_fail: nodes whose bonds do not break, shape [N] bool.

    Attributes:
        node, bond: where a bond begins, and its number in the ball; each bond once, [E].
        rows: s r² of each bond as a matrix [length²], [E, d N].
        stiffness, square, breakable: k [stress/length^4], r² [length²], and which may fail, [E].
        free: components that are not given, flat [d N].

    Raises InputError for another model or horizon, arrays that do not fit, and for a piece of the
    body that nothing holds.
    """

    def __init__(
        self,
        model: Model,
        body: LatticeBody,
        law: BondLaw,
        held: np.ndarray,
        *,
        cracks: Sequence[ArrayLike] = (),
        no_fail: np.ndarray | None = None,
    ) -> None:
        check_breakable(model, body.classes)
        check_horizon(model, body)
        safe, table = check_no_fail(no_fail, len(body.x)), cracked(body, cracks)
        held = checked("held", held, bool, body.x.shape)
        self.body, self.law, self.held = body, law, held
        check_pieces(body, table, held)
        node, bond = np.nonzero(table > np.arange(len(table))[:, None])  # each bond once
        far = table[node, bond]
        self.node, self.bond = node, bond
        self.rows = stretch_rows(body, node, bond, far)
        self.stiffness = 2 * bonds_of(model, body.classes).stiffness[bond]
        self.square = body.r[bond] ** 2
        self.breakable = ~(safe[node] | safe[far])
        self.free = ~held.ravel()

    def stretch(self, u: np.ndarray) -> np.ndarray:
        """s of each bond at u, flat [d N]."""
        along: np.ndarray = (self.rows @ u) / self.square
        return along

    def rest(self, u: np.ndarray, share: np.ndarray) -> np.ndarray:
        """u at rest from a start that holds the given components, by Newton's method, flat [d N].

        share: what is left of the pull of each bond.
        """
        softness = self.law.softness
        for _ in range(NEWTON):
            d = self.rows @ u
            s = np.maximum(d / self.square, 0)
            weak = np.exp(-softness * s)
            total = self.rows.T @ (self.stiffness * share * d * weak)
            force = total[self.free]
            if np.linalg.norm(force) <= TOLERANCE * np.linalg.norm(total):
                return u
            tangent = self.stiffness * share * weak * np.maximum(1 - softness * s, 0.02)
            matrix = sp.csr_array(self.rows.T @ (sp.diags_array(tangent) @ self.rows))
            inner = sp.csc_array(matrix[self.free][:, self.free])
            u = u.copy()
            u[self.free] -= symmetric_factors(inner).solve(force)
        raise InputError("softening: no equilibrium was found; the body may have come apart")

    def levers(self, line: ArrayLike) -> np.ndarray:
        """What bonds add to the force at right angles to a straight line, in space to a flat
        polygon, of one side on the other, tension positive, by thickness; over their law's pull
        and what is left of it, [E].

        Raises InputError for another line than two ends, and one that no bond crosses.
        """
        cut = crossing_bonds(self.body, line)[self.node, self.bond]
        ends = checked("line", line)
        if self.body.dimension == 2 and len(ends) != 2:
            raise InputError(f"line: expected two ends, got {len(ends)} corners")
        if not cut.any():
            raise InputError("line: no bond of the body crosses it, so no force can be read there")
        rise = cut * np.abs(self.body.xi[self.bond] @ size_and_normal(ends)[1])
        cell = self.body.spacing**self.body.dimension
        return np.asarray(cell * rise * self.stiffness * self.square)

    def pull(
        self,
        u: np.ndarray,
        *,
        loads: ArrayLike,
        line: ArrayLike,
        stop: float = 0.7,
        progress: bool = False,
        seen: list[list[np.ndarray]] | None = None,
    ) -> Motion:
        """Raise the load step by step; at each, let bonds fail until none fails further.

        Args:
            u: given components at unit load, shape [N, d]; the others are where the first solve
                begins.
            loads: rising factors.
            line: a straight one, across which the force at right angles to it is read, [2, 2];
                in space a flat polygon [P, 3].
            stop: ends when the force has fallen to this share of its largest.
            progress: shows a bar.
            seen: takes the displacements [d N] that each load was settled through.

        Returns a motion whose time is the load, with the histories load, force: per thickness at
        right angles to the line [stress · length], and broken: bonds by then.

        A body that has come apart along the line has the force 0; where no equilibrium is found
        while bonds still cross it, the curve ends before, with a warning.

        Raises InputError for another shape of u, values that are not finite, loads that do not
        rise, a line that is not straight or that no bond crosses, and a first load without an
        equilibrium.
        """
        loads, u = checked("loads", loads, float, ("n",)), checked("u", u, float, self.held.shape)
        if not (len(loads) and loads[0] >= 0 and (np.diff(loads) > 0).all()):
            raise InputError(
                "loads: expected one factor or more, factors that rise from ≥ 0, got "
                f"{loads.tolist()}"
            )
        levers, given = self.levers(line), np.where(self.held, u, 0).ravel()
        share, worst = np.ones(len(levers)), np.zeros(len(levers))
        field, rows, before = np.zeros_like(given), list[tuple[float, float, int]](), 0.0
        for load in tqdm(loads, disable=not progress, unit="load"):
            field = field * (load / before) if before else load * np.ravel(u)
            field = np.where(self.held.ravel(), load * given, field)
            fields, change = list[np.ndarray](), 1.0
            if seen is not None:
                seen.append(fields)
            try:
                while not change < SETTLED:
                    field = self.rest(field, share)
                    fields.append(field)
                    worst = np.where(self.breakable, np.maximum(worst, self.stretch(field)), 0)
                    lasting = np.minimum(self.law.share(worst), share)
                    change, share = np.max(share - lasting), lasting
            except InputError as error:
                if not share[levers > 0].any():  # nothing is left across the line
                    rows.append((load, 0.0, int((share == 0).sum())))
                elif not rows:
                    raise
                else:
                    warnings.warn(f"load {load:g} and beyond are left out: {error}", stacklevel=2)
                break
            before, force = load, float(levers @ (share * self.law.pull(self.stretch(field))))
            rows.append((load, force, int((share == 0).sum())))
            if force < stop * max(row[1] for row in rows):
                break
        history = dict(zip(("load", "force", "broken"), np.array(rows).T))
        return Motion(history["load"], field.reshape(self.held.shape), None, history)
