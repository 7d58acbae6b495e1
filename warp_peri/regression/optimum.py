"""Stage 3: the optimum that the conditions allow, by cutting planes (theory, 26–28)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from warp_peri.errors import InputError
from warp_peri.lps.symbol import Symbol, long_wave_moduli, quadratic, symbol, zone_wedge
from warp_peri.points.families import BondClasses
from warp_peri.regression.coordinates import Coordinates, Parameters, Point, ShapeCoordinates
from warp_peri.regression.losses import ReducedLoss, symbol_rows
from warp_peri.regression.search import Linearised, settle
from warp_peri.regression.settings import SMOOTHNESS, Optimum

CONDITIONS = {"direct": ("D",), "paper": ("D", "gamma", "gamma_minus_2phi")}
"""What each choice asks for: D ≥ ζ s; with `paper` also μΓ ≥ ζ s and μ(Γ − 2φφᵗ) ≥ 0."""

SEARCH_INTERVALS = 120
"""Intervals of the zone grid on which a fit looks for violations."""


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

    def forms(self, v: np.ndarray, kappa: float) -> list[tuple[float, np.ndarray, float]]:
        """For each condition: κ of its form Γ + κφφᵗ, its derivative to (κ, v), and the level."""
        by_kappa = np.zeros(1 + len(v))
        by_kappa[0] = 1.0
        forms = [(kappa, by_kappa, self.zeta)]
        if self.kind == "paper":
            sigma = self.classes.count * self.classes.r**2
            mu = sigma @ v  # Σ w r² = 1
            schwarz = np.concatenate([[0.0], 2 * sigma / mu**2])
            forms += [(0.0, 0 * by_kappa, self.zeta), (-2 / mu, schwarz, 0.0)]
        return forms

    def margins(self, table: Symbol, v: np.ndarray, kappa: float) -> np.ndarray:
        """Λmin / s minus the level [TPa] of each condition, shape [J, K]; ≥ 0 where it holds."""
        return np.array([table.ratio(v, form) - level for form, _, level in self.forms(v, kappa)])

    def gradients(self, table: Symbol, v: np.ndarray, kappa: float) -> np.ndarray:
        """Derivatives of the margins to (κ, v), shape [J, K, 1 + C]."""
        out = []
        for form, chain, _ in self.forms(v, kappa):
            by_v, by_form = table.ratio_gradient(v, form)
            gradient = by_form[:, None] * chain
            gradient[:, 1:] += by_v
            out.append(gradient)
        return np.array(out)


class ZoneSearch:
    """Looks for the smallest margins over the whole zone: a grid, then zooms into its minima."""

    def __init__(self, conditions: LatticeConditions, intervals: int = SEARCH_INTERVALS) -> None:
        self.conditions = conditions
        self.k = zone_wedge(conditions.classes.spacing, intervals)
        self.table = symbol(conditions.classes, self.k)
        self.step = np.pi / conditions.classes.spacing / intervals

    def worst(
        self, v: np.ndarray, kappa: float, candidates: int = 8
    ) -> tuple[np.ndarray, np.ndarray]:
        """Smallest margin of each condition, shape [J], and wave vectors near the minima.

        The wave vectors [1/Å], shape [J · candidates, 2], are the ones to add to a fit.
        """
        margins = self.conditions.margins(self.table, v, kappa)
        smallest, minima = [], []
        for number, values in enumerate(margins):
            best = values.min()
            for start in self._apart(values, candidates):
                k, value = self._zoom(start, number, v, kappa)
                minima.append(k)
                best = min(best, value)
            smallest.append(best)
        return np.array(smallest), np.array(minima)

    def _apart(self, values: np.ndarray, count: int) -> list[np.ndarray]:
        """The lowest waves of the grid that are no neighbours of one another: narrow dips too."""
        found: list[np.ndarray] = []
        for k in self.k[np.argsort(values)]:
            if all(np.abs(k - other).max() > 2.5 * self.step for other in found):
                found.append(k)
                if len(found) == count:
                    break
        return found

    def _zoom(
        self, k: np.ndarray, number: int, v: np.ndarray, kappa: float
    ) -> tuple[np.ndarray, float]:
        """Follow one minimum down through three grids, each ten times finer."""
        patch = np.stack(np.meshgrid(*2 * [np.linspace(-1, 1, 11)]), axis=-1).reshape(-1, 2)
        reach, edge = self.step, np.pi / self.conditions.classes.spacing
        value = np.inf
        for _ in range(3):
            near = np.append(k[None], np.clip(k + reach * patch, 1e-6 * edge, edge), axis=0)
            table = symbol(self.conditions.classes, near)
            values = self.conditions.margins(table, v, kappa)[number]
            k, value = near[np.argmin(values)], float(values.min())
            reach /= 5
        return k, value


HEADROOM = 1.01
"""A fit asks for ζ times this, so that ζ itself holds between the points it sampled."""
MET = 1e-7
"""Of ζ: a margin this little below zero is kept; (iii) is active, at zero, at every optimum."""
MODULI_TOLERANCE = 1e-6
"""Distance [TPa] from moduli to be held that counts as none."""


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
    coordinates = coordinates_of([grid.classes for grid in grids], start)
    problem = ConstrainedProblem(grids, conditions, coordinates, method.held, method.smoothness)
    zeta = problem.asked[0].zeta if conditions else 0.0
    if start.mu < zeta:  # from where the moduli keep what is asked
        start = replace(start, lam=0.0, mu=2 * zeta)
    y = coordinates.start(start)
    losses: list[float] = []
    for _ in range(method.rounds):
        y, state = settle(problem.state, y)
        losses.append(problem.loss(state))
        margin = problem.look(coordinates.point(y))
        if margin >= -MET * zeta:
            break
    return problem.reached(y, losses, margin, MET)


def coordinates_of(
    lattices: Sequence[BondClasses], start: Parameters
) -> Coordinates | ShapeCoordinates:
    """Coordinates of the kernels that a fit from `start` can reach."""
    if start.shape is not None:
        return ShapeCoordinates(lattices, start.shape)
    return Coordinates(lattices, start.alpha, len(start.D) - 1)


class ConstrainedProblem:
    """The loss and the constraints as functions of the coordinates y, with exact derivatives."""

    def __init__(
        self,
        grids: Sequence[ReducedLoss],
        conditions: Sequence[LatticeConditions],
        coordinates: Coordinates | ShapeCoordinates,
        moduli: tuple[float, float] | str | None,
        smoothness: float = SMOOTHNESS,
    ) -> None:
        self.grids, self.coordinates, self.moduli = grids, coordinates, moduli
        self.smoothness = smoothness
        self.asked = [
            LatticeConditions(asked.classes, Conditions(asked.kind, HEADROOM * asked.zeta))
            for asked in conditions
        ]
        self.searches = [ZoneSearch(asked) for asked in self.asked]
        self.cuts = [
            [np.zeros((0, grid.R.shape[1] - 1)) for _ in asked.names]
            for grid, asked in zip(grids, self.asked)
        ]
        self._shears = [  # C44 of unit v per class
            np.array(
                [
                    long_wave_moduli(grid.classes, unit, 0.0)[2]
                    for unit in np.eye(len(grid.classes.r))
                ]
            )
            for grid in grids
        ]

    def state(self, y: np.ndarray) -> Linearised:
        """Residual and conditions at y, those of waves as far as they were looked at."""
        point = self.coordinates.point(y)
        zeta, none = self.asked[0].zeta, np.zeros((0, len(y)))
        equal, A = np.zeros(0), none
        if self.moduli is not None:
            equal, A = self.departure(point) / zeta, self.departure_slopes(point) / zeta
        margins = self.margins(point) / zeta
        return Linearised(
            self.values(y, point), self.slopes(y, point), equal, A,
            margins, self.margin_slopes(point) / zeta,
        )  # fmt: skip

    def residual(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """R (v, κ v⊗v, 1) of all grids, then the roughness, and the derivative to y."""
        point = self.coordinates.point(y)
        return self.values(y, point), self.slopes(y, point)

    def values(self, y: np.ndarray, point: Point) -> np.ndarray:
        """The residual at y, whose point is given."""
        parts = [grid.R @ products for grid, products in zip(self.grids, self.products(point))]
        parts.append(self.smoothness * self.coordinates.roughness(y, point)[0])
        return np.concatenate(parts)

    def slopes(self, y: np.ndarray, point: Point) -> np.ndarray:
        """The derivative of the residual to y."""
        parts = [grid.R @ slope for grid, slope in zip(self.grids, self.product_slopes(point))]
        parts.append(self.smoothness * self.coordinates.roughness(y, point)[1])
        return np.concatenate(parts)

    def products(self, point: Point) -> list[np.ndarray]:
        """(v, κ v⊗v, 1) of each grid, shape [F + 1]."""
        return [
            np.append(self._products(point, number, point.kappa), 1.0)
            for number in range(len(self.grids))
        ]

    def product_slopes(self, point: Point) -> list[np.ndarray]:
        """Their derivatives to y, [F + 1, Y]."""
        by_kappa = np.eye(len(point.dmu))[0]  # y₀ is κ
        slopes = (
            self._slopes(point, number, point.kappa, by_kappa) for number in range(len(self.grids))
        )
        return [np.vstack([slope, np.zeros(len(by_kappa))]) for slope in slopes]

    def _products(self, point: Point, number: int, kappa: float) -> np.ndarray:
        """(v, κ v⊗v) of a lattice, with the κ of a form, shape [F]."""
        (i, j), v = self.grids[number].pairs, point.v[number]
        return np.concatenate([v, kappa * v[i] * v[j]])

    def _slopes(self, point: Point, number: int, kappa: float, by_kappa: np.ndarray) -> np.ndarray:
        """Their derivatives to y, [F, Y], with that of κ."""
        (i, j), v, dv = self.grids[number].pairs, point.v[number], point.dv[number]
        bent = kappa * (v[i][:, None] * dv[j] + v[j][:, None] * dv[i])
        return np.concatenate([dv, bent + np.outer(v[i] * v[j], by_kappa)])

    def look(self, point: Point) -> float:
        """The smallest margin over the zones [stress]; waves below zero become cuts.

        A cut vᵗ D(k) v ≥ level s(k) is linear in the products and holds where the condition does.
        """
        smallest = np.inf
        for number, search in enumerate(self.searches):
            conditions = search.conditions
            v = point.v[number]
            least, where = search.worst(v, point.kappa)
            smallest = min(smallest, float(least.min()))
            waves = where.reshape(len(least), -1, 2)
            for form, (kappa, _, level) in enumerate(conditions.forms(v, point.kappa)):
                table = symbol(conditions.classes, waves[form])
                some = table.ratio(v, kappa) < level
                parts = quadratic(table.softest(v, kappa))
                rows = np.einsum("kp,kpf->kf", parts, symbol_rows(table)) / table.laplacian[:, None]
                self.cuts[number][form] = np.concatenate([self.cuts[number][form], rows[some]])
        return smallest

    def reached(self, y: np.ndarray, losses: list[float], margin: float, met: float) -> Reached:
        """The result of a search that ended at y; `met`, of ζ, is how little a margin may miss."""
        departure, loss = self.farthest(y), self.loss(self.state(y))
        kept = margin >= -met * self.asked[0].zeta and departure <= MODULI_TOLERANCE
        parameters = self.coordinates.parameters(y, losses)
        return Reached(parameters, loss, margin, departure, sum(self.blocks[1:]), kept)

    def loss(self, state: Linearised) -> float:
        """‖R (v, κ v⊗v, 1)‖² of all grids, without the roughness."""
        rows = sum(len(grid.R) for grid in self.grids)
        return float(state.residual[:rows] @ state.residual[:rows])

    @property
    def blocks(self) -> list[int]:
        """How many margins of moduli there are, then of the waves of each form; bounds follow."""
        return [2, *(len(rows) for forms in self.cuts for rows in forms)]

    def margins(self, point: Point) -> np.ndarray:
        """What must not be negative."""
        kappa, mu = point.kappa, point.mu
        # μ and λ + μ = 2μ + κμ²
        values = [np.array([mu, 2 * mu + kappa * mu**2]) - self.asked[0].zeta]
        for number, forms in enumerate(self.cuts):
            asked = self.asked[number].forms(point.v[number], point.kappa)
            for rows, (own, _, level) in zip(forms, asked):
                values.append(rows @ self._products(point, number, own) - level)
        values.append(point.limits)
        return np.concatenate(values)

    def margin_slopes(self, point: Point) -> np.ndarray:
        """The derivative of the margins to y."""
        kappa, mu, dmu = point.kappa, point.mu, point.dmu
        dkappa = np.eye(len(dmu))[0]  # y₀ is κ
        slopes = [np.array([dmu, (2 + 2 * kappa * mu) * dmu + mu**2 * dkappa])]
        for number, forms in enumerate(self.cuts):
            asked = self.asked[number].forms(point.v[number], kappa)
            for rows, (own, by, _) in zip(forms, asked):
                by_own = by[0] * dkappa + by[1:] @ point.dv[number]
                slopes.append(rows @ self._slopes(point, number, own, by_own))
        slopes.append(point.dlimits)
        return np.concatenate(slopes)

    def farthest(self, y: np.ndarray) -> float:
        """Largest departure [TPa] from the moduli that are to be held; 0 where none are."""
        if self.moduli is None:
            return 0.0
        return float(np.abs(self.departure(self.coordinates.point(y))).max())

    def departure(self, point: Point) -> np.ndarray:
        """C44 − μ of every lattice, and μ and κ less what was asked for."""
        values = []
        if not isinstance(self.moduli, str) and self.moduli is not None:
            lam, mu = self.moduli
            values += [point.mu - mu, point.kappa - (lam - mu) / mu**2]
        for by_v, v in zip(self._shears, point.v):
            values.append(np.dot(by_v, v) - point.mu)
        return np.array(values)

    def departure_slopes(self, point: Point) -> np.ndarray:
        """The derivative of the departure to y."""
        slopes = []
        if not isinstance(self.moduli, str) and self.moduli is not None:
            slopes += [point.dmu, np.eye(len(point.dmu))[0]]
        for by_v, dv in zip(self._shears, point.dv):
            slopes.append(by_v @ dv - point.dmu)
        return np.array(slopes)
