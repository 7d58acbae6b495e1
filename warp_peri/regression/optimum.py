"""Stage 3: the optimum that the conditions allow, by cutting planes (theory, 26–28)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.fitting.regression import MET, Form, Numbers, Settled, Zone, fit
from warp_peri.materials.lps import long_wave_moduli
from warp_peri.points.families import BondClasses
from warp_peri.regression.coordinates import Coordinates, Parameters, Point, ShapeCoordinates
from warp_peri.regression.losses import ReducedLoss, class_pairs, lattice_group, product_basis
from warp_peri.regression.settings import Optimum

CONDITIONS = {"direct": ("D",), "paper": ("D", "gamma", "gamma_minus_2phi")}
"""What each choice asks for: D ≥ ζ s; with `paper` also μΓ ≥ ζ s and μ(Γ − 2φφᵗ) ≥ 0."""


@dataclass(frozen=True)
class Conditions:
    """What a fit must keep on every lattice.

    Attributes:
        kind: "direct", D(k) ≥ ζ s(k); "paper" asks for (i) and (iii) of (4.6) besides.
        zeta: ζ [TPa]; None takes 0.0161 of the stiffness that the data of a fit show, which is
            0.0100 TPa on graphene.

    Raises InputError for another kind, or a ζ that is not above zero.
    """

    kind: str = "direct"
    zeta: float | None = None

    def __post_init__(self) -> None:
        if self.kind not in CONDITIONS:
            raise InputError(
                f"conditions: expected one of {', '.join(CONDITIONS)}, got {self.kind!r}"
            )
        if self.zeta is not None and not (np.isfinite(self.zeta) and self.zeta > 0):
            raise InputError(f"zeta: expected a stiffness > 0, got {self.zeta}")


@dataclass(frozen=True)
class LatticeConditions:
    """Conditions on one lattice.

    Attributes:
        classes: bond classes of the lattice.
        asked: what is to be kept on it.
    """

    classes: BondClasses
    asked: Conditions

    @property
    def kind(self) -> str:
        """Which conditions: "direct" or "paper"."""
        return self.asked.kind

    @property
    def zeta(self) -> float:
        """ζ [stress]; InputError where none is given, for it is a part of a stiffness."""
        if self.asked.zeta is None:
            raise InputError("zeta: expected a stiffness > 0, a small part of the shear modulus")
        return self.asked.zeta

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the conditions, in the order of the margins."""
        return CONDITIONS[self.kind]

    def forms(self, kappa: Any, mu: Any) -> list[tuple[Any, float]]:
        """For each condition κ of its form Γ + κφφᵗ, and the level; of numbers or tensors."""
        forms = [(kappa, self.zeta)]
        if self.kind == "paper":  # Σ w r² = 1
            forms += [(0 * kappa, self.zeta), (-2 / mu, 0.0)]
        return forms

    def smallest(self, v: np.ndarray, kappa: float) -> np.ndarray:
        """Smallest Λmin / s minus the level [TPa] of each condition over the zone, shape [J]."""
        bonds = product_basis(self.classes)
        zone = Zone(bonds, lattice_group(bonds.dimension))
        mu, (i, j) = float(self.classes.count * self.classes.r**2 @ v), class_pairs(len(v))
        forms = self.forms(kappa, mu)
        products = [np.concatenate([v, own * v[i] * v[j]]) for own, _ in forms]
        found = [zone.softest(p, -np.inf)[0] for p in products]
        return np.array(found) - [level for _, level in forms]


HEADROOM = 1.01
"""A fit asks for ζ times this, so that ζ itself holds between the points it sampled."""
MODULI_TOLERANCE = 1e-4
"""Distance from moduli to be held, over ζ, that counts as none."""


@dataclass(frozen=True)
class Reached:
    """Result of one start.

    Attributes:
        parameters: λ, μ, α, D.
        loss: at the optimum, relative to the loads.
        margin: smallest margin over the searched zones [TPa].
        departure: farthest that a modulus is from what was to be held [TPa].
        cuts: number of wave vectors the conditions were kept on.
        converged: whether no violation was left, and the moduli are those to be held.
    """

    parameters: Parameters
    loss: float
    margin: float
    departure: float
    cuts: int
    converged: bool


def constrained_optimum(
    grids: Sequence[ReducedLoss],
    start: Parameters,
    conditions: Sequence[LatticeConditions],
    method: Optimum = Optimum(),  # noqa: B008 (a frozen value)
) -> Reached:
    """Minimise the reduced loss under the conditions over the whole zone, from one start.

    Args:
        grids: the reduced loss of each lattice; their sum is minimised.
        start: where to begin.
        conditions: what must hold on each of the lattices.
        method: moduli to hold, and how many rounds of cutting planes there may be.
    """
    law = LPSNumbers([grid.classes for grid in grids], start, conditions, method)
    zeta = law.asked[0].zeta if conditions else 0.0
    if start.mu < zeta:  # from where the moduli keep what is asked
        start = replace(start, lam=0.0, mu=2 * zeta)
    blocks, theta = [grid.block for grid in grids], law.coordinates.start(start)
    found = fit(blocks, law, theta, zeta, size=1.0, rounds=method.rounds)
    return law.reached(found, found.losses, MET)


