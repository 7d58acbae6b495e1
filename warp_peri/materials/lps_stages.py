"""Other stages of an LPS fit: Adam, Algorithm 1 of You et al. (2021), and output error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy import ndarray
from numpy.linalg import pinv, solve
from scipy.linalg import LinAlgError, cho_factor, cho_solve, cholesky, eigh
from scipy.spatial import KDTree

from warp_peri.core.elastic import lattice_group
from warp_peri.core.stencil import grid_of
from warp_peri.errors import InputError, Values
from warp_peri.files.atomic import locked
from warp_peri.files.checkpoint import ArrayFile, fingerprint
from warp_peri.fitting.augmented_lagrangian import Tick, adam, as_printed, printed_state
from warp_peri.fitting.regression import LatticeRows, compressed, forces, norms
from warp_peri.materials.lps import LPSMaterial, LPSParameters, bernstein_basis
from warp_peri.materials.lps_force import Bonds, assemble
from warp_peri.materials.lps_law import (
    ALPHA_IN_SIGHT,
    LARGEST_ALPHA,
    GaussNewton,
    LPSFound,
    LPSLaw,
    Products,
    TwoStage,
    products,
    squares,
)
from warp_peri.materials.lps_operator import LPSOperator, lps_force
from warp_peri.points.arguments import Pair, checked
from warp_peri.points.families import BondClasses, bond_classes
from warp_peri.points.points import WAVE_VECTOR, Samples
from warp_peri.solvers.systems import MatrixProblem

SMALLEST_MODULUS = 1e-3
"""μ and λ + μ stay above it, in the unit of the steps."""
DENSE_ZETA = 1e-4
"""ζ of the dense conditions: Λmin(Γ) [1/l²] and Λmin(ΦΓ⁻¹Φᵗ)."""
PRINTED_HORIZON = 20.0
"""Horizon over the length l that the dense conditions count in: 1 Å as printed."""

PARITIES = "", "", "++ +- -+ --", "+++ ++- --+ --- +-"
"""Of fields under so many mirrors of a domain."""

Blocks = list[Pair]


def class_weights(classes: BondClasses, alpha: torch.Tensor, D: torch.Tensor) -> torch.Tensor:
    """Weights w = K(r) W / m [length⁻²] of each bond class, shape [C]; differentiable."""
    kw, m = table(classes, alpha, D)
    return kw / m


def table(classes: BondClasses, alpha: torch.Tensor, D: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """K W of each bond class, with (r/δ)^(−α) for r^(−α), and weighted volume; differentiable."""
    t = classes.r / classes.horizon
    basis = torch.from_numpy(bernstein_basis(t, 1.0, len(D) - 1))
    kw = alpha.new_tensor(classes.weight) * torch.from_numpy(t) ** -alpha * (basis @ D)
    return kw, torch.from_numpy(classes.count * classes.r**2) @ kw


def total_loss(
    sets: Sequence[Products], weights: Sequence[ndarray], values: Sequence[torch.Tensor]
) -> torch.Tensor:
    """Loss Σ_s weight_s ‖L u − b‖² over all training sets at λ, μ, α and D, by Warp's operator."""
    terms = []
    for made, weight in zip(sets, weights):
        left = lps_force(made.warp, torch.from_numpy(made.u), *values) - torch.from_numpy(made.b)
        terms.append(torch.from_numpy(weight) @ left.square().sum(dim=(1, 2)))
    return torch.stack(terms).sum()


class Variables:
    """λ, μ, α, D as torch leaves for Adam, λ and μ in a unit that suits its steps. The loss sees
    ReLU(μ), ReLU(λ + μ) − ReLU(μ), 3 − ReLU(3 − α) and, for a positive kernel, ReLU(D), as printed
    (4.8); λ + μ, which every run drives to zero early, stays there, for no gradient is left."""

    def __init__(self, start: LPSParameters, unit: float, *, positive: bool = False) -> None:
        self.unit, self.positive = unit, positive
        values = start.lam / unit, start.mu / unit, start.alpha, start.D
        how: Any = {"dtype": torch.float64, "requires_grad": True}
        self.leaves = [torch.tensor(value, **how) for value in values]

    def bounded(self) -> list[torch.Tensor]:
        """Parameters λ, μ, α and D within their bounds, as the loss sees them."""
        lam, mu, alpha, D = self.leaves
        stiff = torch.relu(mu)
        lam, alpha = torch.relu(lam + mu) - stiff, 3 - torch.relu(3 - alpha)
        return [self.unit * lam, self.unit * stiff, alpha, torch.relu(D) if self.positive else D]

    def found(self, losses: list[float]) -> LPSFound:
        """The fitted solid, strictly inside the bounds, with the losses so far."""
        *numbers, D = (value.detach().numpy().copy() for value in self.bounded())
        lam, mu, alpha = map(float, numbers)
        mu = max(mu, SMALLEST_MODULUS * self.unit)
        lam = max(lam, SMALLEST_MODULUS * self.unit - mu)
        return LPSFound(LPSParameters(lam, mu, min(alpha, LARGEST_ALPHA), D), None, losses)


