"""The output-error loss and its optimum (theory, 38).

With û the model's displacement at parameters c₀, L(c) û is affine in the products c of (17), and
û − L₀⁻¹ (L(c) û − b) is the displacement at c to first order (theory, 38). Its misfit is a
reduced least-squares problem again. Noise in u enters it as it is, not through a second derivative,
and does not bias the fit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from warp_peri.errors import InputError
from warp_peri.fitting.rows import compressed
from warp_peri.materials.lps import Model, stiffnesses
from warp_peri.materials.lps_matrices import matrices
from warp_peri.points.families import BondClasses, bond_classes
from warp_peri.points.samples import WAVE_VECTOR, Samples
from warp_peri.regression.coordinates import Parameters
from warp_peri.regression.losses import Products, ReducedLoss, class_pairs, product_basis
from warp_peri.regression.optimum import LatticeConditions, Reached, constrained_optimum
from warp_peri.regression.settings import Optimum
from warp_peri.statics.direct import MatrixProblem

SAMPLES_AT_ONCE = 8


class Response(Protocol):
    """What one training set says about displacement."""

    def about(self, model: Model) -> ReducedLoss:
        """The loss Σ_s ‖û_s − u_s‖²/‖u_s‖² / S, linearised about a model; exact there."""
        ...

    def start(self) -> ReducedLoss:
        """A loss that needs no model to begin with."""
        ...


def products(model: Model, classes: BondClasses) -> np.ndarray:
    """c of (17) at a model: μ w, (λ−μ) w w of the pairs of classes, and 1; shape [F + 1]."""
    v, kappa = stiffnesses(model, classes)
    i, j = class_pairs(len(v))
    return np.concatenate([v, kappa * v[i] * v[j], [1.0]])


class WaveResponse:
    """Amplitudes of displacement at the loads' own wave vectors, all nodes projected on them.

    A load B cos k₁x cos k₂y along x is answered by (U cos cos, −V sin sin), D(k) (U, V)ᵗ = (B, 0)ᵗ,
    and loads with sines in place of cosines by such waves with the same D(k). The part of the
    field that no load caused does not count.

    Args:
        points: samples with `wave_vector`.
        horizon: δ [Å].

    Raises InputError for a sample without load or displacement at its wave vector.
    """

    def __init__(self, points: Samples, horizon: float) -> None:
        self.classes = bond_classes(points.spacing, horizon)
        k = np.asarray(points.arrays[WAVE_VECTOR], dtype=float)
        if k.shape != (len(points), 2) or not np.isfinite(k).all():
            raise InputError(f"{WAVE_VECTOR}: expected shape [{len(points)}, 2], got {k.shape}")
        onto = [_projection(points.x, *sample) for sample in zip(k, points.loads)]
        self.u, self.b = (
            np.array([(wave * field.T).sum(axis=1) for wave, field in zip(onto, fields)])
            for fields in (points.u, points.loads)
        )
        for name, value in (("u", self.u), ("b", self.b)):
            size = np.linalg.norm(value, axis=1)
            if not (size > 0).all():
                raise InputError(
                    f"{name}: sample {int(np.argmin(size))} is zero at its wave vector"
                )
        parts = product_basis(self.classes).symbol(k * points.spacing) / points.spacing**2
        self.rows = parts.transpose(0, 2, 3, 1)

    def about(self, model: Model) -> ReducedLoss:
        """û against u at the wave vectors, relative, û linear in the products about a model."""
        D = self.rows @ products(model, self.classes)[:-1]
        answer = np.linalg.solve(D, self.b[..., None])[..., 0]
        slope = -np.linalg.solve(D, self._acting(answer))
        return self._loss(slope, 2 * answer - self.u, np.linalg.norm(self.u, axis=1))

    def start(self) -> ReducedLoss:
        """D(k) u against b at the wave vectors, relative."""
        return self._loss(self._acting(self.u), -self.b, np.linalg.norm(self.b, axis=1))

    def _acting(self, u: np.ndarray) -> np.ndarray:
        """D(k) u by feature, shape [S, 2, F]."""
        return np.asarray(np.einsum("sabf,sb->saf", self.rows, u))

    def _loss(self, slope: np.ndarray, constant: np.ndarray, size: np.ndarray) -> ReducedLoss:
        rows = np.concatenate([slope, constant[..., None]], axis=2)
        rows /= size[:, None, None] * np.sqrt(len(size))
        flat = rows.reshape(-1, rows.shape[2])
        return ReducedLoss(self.classes, np.column_stack(compressed(flat[:, :-1], flat[:, -1])))


class CollarResponse:
    """Displacement on the interior, solved with the loads and the displacement of the collar.

    Noise in the collar's displacement reaches the solution through the parameters, so that this
    one is biased where the collar is noisy.

    Args:
        points: any samples on a lattice, few enough nodes for a dense matrix.
        horizon: δ [Å].
        start: a loss to begin with.

    Raises InputError for a sample without displacement on its interior.
    """

    def __init__(self, points: Samples, horizon: float, start: ReducedLoss) -> None:
        self.points, self._start = points, start
        self.features = Products(points, horizon)
        flat = points.u[:, points.interior].reshape(len(points), -1)
        size = np.linalg.norm(flat, axis=1)
        if not (size > 0).all():
            raise InputError(f"u: sample {int(np.argmin(size))} is zero on the interior")
        self.weight = 1 / (size**2 * len(size))

    def about(self, model: Model) -> ReducedLoss:
        points = self.points
        L = matrices(model, points).operator(model.lam, model.mu)
        problem = MatrixProblem(L, points.interior)
        inside, width = points.interior, self.features.mix.shape[1] + 1
        R, y = np.zeros((0, width - 1)), np.zeros(0)
        for first in range(0, len(points), SAMPLES_AT_ONCE):
            some = slice(first, first + SAMPLES_AT_ONCE)
            field = problem.solve(points.loads[some], points.u[some])
            wrong = (field - points.u[some])[:, inside].reshape(len(field), -1)
            load = points.loads[some][:, inside].reshape(wrong.shape)
            forces = self.features(field).transpose(0, 1, 3, 2).reshape(*wrong.shape, -1)
            sides = np.concatenate([-forces, load[..., None]], axis=2)
            flat = sides.transpose(1, 0, 2).reshape(wrong.shape[1], -1)
            rows = problem.factors.solve(flat).reshape(wrong.shape[1], len(field), width)
            rows[..., -1] += wrong.T
            rows *= np.sqrt(self.weight[some])[:, None]
            rows = rows.reshape(-1, width)
            R, y = compressed(np.concatenate([R, rows[:, :-1]]), np.append(y, rows[:, -1]))
        return ReducedLoss(self.features.classes, np.column_stack([R, y]))

    def start(self) -> ReducedLoss:
        return self._start


def responses_of(
    sets: Sequence[Samples], horizon: float, starts: Sequence[ReducedLoss]
) -> list[Response]:
    """The response of each set: at the wave vectors of its loads, if it has them."""
    return [
        WaveResponse(points, horizon)
        if WAVE_VECTOR in points.arrays
        else CollarResponse(points, horizon, start)
        for points, start in zip(sets, starts)
    ]


def _projection(x: np.ndarray, k: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Onto the amplitudes of a field's components, D(k) û = b̂, shape [2, N].

    Of the four parities of waves, the one that holds most of the load.
    """
    (c1, c2), (s1, s2) = np.cos(k * x).T, np.sin(k * x).T
    waves = np.stack([c1 * c2, -s1 * s2, s1 * c2, c1 * s2], axis=1)
    parities = ((0, 1), (1, 0), (2, 3), (3, 2))  # wave of the first and of the second component
    onto = np.linalg.pinv(waves)  # waves that vanish, where k has a zero, get amplitude zero
    B = onto @ b
    best = max(parities, key=lambda p: float(np.hypot(B[p[0], 0], B[p[1], 1])))
    return np.asarray(onto[list(best)])


