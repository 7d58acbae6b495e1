"""Stage 3: the optimum that the conditions allow, by cutting planes (theory.md, 26–28).

Variables are κ = (λ−μ)/μ² and the stiffnesses v = μ w of the bond classes, in which the residual
is R (v, κ v⊗v, 1) and no scale of K is left over. The kernel family {r^(−α) Σ D_k B_k} allows the v
of a linear space U q times r^(α₀−α).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lstsq, null_space
from scipy.optimize import minimize

from warp_peri.conditions import Conditions, ZoneSearch
from warp_peri.families import BondClasses
from warp_peri.influence import bernstein_basis
from warp_peri.reduced import ReducedLoss
from warp_peri.symbol import Symbol, symbol, zone_wedge
from warp_peri.two_stage import LARGEST_ALPHA, Parameters

FIRST_CUTS = 12
"""Intervals of the zone grid that the first fit keeps the conditions on."""
ROUNDS = 40
HEADROOM = 1.01
"""A fit asks for ζ times this, so that ζ itself holds between the points it sampled."""
SEARCH_TOLERANCE = 1e-9
"""Margin [TPa] below zero that counts as kept; (iii) is active, at zero, at every optimum."""
SMALLEST_ALPHA = -6.0
RANK_TOLERANCE = 1e-11


@dataclass(frozen=True)
class Optimum:
    """Result of one start.

    Attributes:
        parameters: λ, μ, α, D.
        loss: at the optimum, relative as in ReducedLoss.
        margin: smallest margin over the searched zone [TPa].
        cuts: number of wave vectors the conditions were kept on.
        converged: whether no violation was left.
    """

    parameters: Parameters
    loss: float
    margin: float
    cuts: int
    converged: bool


class _Coordinates:
    """y = (κ, q) or (κ, q, α): how v depends on what is being optimised.

    α moves v only where the coefficients do not already reach every class (M + 1 below the number
    of distinct bond lengths); elsewhere it is redundant and keeps its value.
    """

    def __init__(self, classes: BondClasses, alpha: float, degree: int) -> None:
        self.classes, self.alpha, self.degree = classes, alpha, degree
        columns = _kernel_matrix(classes, alpha, degree)
        left, size, _ = np.linalg.svd(columns / np.abs(columns).max(0), full_matrices=False)
        self.basis = left[:, size > RANK_TOLERANCE * size[0]]
        distinct = len(np.unique(classes.r.round(9)))
        self.free_alpha = self.basis.shape[1] < distinct
        self.log_r = np.log(classes.r / classes.horizon)

    def of(self, v: np.ndarray, kappa: float) -> np.ndarray:
        """y of the given point, or of its nearest v."""
        y = np.concatenate([[kappa], self.basis.T @ v])
        return np.append(y, self.alpha) if self.free_alpha else y

    def point(self, y: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
        """v, κ and the derivatives of (κ, v) to y, shape [1 + C, Y]."""
        rank = self.basis.shape[1]
        tilt = np.exp((self.alpha - y[-1]) * self.log_r) if self.free_alpha else 1.0
        v = tilt * (self.basis @ y[1 : 1 + rank])
        jacobian = np.zeros((1 + len(v), len(y)))
        jacobian[0, 0] = 1.0
        jacobian[1:, 1 : 1 + rank] = np.reshape(tilt, (-1, 1)) * self.basis
        if self.free_alpha:
            jacobian[1:, -1] = -self.log_r * v
        return v, float(y[0]), jacobian

    def parameters(self, y: np.ndarray, losses: list[float]) -> Parameters:
        """λ, μ, α and the smoothest D that gives v."""
        v, kappa, _ = self.point(y)
        mu = float(self.classes.count @ (v * self.classes.r**2))
        alpha = float(y[-1]) if self.free_alpha else self.alpha
        D = smoothest_coefficients(self.classes, v, alpha, self.degree)
        return Parameters(mu + kappa * mu**2, mu, alpha, D, losses)


def _kernel_matrix(classes: BondClasses, alpha: float, degree: int) -> np.ndarray:
    """v of unit coefficients, shape [C, M + 1]."""
    basis = bernstein_basis(classes.r, classes.horizon, degree)
    return (classes.weight * classes.r**-alpha)[:, None] * basis


def smoothest_coefficients(
    classes: BondClasses, v: np.ndarray, alpha: float, degree: int
) -> np.ndarray:
    """D with K(r_c) W_c ∝ v_c and, where that leaves a choice, the smallest second differences.

    Scaled to the weighted volume of K = r^(−α), which is D = (1, …, 1).
    """
    basis = bernstein_basis(classes.r, classes.horizon, degree)
    active = np.abs(classes.weight) > RANK_TOLERANCE * np.abs(classes.weight).max()
    K = v[active] / classes.weight[active] * classes.r[active] ** alpha
    D = lstsq(basis[active], K, cond=RANK_TOLERANCE)[0]
    free = null_space(basis[active], rcond=RANK_TOLERANCE)
    if free.size and degree >= 2:
        second = np.diff(np.eye(degree + 1), n=2, axis=0)
        D = D - free @ lstsq(second @ free, second @ D)[0]
    volume = classes.count * classes.weight * classes.r ** (2 - alpha)
    return D * (volume.sum() / (volume @ basis @ D))


def constrained_optimum(
    reduced: ReducedLoss, start: Parameters, conditions: Conditions, search: ZoneSearch
) -> Optimum:
    """Minimise the reduced loss under the conditions over the whole zone, from one start.

    Fit by SLSQP with exact gradients on sampled wave vectors, find the worst of all wave vectors,
    add them, until none is violated. Variables are scaled by the Gauss–Newton Hessian at the
    start of each round, which makes SLSQP's first quadratic model nearly exact.
    """
    classes = reduced.classes
    coordinates = _Coordinates(classes, start.alpha, len(start.D) - 1)
    kw = _kernel_matrix(classes, start.alpha, len(start.D) - 1) @ start.D
    v = start.mu * kw / (classes.count @ (kw * classes.r**2))
    y = coordinates.of(v, (start.lam - start.mu) / start.mu**2)
    asked = Conditions(classes, conditions.kind, HEADROOM * conditions.zeta)
    cuts = zone_wedge(classes.spacing, FIRST_CUTS)
    losses: list[float] = []
    for _ in range(ROUNDS):
        y, loss = _fit(reduced, coordinates, asked, symbol(classes, cuts), y)
        losses.append(loss)
        margin, worst = search.worst(*coordinates.point(y)[:2])
        if (margin >= -SEARCH_TOLERANCE).all():
            break
        cuts = np.concatenate([cuts, worst])
    parameters = coordinates.parameters(y, losses)
    return Optimum(
        parameters, loss, float(margin.min()), len(cuts), bool((margin >= -SEARCH_TOLERANCE).all())
    )


def _fit(
    reduced: ReducedLoss, coordinates: _Coordinates, asked: Conditions, at: Symbol, y0: np.ndarray
) -> tuple[np.ndarray, float]:
    """SLSQP under the conditions at given wave vectors; returns y and the loss there."""
    first, second = reduced.pairs
    sigma = reduced.classes.count * reduced.classes.r**2
    number = len(reduced.classes.r)
    pair = number + np.arange(len(first))

    def residual(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        v, kappa, jacobian = coordinates.point(y)
        products = np.concatenate([v, kappa * v[first] * v[second], [1.0]])
        by = np.zeros((len(products), 1 + number))
        by[np.arange(number), 1 + np.arange(number)] = 1.0
        by[pair, 0] = v[first] * v[second]
        np.add.at(by, (pair, 1 + first), kappa * v[second])
        np.add.at(by, (pair, 1 + second), kappa * v[first])
        return reduced.R @ products, reduced.R @ by @ jacobian

    _, slope = residual(y0)
    curvature, axes = np.linalg.eigh(slope.T @ slope)
    scaling = axes / np.sqrt(2 * np.maximum(curvature, 1e-14 * curvature[-1]))

    def objective(z: np.ndarray) -> tuple[float, np.ndarray]:
        e, slope = residual(y0 + scaling @ z)
        return float(e @ e), 2 * scaling.T @ (slope.T @ e)

    def margins(z: np.ndarray) -> np.ndarray:
        y = y0 + scaling @ z
        v, kappa, _ = coordinates.point(y)
        mu = sigma @ v
        bulk = 2 * mu + kappa * mu**2  # λ + μ
        bounds = [mu - asked.zeta, bulk - asked.zeta]
        if coordinates.free_alpha:
            bounds += [LARGEST_ALPHA - y[-1], y[-1] - SMALLEST_ALPHA]
        return np.concatenate([asked.margins(at, v, kappa).ravel(), bounds])

    def margin_gradients(z: np.ndarray) -> np.ndarray:
        y = y0 + scaling @ z
        v, kappa, jacobian = coordinates.point(y)
        mu = sigma @ v
        by_mu = np.concatenate([[0.0], sigma])
        by_bulk = np.concatenate([[mu**2], (2 + 2 * kappa * mu) * sigma])
        by = asked.gradients(at, v, kappa).reshape(-1, 1 + number)
        rows = [np.concatenate([by, [by_mu, by_bulk]]) @ jacobian]
        if coordinates.free_alpha:
            bound = np.zeros((2, len(y)))
            bound[:, -1] = (-1, 1)
            rows.append(bound)
        return np.concatenate(rows) @ scaling

    result = minimize(
        objective,
        np.zeros(len(y0)),
        jac=True,
        method="SLSQP",
        constraints={"type": "ineq", "fun": margins, "jac": margin_gradients},
        options={"maxiter": 500, "ftol": 1e-14},
    )
    y = y0 + scaling @ result.x
    return y, objective(result.x)[0]