class DenseMargins:
    """Margins of the three conditions (4.6) on the interior of each training set.

    Λmin(Γ) − ζ, Λmin(ΦΓ⁻¹Φᵗ) − ζ with zeros left out, Λmin(Γ − 2ΦᵗΦ), with Φ the dilatation of
    interior nodes, in the length l of which the horizon is PRINTED_HORIZON. Where a domain is its
    own mirror image the matrices fall into blocks, a tenth of the work.
    """

    def __init__(self, sets: Sequence[Samples], horizon: float) -> None:
        self.parts = [
            (
                bond_classes(points.spacing, horizon),
                mirror_blocks(*class_matrices(points, horizon), points.x[points.interior]),
            )
            for points in sets
        ]
        square = (horizon / PRINTED_HORIZON) ** 2
        self.units = torch.tensor([square, 1, square] * len(sets), dtype=torch.float64)
        self.levels = DENSE_ZETA * torch.tensor([1.0, 1.0, 0.0] * len(sets), dtype=torch.float64)

    def __call__(self, alpha: torch.Tensor, D: torch.Tensor) -> torch.Tensor:
        """Margins of a kernel, shape [3 · sets]."""
        found = [
            margin
            for classes, blocks in self.parts
            for margin in least_of_blocks(blocks, class_weights(classes, alpha, D))
        ]
        return self.units * torch.stack(found) - self.levels


def least_of_blocks(blocks: Blocks, weights: torch.Tensor) -> list[torch.Tensor]:
    """Smallest eigenvalues of Γ, ΦΓ⁻¹Φᵗ and Γ − 2ΦᵗΦ as functions of the class weights."""
    w = weights.detach().numpy()
    gammas, phis = ([np.tensordot(w, block[n], 1) for block in blocks] for n in (0, 1))

    def at(part: ndarray, *fields: ndarray) -> torch.Tensor:
        """Sum Σ w_c of each class's matrix, applied to fields."""
        for each in fields:
            part = part @ each
        return (weights.reshape(-1, *[1] * (part.ndim - 1)) * torch.from_numpy(part)).sum(dim=0)

    number, coercive, e = _least(gammas)
    found = [at(blocks[number][0] @ e, e)]
    if coercive > 0:
        flows = [cho_solve(cho_factor(gamma), phi.T) for gamma, phi in zip(gammas, phis)]
        number, _, y = _least([phi @ flow for phi, flow in zip(phis, flows)])
        f, (gamma, phi) = flows[number] @ y, blocks[number]
        found.append(2 * at(phi @ f, y) - at(gamma @ f, f))
    else:  # no inf-sup constant without coercivity: its condition asks for that first
        found.append(found[0])
    number, _, e = _least([gamma - 2 * phi.T @ phi for gamma, phi in zip(gammas, phis)])
    gamma, phi = blocks[number]
    return [*found, at(gamma @ e, e) - 2 * (at(phi @ e) ** 2).sum()]


def class_matrices(points: Samples, horizon: float) -> Pair:
    """Matrices Γ_c [C, 2 I, 2 I] and Φ_c [C, I, 2 I] of unit class weights on the interior."""
    bonds = Bonds(points, horizon)
    units = np.eye(len(bonds.families.classes.r))
    parts = [assemble(bonds, unit, 1.0).within(points.interior) for unit in units]
    return tuple(map(np.array, zip(*parts)))  # type: ignore[return-value]


def mirror_blocks(gammas: ndarray, phis: ndarray, x: ndarray) -> Blocks:
    """Γ_c and Φ_c in blocks of fields even or odd under both mirrors of the nodes, and under that
    of x and y, if there are; of two blocks that the last one swaps, one."""
    x, mirrors = x - (x.min(axis=0) + x.max(axis=0)) / 2, []
    for turn in np.array([[[-1, 0], [0, 1]], [[1, 0], [0, -1]], [[0, 1], [1, 0]]]):
        distance, node = KDTree(x).query(x @ turn)
        if distance.max() > 1e-6 * np.ptp(x):
            break
        scalar = np.eye(len(x))[node]
        mirrors.append((scalar, np.kron(scalar, turn)))
    blocks = []
    for parity in PARITIES[len(mirrors)].split():
        scalar, vector = (_kept(each, parity) for each in zip(*mirrors))
        blocks.append((vector.T @ gammas @ vector, scalar.T @ phis @ vector))
    return blocks or [(gammas, phis)]


