"""The output-error loss of the linear peridynamic solid and its optimum (theory, 38).

With û the model's displacement at products c₀, L(c) û is affine in c, and û − L₀⁻¹ (L(c) û − b) is
the displacement at c to first order. Its misfit is a loss of rows again. Noise in u enters it as it
is, not through a second derivative, and does not bias the fit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from warp_peri.core.elastic import lattice_group
from warp_peri.errors import InputError
from warp_peri.fitting.augmented_lagrangian import Tick
from warp_peri.fitting.regression import LatticeRows
from warp_peri.fitting.rows import compressed
from warp_peri.fitting.settings import GaussNewton
from warp_peri.materials.lps import LPSMaterial
from warp_peri.materials.lps_law import LPSFound
from warp_peri.materials.lps_matrices import matrices
from warp_peri.materials.lps_rows import Products, products
from warp_peri.points.arguments import checked
from warp_peri.points.families import BondClasses
from warp_peri.points.points import WAVE_VECTOR
from warp_peri.solvers.systems import MatrixProblem

SAMPLES_AT_ONCE = 8
STEPS = 12
GAIN = 1e-5
"""Steps end when one lowers the loss by less than this, relative."""


class WaveResponse:
    """Amplitudes of displacement at the loads' own wave vectors, all nodes projected on them.

    A load B cos k₁x cos k₂y along x is answered by (U cos cos, −V sin sin), D(k) (U, V)ᵗ = (B, 0)ᵗ,
    and loads with sines in place of cosines by such waves with the same D(k). The part of the
    field that no load caused does not count.

    Args:
        made: products on samples with `wave_vector`.

    Raises InputError for a sample without load or displacement at its wave vector.
    """

    def __init__(self, made: Products) -> None:
        points, self.classes, self.bonds = made.samples, made.classes, made.bonds
        k = checked(WAVE_VECTOR, points.arrays[WAVE_VECTOR], float, (len(points), 2))
        onto = [_projection(points.x, *sample) for sample in zip(k, points.loads)]
        self.u, self.b = (
            np.array([(wave * field.T).sum(axis=1) for wave, field in zip(onto, fields)])
            for fields in (points.u, points.loads)
        )
        parts = self.bonds.symbol(k * points.spacing) / points.spacing**2
        self.symbol = parts.transpose(0, 2, 3, 1)
        _over("b", self.b, "at its wave vector")
        self.weight = _over("u", self.u, "at its wave vector")

    def about(self, model: LPSMaterial) -> LatticeRows:
        """û against u at the wave vectors, relative, û linear in the products about a model."""
        D = self.symbol @ products(model, self.classes)
        answer = np.linalg.solve(D, self.b[..., None])[..., 0]
        R = np.linalg.solve(D, np.einsum("sabp,sb->sap", self.symbol, answer))
        R = (R * self.weight[:, None, None]).reshape(-1, R.shape[-1])
        y = ((2 * answer - self.u) * self.weight[:, None]).ravel()
        return LatticeRows(*compressed(R, y), self.bonds, lattice_group(2))


class CollarResponse:
    """Displacement on the interior, solved with the loads and the displacement of the collar.

    Noise in the collar's displacement reaches the solution through the parameters, so that this
    one is biased where the collar is noisy.

    Args:
        made: products on any samples, few enough nodes for a dense matrix.

    Raises InputError for a sample without displacement on its interior.
    """

    def __init__(self, made: Products) -> None:
        self.points, self.products = made.samples, made
        inside = self.points.u[:, self.points.interior].reshape(len(self.points), -1)
        self.weight = _over("u", inside, "on the interior")

    def about(self, model: LPSMaterial) -> LatticeRows:
        """û against u on the interior, relative, û linear in the products about a model."""
        points, inside = self.points, self.points.interior
        L = matrices(model, points).operator(model.lam, model.mu)
        problem, bonds = MatrixProblem(L, inside), self.products.bonds
        width = len(bonds.basis)
        R, y = np.zeros((0, width)), np.zeros(0)
        for start in range(0, len(points), SAMPLES_AT_ONCE):
            some = slice(start, start + SAMPLES_AT_ONCE)
            field = problem.solve(points.loads[some], points.u[some])
            wrong = (field - points.u[some])[:, inside].reshape(len(field), -1)
            load = points.loads[some][:, inside].reshape(wrong.shape)
            acting = self.products(field).transpose(0, 1, 3, 2).reshape(*wrong.shape, -1)
            sides = np.concatenate([acting, load[..., None]], axis=2).transpose(1, 0, 2)
            found = problem.factors.solve(sides.reshape(len(sides), -1)).reshape(sides.shape)
            found[..., -1] += wrong.T
            found = (found * self.weight[some, None]).reshape(-1, width + 1)
            R, y = compressed(np.concatenate([R, found[:, :-1]]), np.append(y, found[:, -1]))
        return LatticeRows(R, y, bonds, lattice_group(2))


Response: TypeAlias = WaveResponse | CollarResponse


def responses_of(sets: Sequence[Products]) -> list[Response]:
    """The response of each set: at the wave vectors of its loads, if it has them."""
    waves = (WAVE_VECTOR in made.samples.arrays for made in sets)
    return [(WaveResponse if wave else CollarResponse)(made) for wave, made in zip(waves, sets)]


def _over(name: str, fields: np.ndarray, where: str) -> np.ndarray:
    """1/‖·‖ of each of S fields, over √S, shape [S]; InputError for one that is zero."""
    size = np.linalg.norm(fields, axis=1)
    if not (size > 0).all():
        raise InputError(f"{name}: sample {int(np.argmin(size))} is zero {where}")
    return np.asarray(1 / (size * np.sqrt(len(size))))


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


def fit_output_error(learner: Any, start: LPSFound, method: GaussNewton, tick: Tick) -> LPSFound:
    """Minimise the misfit of displacement under the conditions over the whole zone.

    Each step is a constrained optimum of the loss linearised about the last one. A step that does
    not lower the loss itself ends the search.

    Args:
        learner: training data and conditions.
        start: where to begin, an optimum of another loss.
        method: as for the optimum.
        tick: called with the loss after each step.

    Raises RuntimeError when it ends with the conditions or the moduli not kept.
    """
    responses = responses_of(learner.products)

    def about(found: LPSFound) -> tuple[list[LatticeRows], float]:
        model = learner.model(found)
        blocks = [response.about(model) for response in responses]
        return blocks, squares(blocks, learner.lattices, model)

    best, (blocks, loss) = start, about(start)
    losses = [loss]
    for _ in range(STEPS):
        reached = learner.optimum(best, method, blocks)
        linearised, lower = about(reached)
        if not (reached.converged and lower < loss):
            break
        gained = loss - lower
        best, blocks, loss = reached, linearised, lower
        losses.append(loss)
        tick(loss)
        if gained <= GAIN * loss:
            break
    if not best.converged:
        raise RuntimeError(
            f"stage 4: ended with a margin of {best.margin:.1e}, and moduli to be held "
            f"missed by {best.departure:.1e}"
        )
    return dataclasses.replace(best, losses=losses)


def squares(
    blocks: Sequence[LatticeRows], lattices: Sequence[BondClasses], model: LPSMaterial
) -> float:
    """Σ ‖R p − y‖² over lattices at a model."""
    left = [one.R @ products(model, classes) - one.y for one, classes in zip(blocks, lattices)]
    return float(sum(np.sum(one**2) for one in left))