STEPS = 12
GAIN = 1e-5
"""Steps end when one lowers the loss by less than this, relative."""


def output_optimum(
    responses: Sequence[Response],
    start: Parameters,
    conditions: Sequence[LatticeConditions],
    horizon: float,
    method: Optimum = Optimum(),  # noqa: B008 (a frozen value)
    *,
    tick: Callable[[float], None] = lambda loss: None,
) -> Reached:
    """Minimise the misfit of displacement under the conditions over the whole zone.

    Each step is a constrained optimum of the loss linearised about the last one. A step that does
    not lower the loss itself ends the search.

    Args:
        responses: of the training set on each lattice.
        start: where to begin.
        conditions: what must hold on each lattice.
        horizon: δ [Å].
        method: as for constrained_optimum.
        tick: called with the loss after each step.
    """

    def step(grids: Sequence[ReducedLoss], parameters: Parameters) -> Reached:
        return constrained_optimum(grids, parameters, conditions, method)

    def about(parameters: Parameters) -> tuple[list[ReducedLoss], float]:
        model = as_model(parameters, horizon)
        grids = [response.about(model) for response in responses]
        return grids, sum(misfit(grid, model) for grid in grids)

    best = step([response.start() for response in responses], start)
    grids, loss = about(best.parameters)
    losses = [loss]
    for _ in range(STEPS):
        reached = step(grids, best.parameters)
        linearised, lower = about(reached.parameters)
        if not (reached.converged and lower < loss):
            break
        gained = loss - lower
        best, grids, loss = reached, linearised, lower
        losses.append(loss)
        tick(loss)
        if gained <= GAIN * loss:
            break
    parameters = dataclasses.replace(best.parameters, losses=losses)
    return dataclasses.replace(best, parameters=parameters, loss=loss)


def as_model(parameters: Parameters, horizon: float) -> Model:
    """The model of these parameters."""
    return Model(parameters.lam, parameters.mu, parameters.alpha, parameters.D, horizon)


def misfit(grid: ReducedLoss, model: Model) -> float:
    """‖R c‖² of a reduced loss at a model."""
    return float(np.sum((grid.R @ products(model, grid.classes)) ** 2))