def _kept(mirrors: Sequence[ndarray], parity: str) -> ndarray:
    """Orthonormal fields that each mirror leaves (+) or turns around (−), as columns."""
    kept = one = np.eye(len(mirrors[0]))
    for sign, mirror in zip(parity, mirrors):
        kept = kept @ (one + int(sign + "1") * mirror)
    values, fields = eigh(kept)
    return np.array(fields[:, values > 0.5])


def _least(matrices: Sequence[ndarray]) -> tuple[int, float, ndarray]:
    """Index of the matrix with the smallest eigenvalue, the value and its vector; a Cholesky factor
    of the matrix less the least so far rules others out at a tenth of the work."""
    which, least, vector = 0, np.inf, np.zeros(0)
    for number, matrix in enumerate(matrices):
        if np.isfinite(least):
            with suppress(LinAlgError):
                cholesky(matrix - least * np.eye(len(matrix)))
                continue
        values, vectors = eigh(matrix, subset_by_index=[0, 0])
        if values[0] < least:
            which, least, vector = number, values[0], vectors[:, 0]
    return which, least, vector


def two_stages(learner: Any, kernel: Any, method: TwoStage) -> LPSFound:
    """Run Algorithm 1 from random numbers: Adam with D ≥ 0, then D of any sign under conditions,
    kept in a file after each outer iteration; InputError for another run's, or another job's."""
    random, unit = np.random.default_rng(method.seed), learner.unit
    D, (lam, mu, alpha) = random.uniform(size=1 + kernel.degree), random.uniform(size=3)
    variables = Variables(LPSParameters(lam * unit, mu * unit, alpha, D), unit, positive=True)

    def loss() -> torch.Tensor:
        return total_loss(learner.products, learner.weights, variables.bounded())

    def positive(tick: Tick) -> LPSFound:
        epochs = method.epochs
        return variables.found(adam(variables.leaves, lambda: 2 * (loss(),), epochs, tick)[1])

    variables = Variables(learner.run("1 positive", positive).solid, unit)
    margins = DenseMargins(learner.sets, learner.law.horizon)
    state = [*variables.leaves, *printed_state(len(margins.levels))]
    losses: list[float] = []
    law = replace(learner.law, kernel=kernel, method=replace(method, checkpoint=None))
    key = fingerprint(law, learner.sets)
    kept = ArrayFile(method.checkpoint, key, "a run on other data or settings")

    def arrays() -> Values:
        tensors = {f"tensor{number}": one.detach().numpy() for number, one in enumerate(state)}
        return tensors | {"losses": losses}

    def signed(tick: Tick) -> LPSFound:
        with nullcontext() if kept.path is None else locked(kept.path):
            if (before := kept.read(arrays())) is not None:
                losses[:] = before["losses"].tolist()
                with torch.no_grad():
                    for number, tensor in enumerate(state):
                        tensor.copy_(torch.from_numpy(before[f"tensor{number}"]))
            of_kernel = lambda: margins(*variables.bounded()[2:])  # noqa: E731
            keep = lambda: kept.write(arrays())  # noqa: E731
            as_printed(state, losses, loss, of_kernel, method, tick, keep)
            return variables.found(losses)

    return learner.run("2 sign-changing", signed)  # type: ignore[no-any-return]


def in_torch(
    sets: Sequence[Products], weights: Sequence[ndarray], law: LPSLaw
) -> Callable[[torch.Tensor], torch.Tensor]:
    """Loss by Warp's operator over all training sets, as a function of a law's θ."""
    kernel: Any = law.kernel
    D_of_q = torch.from_numpy(kernel.D_of_q)

    def loss(theta: torch.Tensor) -> torch.Tensor:
        q, first = theta[1:], sets[0].classes
        alpha = torch.tensor(kernel.alpha, dtype=torch.float64)
        if kernel.free_alpha:
            alpha = q[-1].clamp(*ALPHA_IN_SIGHT)
        D = D_of_q @ q[: kernel.rank]
        mu = law.size * table(first, alpha, D)[1]
        return total_loss(sets, weights, (mu + theta[0] / law.unit * mu**2, mu, alpha, D))

    return loss


