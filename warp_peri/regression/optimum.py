"""Stage 3: the optimum that the conditions allow, by cutting planes (theory.md, 26–28)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from scipy.optimize import minimize, nnls

from warp_peri.errors import InputError
from warp_peri.lps.symbol import Symbol, long_wave_moduli, symbol, zone_wedge
from warp_peri.points.families import BondClasses
from warp_peri.regression.conditions import Conditions, LatticeConditions, ZoneSearch
from warp_peri.regression.coordinates import Coordinates, Point, ShapeCoordinates
from warp_peri.regression.losses import ReducedLoss
from warp_peri.regression.parameters import Parameters
from warp_peri.regression.settings import SMOOTHNESS, Optimum


def least_squares_above(A: np.ndarray, y: np.ndarray, G: np.ndarray, h: np.ndarray) -> np.ndarray:
    """The x of least |A x − y| with G x ≥ h (Lawson and Hanson 1974, chapter 23), shape [K].

    Args:
        A: of full column rank, shape [M, K].
        y: shape [M].
        G: shape [C, K].
        h: shape [C].

    Raises InputError where no x obeys, or the rank of A is not full.
    """
    Q, R = np.linalg.qr(A)
    if not R.diagonal().all():
        raise InputError("A: expected full column rank")
    b = Q.T @ y
    if not len(h):
        x: np.ndarray = np.linalg.solve(R, b)
        return x
    rows = np.linalg.solve(R.T, G.T).T
    size = np.linalg.norm(rows, axis=1)
    size[size == 0] = 1.0
    rows, gap = rows / size[:, None], (h - rows @ b) / size
    scale = np.abs(gap).max()
    if gap.max() <= 0 or scale == 0:
        return np.asarray(np.linalg.solve(R, b))
    dual = np.concatenate([rows.T, gap[None] / scale])
    wanted = np.zeros(len(dual))
    wanted[-1] = 1.0
    left = dual @ nnls(dual, wanted, maxiter=100 * len(h))[0] - wanted
    if not np.abs(left[-1]) > 1e-14:
        raise InputError("G: no x has G x ≥ h")
    return np.asarray(np.linalg.solve(R, b - scale * left[:-1] / left[-1]))


LOSS_TOLERANCE = 1e-14
"""Changes of the loss that SLSQP takes for none; losses are relative to the loads."""
NO_LOSS = 1e-20
"""Of data that are in equilibrium to the last digit: nothing is gained below it."""
RESTARTS, RESTART_GAIN = 10, 1e-6
"""SLSQP is begun again at most so often, while its loss falls by more than this, relative."""
HEADROOM = 1.01
"""A fit asks for ζ times this, so that ζ itself holds between the points it sampled."""
SEARCH_TOLERANCE = 1e-9
"""Margin [TPa] below zero that counts as kept; (iii) is active, at zero, at every optimum."""
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
    *,
    two_functions: bool = False,
) -> Reached:
    """Minimise the reduced loss under the conditions over the whole zone, from one start.

    Args:
        grids: the reduced loss of each lattice; their sum is minimised.
        start: where to begin.
        conditions: what must hold on each of the lattices.
        method: moduli to hold, and how many rounds of cutting planes there may be.
        two_functions: give the dilatation coefficients of its own.
    """
    classes = [grid.classes for grid in grids]
    coordinates = coordinates_of(classes, start, two_functions=two_functions)
    problem = ConstrainedProblem(grids, conditions, coordinates, method.moduli, method.smoothness)
    searches = [ZoneSearch(lattice) for lattice in conditions]
    cuts = [zone_wedge(bonds.spacing, method.first_cuts) for bonds in classes]
    y = coordinates.start(start)
    losses: list[float] = []
    for _ in range(method.rounds):
        y, loss = problem.settle(y, [symbol(bonds, k) for bonds, k in zip(classes, cuts)])
        losses.append(loss)
        point = coordinates.point(y)
        margin, kept = np.inf, True
        for number, search in enumerate(searches):
            smallest, worst = search.worst(point.v[number], point.z[number], point.kappa)
            margin = min(margin, float(smallest.min()))
            if (smallest < -SEARCH_TOLERANCE).any():
                cuts[number], kept = np.concatenate([cuts[number], worst]), False
        if kept:
            break
    departure = problem.farthest(y)
    kept = kept and departure <= MODULI_TOLERANCE
    parameters = coordinates.parameters(y, losses)
    return Reached(parameters, loss, margin, departure, sum(map(len, cuts)), kept)


def coordinates_of(
    lattices: Sequence[BondClasses], start: Parameters, *, two_functions: bool
) -> Coordinates | ShapeCoordinates:
    """Coordinates of the kernels that a fit from `start` can reach."""
    if start.shape is not None:
        return ShapeCoordinates(lattices, start.shape)
    degree = len(start.D) - 1
    return Coordinates(lattices, start.alpha, degree, two_functions=two_functions)


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
        self._shears = [  # C44 of unit v per class
            np.array(
                [
                    long_wave_moduli(grid.classes, unit, 0.0)[2]
                    for unit in np.eye(len(grid.classes.r))
                ]
            )
            for grid in grids
        ]

    def settle(self, y: np.ndarray, tables: Sequence[Symbol]) -> tuple[np.ndarray, float]:
        """SLSQP, begun again where it stopped until that gains nothing.

        It can call success far from an optimum, where the scaling of its start no longer fits.
        """
        y, loss = self.solve(y, tables)
        for _ in range(RESTARTS):
            again, lower = self.solve(y, tables)
            if not lower < loss * (1 - RESTART_GAIN) - NO_LOSS:
                break
            y, loss = again, lower
        return y, loss

    def solve(self, y0: np.ndarray, tables: Sequence[Symbol]) -> tuple[np.ndarray, float]:
        """SLSQP from y0 with the conditions at given wave vectors; returns y and the loss there.

        Variables are scaled by the Gauss–Newton Hessian at y0, which makes SLSQP's first
        quadratic model nearly exact, and the loss by its value there, since SLSQP stops at an
        absolute change.
        """
        e, slope = self.residual(y0)
        unit = max(float(e @ e), np.finfo(float).tiny)
        free = self.coordinates.directions(y0)
        bend = slope @ free
        curvature, axes = np.linalg.eigh(bend.T @ bend)
        scaling = free @ axes * np.sqrt(unit / (2 * np.maximum(curvature, 1e-14 * curvature[-1])))

        def reached(t: np.ndarray) -> tuple[np.ndarray, Point, np.ndarray]:
            y = y0 + scaling @ t
            point = self.coordinates.point(y)
            return y, point, self.values(y, point)

        state = _Last(reached)

        def loss(t: np.ndarray) -> float:
            e = state(t)[2]
            return float(e @ e) / unit

        def gradient(t: np.ndarray) -> np.ndarray:
            y, point, e = state(t)
            slope: np.ndarray = 2 / unit * scaling.T @ (self.slopes(y, point).T @ e)
            return slope

        constraints = [
            {
                "type": "ineq",
                "fun": lambda t: self.margins(state(t)[1], tables),
                "jac": lambda t: self.margin_slopes(state(t)[1], tables) @ scaling,
            }
        ]
        if self.moduli is not None:
            constraints.append(
                {
                    "type": "eq",
                    "fun": lambda t: self.departure(state(t)[1]),
                    "jac": lambda t: self.departure_slopes(state(t)[1]) @ scaling,
                }
            )
        result = minimize(
            loss,
            np.zeros(scaling.shape[1]),
            jac=gradient,
            method="SLSQP",
            constraints=constraints,
            options={"maxiter": 500, "ftol": LOSS_TOLERANCE},
        )
        y = y0 + scaling @ result.x
        e = self.values(y, self.coordinates.point(y))
        rows = sum(len(grid.R) for grid in self.grids)
        return y, float(e[:rows] @ e[:rows])

    def residual(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """R (v, κ z⊗z, 1) of all grids, then the roughness, and the derivative to y."""
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
        """(v, κ z⊗z, 1) of each grid, shape [F + 1]."""
        out = []
        for grid, v, z in zip(self.grids, point.v, point.z):
            i, j = grid.pairs
            out.append(np.concatenate([v, point.kappa * z[i] * z[j], [1.0]]))
        return out

    def product_slopes(self, point: Point) -> list[np.ndarray]:
        """Their derivatives to y, [F + 1, Y]."""
        out = []
        for grid, z, dv, dz in zip(self.grids, point.z, point.dv, point.dz):
            i, j = grid.pairs
            slope = np.zeros((len(dv) + len(i) + 1, dv.shape[1]))
            slope[: len(dv)] = dv
            slope[len(dv) : -1] = point.kappa * (z[i][:, None] * dz[j] + z[j][:, None] * dz[i])
            slope[len(dv) : -1, 0] += z[i] * z[j]  # y₀ is κ
            out.append(slope)
        return out

    def margins(self, point: Point, tables: Sequence[Symbol]) -> np.ndarray:
        """What must not be negative."""
        kappa, mu = point.kappa, point.mu
        # μ and λ + μ = 2μ + κμ²
        values = [np.array([mu, 2 * mu + kappa * mu**2]) - self.asked[0].zeta]
        for conditions, table, v, z in zip(self.asked, tables, point.v, point.z):
            values.append(conditions.margins(table, v, z, kappa).ravel())
        values.append(point.limits)
        return np.concatenate(values)

    def margin_slopes(self, point: Point, tables: Sequence[Symbol]) -> np.ndarray:
        """The derivative of the margins to y."""
        kappa, mu, dmu = point.kappa, point.mu, point.dmu
        dkappa = np.zeros_like(dmu)
        dkappa[0] = 1.0
        slopes = [np.array([dmu, (2 + 2 * kappa * mu) * dmu + mu**2 * dkappa])]
        for conditions, table, v, z, dv, dz in zip(
            self.asked, tables, point.v, point.z, point.dv, point.dz
        ):
            by = conditions.gradients(table, v, z, kappa).reshape(-1, 1 + 2 * len(v))
            slopes.append(by @ np.concatenate([dkappa[None], dv, dz]))
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


_Value = TypeVar("_Value")


class _Last(Generic[_Value]):
    """A function of an array that keeps its last value: SLSQP asks for value and slope in turn."""

    def __init__(self, function: Callable[[np.ndarray], _Value]) -> None:
        self.function = function
        self.kept: tuple[bytes, _Value] | None = None

    def __call__(self, t: np.ndarray) -> _Value:
        key = t.tobytes()
        if self.kept is None or self.kept[0] != key:
            self.kept = key, self.function(t)
        return self.kept[1]