class LPSNumbers:
    """The linear peridynamic solid while it is learned: y to the products (v, κ v⊗v) (T17).

    Args:
        lattices: bond classes of each.
        start: of the kernels that can be reached.
        conditions: on each lattice.
        method: moduli to hold, and the smoothness.
    """

    def __init__(
        self,
        lattices: Sequence[BondClasses],
        start: Parameters,
        conditions: Sequence[LatticeConditions],
        method: Optimum,
    ) -> None:
        if start.shape is not None:
            self.coordinates: Coordinates | ShapeCoordinates = ShapeCoordinates(
                lattices, start.shape
            )
        else:
            self.coordinates = Coordinates(lattices, start.alpha, len(start.D) - 1)
        self.moduli, self.smoothness = method.held, method.smoothness
        self.asked = [
            LatticeConditions(asked.classes, Conditions(asked.kind, HEADROOM * asked.zeta))
            for asked in conditions
        ]
        self._pairs = [class_pairs(len(classes.r)) for classes in lattices]
        self._shears = [shear_of(classes) for classes in lattices]

    def __call__(self, y: np.ndarray) -> Numbers:
        at = self.coordinates.point(y)
        zeta, mu, dmu, one = self.asked[0].zeta, at.mu, at.dmu, np.eye(len(y))[0]  # y₀ is κ
        forms, parts = [], []
        for n, asked in enumerate(self.asked):
            by = [one]  # derivatives of κ of each form
            if asked.kind == "paper":
                by += [0 * one, 2 / mu**2 * dmu]
            for (kappa, level), slope in zip(asked.forms(at.kappa, mu), by):
                forms.append(Form(n, *self._products(at, n, kappa, slope), level))
            parts.append(self._products(at, n, at.kappa, one))
        bulk = (2 + 2 * at.kappa * mu) * dmu + mu**2 * one  # of λ + μ = 2μ + κμ²
        margins = np.array([mu, 2 * mu + at.kappa * mu**2]) / zeta - 1
        equal, A = self._held(at, one)
        rough = self.coordinates.roughness(y, at)
        return Numbers(
            [p for p, _ in parts],
            [slopes for _, slopes in parts],
            forms,
            equal / zeta,
            A / zeta,
            np.append(margins, at.limits / zeta),
            np.vstack([dmu, bulk, at.dlimits]) / zeta,
            *(self.smoothness * each for each in rough),
        )

    def _products(
        self, at: Point, number: int, kappa: float, slope: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(v, κ v⊗v) of a lattice with the κ of a form, [F], and their derivative, [F, Y]."""
        (i, j), v, dv = self._pairs[number], at.v[number], at.dv[number]
        bent = kappa * (v[i][:, None] * dv[j] + v[j][:, None] * dv[i])
        slopes = np.concatenate([dv, bent + np.outer(v[i] * v[j], slope)])
        return np.concatenate([v, kappa * v[i] * v[j]]), slopes

    def _held(self, at: Point, one: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """C44 − μ of every lattice, and μ and κ less what was asked for; their derivative."""
        values, slopes = [], []
        if isinstance(self.moduli, tuple):
            lam, mu = self.moduli
            values, slopes = [at.mu - mu, at.kappa - (lam - mu) / mu**2], [at.dmu, one]
        if self.moduli is not None:
            values += [shear @ v - at.mu for shear, v in zip(self._shears, at.v)]
            slopes += [shear @ dv - at.dmu for shear, dv in zip(self._shears, at.dv)]
        return np.array(values), np.array(slopes).reshape(-1, len(one))

    def reached(self, found: Settled, losses: list[float], met: float) -> Reached:
        """The result of a search; `met`, of ζ, is how little a margin may miss."""
        zeta, at = self.asked[0].zeta, self(found.theta)
        departure = float(np.abs(at.equal).max(initial=0.0))
        kept = found.margin >= -met and departure <= MODULI_TOLERANCE
        parameters = self.coordinates.parameters(found.theta, losses)
        margin, departure = zeta * found.margin, zeta * departure
        return Reached(parameters, found.loss**2, margin, departure, found.cuts, kept)


def shear_of(classes: BondClasses) -> np.ndarray:
    """C44 of unit v of each class."""
    return np.array([long_wave_moduli(classes, unit, 0.0)[2] for unit in np.eye(len(classes.r))])