SAMPLES_AT_ONCE = 8
STEPS = 12
GAIN = 1e-5
"""Steps end when one lowers the loss by less than this, relative."""


class WaveResponse:
    """Displacement amplitudes at the loads' own wave vectors, all nodes projected on them: a load B
    cos k₁x cos k₂y along x, or of sines, is answered by (U cos cos, −V sin sin), D(k) (U, V)ᵗ =
    (B, 0)ᵗ. InputError for a sample without load or displacement at its wave vector."""

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
        """Rows of the relative displacement misfit at the wave vectors, linearised at a model."""
        D = self.symbol @ products(model, self.classes)
        answer = solve(D, self.b[..., None])[..., 0]
        R = solve(D, np.einsum("sabp,sb->sap", self.symbol, answer))
        R = (R * self.weight[:, None, None]).reshape(-1, R.shape[-1])
        y = ((2 * answer - self.u) * self.weight[:, None]).ravel()
        return LatticeRows(*compressed(R, y), self.bonds, lattice_group(2))


class CollarResponse:
    """Displacement on the interior, solved with loads and the collar's displacement, whose noise
    biases it. InputError for a sample without displacement on its interior."""

    def __init__(self, made: Products) -> None:
        self.points, self.bonds, self.least = made.samples, made.bonds, made.least
        inside = self.points.u[:, self.points.interior].reshape(len(self.points), -1)
        self.weight = _over("u", inside, "on the interior")

    def about(self, model: LPSMaterial) -> LatticeRows:
        """Rows of the relative misfit of interior displacement, linearised about a model."""
        points, inside = self.points, self.points.interior
        L = LPSOperator(model, points).matrix()
        problem, bonds, width = MatrixProblem(L, inside), self.bonds, len(self.bonds.basis)
        nodes = grid_of(points.points, bonds.steps, least=self.least)
        R, y = np.zeros((0, width)), np.zeros(0)
        for start in range(0, len(points), SAMPLES_AT_ONCE):
            some = slice(start, start + SAMPLES_AT_ONCE)
            field = problem.solve(points.loads[some], points.u[some])
            wrong = (field - points.u[some])[:, inside].reshape(len(field), -1)
            load = points.loads[some][:, inside].reshape(wrong.shape)
            acting = nodes.axes @ forces(field, nodes, bonds) / points.spacing**2
            acting = acting.reshape(*wrong.shape, -1)
            sides = np.concatenate([acting, load[..., None]], axis=2).transpose(1, 0, 2)
            found = problem.factors.solve(sides.reshape(len(sides), -1)).reshape(sides.shape)
            found[..., -1] += wrong.T
            found = (found * self.weight[some, None]).reshape(-1, width + 1)
            R, y = compressed(np.concatenate([R, found[:, :-1]]), np.append(y, found[:, -1]))
        return LatticeRows(R, y, bonds, lattice_group(2))


def _over(name: str, fields: ndarray, where: str) -> ndarray:
    """Weights 1/‖·‖ of each of S fields, over √S, shape [S]; InputError for one that is zero."""
    size = norms(fields)
    if not (size > 0).all():
        raise InputError(f"{name}: sample {size.argmin()} is zero {where}")
    return np.asarray(1 / (size * np.sqrt(len(size))))


def _projection(x: ndarray, k: ndarray, b: ndarray) -> ndarray:
    """Projection onto a field's amplitudes, [2, N], in the parity that holds most of the load."""
    (c1, c2), (s1, s2) = np.cos(k * x).T, np.sin(k * x).T
    waves = np.stack([c1 * c2, -s1 * s2, s1 * c2, c1 * s2], axis=1)
    parities = ((0, 1), (1, 0), (2, 3), (3, 2))  # wave of the first and of the second component
    onto = pinv(waves)  # waves that vanish, where k has a zero, get amplitude zero
    B = onto @ b
    best = max(parities, key=lambda p: np.hypot(B[p[0], 0], B[p[1], 1]))
    return onto[list(best)]


def fit_output_error(learner: Any, start: LPSFound, method: GaussNewton, tick: Tick) -> LPSFound:
    """Minimise the misfit of displacement from an optimum of another loss (theory, 38).

    Each step is a constrained optimum about the last one, û its displacement at products c₀: that
    at c is û − L₀⁻¹ (L(c) û − b) to first order. Noise in u is not differentiated, and does not
    bias the fit. RuntimeError when it ends with the conditions or the moduli not kept.
    """
    responses = [
        (WaveResponse if WAVE_VECTOR in made.samples.arrays else CollarResponse)(made)
        for made in learner.products
    ]

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
    return replace(best, losses=losses)
