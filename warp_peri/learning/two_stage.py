"""Algorithm 1 of You et al. (2021): positive kernels, then an augmented Lagrangian on margins.

Each is a smallest eigenvalue less its level; its derivative is that of the eigenvalue at its own
vector. `SymbolMargins` looks at the symbol over a sampled zone, `DenseMargins` at the matrices of
the training domain, which is what You et al. (2021, 4.6) print.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.linalg import LinAlgError, cho_factor, cho_solve, cholesky, eigh
from scipy.spatial import KDTree

from warp_peri.core.stencil import bend, laplacian, ratios, zone_sample
from warp_peri.core.tensors import differentiable_once
from warp_peri.files.atomic import ArrayFile, locked
from warp_peri.learning.methods import TwoStage
from warp_peri.materials.lps_bonds import Bonds
from warp_peri.materials.lps_matrices import assemble
from warp_peri.points.families import bond_classes
from warp_peri.points.samples import Samples
from warp_peri.regression.coordinates import Parameters, Variables
from warp_peri.regression.losses import (
    FullLoss,
    ReducedLoss,
    class_pairs,
    lattice_group,
    product_basis,
)
from warp_peri.regression.optimum import LatticeConditions

ZONE_INTERVALS = 24
DENSE_ZETA = 1e-4
"""ζ of the dense conditions: Λmin(Γ) [1/l²] and Λmin(ΦΓ⁻¹Φᵗ)."""
PRINTED_HORIZON = 20.0
"""Horizon over the length l that the dense conditions count in: 1 Å as printed."""

Weights = Sequence[torch.Tensor]
Blocks = list[tuple[np.ndarray, np.ndarray]]


class _Known(torch.autograd.Function):
    """Values with derivatives that are already known, to each of the inputs."""

    @staticmethod
    def forward(
        ctx: Any, evaluate: Callable[..., tuple[np.ndarray, np.ndarray]], *inputs: torch.Tensor
    ) -> torch.Tensor:
        values, slopes = evaluate(*(tensor.detach().numpy() for tensor in inputs))
        ctx.slopes = torch.from_numpy(slopes)
        ctx.save_for_backward(*inputs)
        return torch.from_numpy(values)

    @staticmethod
    @differentiable_once
    def backward(ctx: Any, *upstream: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        inputs = ctx.saved_tensors
        parts = torch.split(upstream[0] @ ctx.slopes, [one.numel() for one in inputs])
        return None, *(part.reshape(one.shape) for part, one in zip(parts, inputs))


_known: Callable[..., torch.Tensor] = _Known.apply


class SymbolMargins:
    """Smallest margins of the conditions over sampled wave vectors, on each lattice [TPa]."""

    def __init__(self, conditions: Sequence[LatticeConditions]) -> None:
        self.conditions = conditions
        self.lattices = [asked.classes for asked in conditions]
        self.bases = [product_basis(classes) for classes in self.lattices]
        self.phase = zone_sample(lattice_group(2), 2, ZONE_INTERVALS)
        self.count = sum(len(asked.names) for asked in conditions)

    def __call__(self, lam: torch.Tensor, mu: torch.Tensor, weights: Weights) -> torch.Tensor:
        """Margins, shape [count]."""
        kappa, margins = (lam - mu) / mu**2, []
        for asked, bonds, w in zip(self.conditions, self.bases, weights):
            (i, j), v, basis = class_pairs(len(w)), mu * w, torch.from_numpy(bonds.basis)
            for own, level in asked.forms(kappa, mu):
                p = torch.cat([v, own * v[i] * v[j]])
                tensors = torch.tensordot(p, basis, 1)
                ratio = ratios(bonds.steps, tensors.detach().numpy(), self.phase)[0]
                k = self.phase[[ratio.argmin()]]
                D = torch.tensordot(torch.from_numpy(bend(k, bonds.steps)), tensors, 1)
                margins.append(torch.linalg.eigvalsh(D)[0, 0] / laplacian(k)[0] - level)
        return torch.stack(margins)


class DenseMargins:
    """The three conditions (4.6) on the interior of each training set.

    Λmin(Γ) − ζ, Λmin(ΦΓ⁻¹Φᵗ) − ζ with zeros left out, Λmin(Γ − 2ΦᵗΦ), with Φ the dilatation of
    interior nodes, in the length l of which the horizon is PRINTED_HORIZON. Γ and Φ are
    linear in the class weights: Σ w_c Γ_c, Σ w_c Φ_c. Where a domain is its own mirror image the
    matrices fall into blocks, a tenth of the work with the same values.
    """

    def __init__(self, sets: Sequence[Samples], horizon: float) -> None:
        self.lattices = [bond_classes(points.spacing, horizon) for points in sets]
        self.parts = [
            _blocks(*_class_matrices(points, horizon), points.x[points.interior]) for points in sets
        ]
        self.count = 3 * len(sets)
        square = (horizon / PRINTED_HORIZON) ** 2
        self.units, self.levels = np.array([square, 1, square]), DENSE_ZETA * np.array([1, 1, 0])

    def __call__(self, lam: torch.Tensor, mu: torch.Tensor, weights: Weights) -> torch.Tensor:
        """Margins, shape [3 · sets]."""
        parts = []
        for blocks, w in zip(self.parts, weights):

            def evaluate(w: np.ndarray, blocks: Blocks = blocks) -> tuple[np.ndarray, np.ndarray]:
                margins, slopes = _dense(blocks, w)
                return self.units * margins - self.levels, self.units[:, None] * slopes

            parts.append(_known(evaluate, w))
        return torch.cat(parts)


def _class_matrices(points: Samples, horizon: float) -> tuple[np.ndarray, np.ndarray]:
    """Γ_c [C, 2 I, 2 I] and Φ_c [C, I, 2 I] of unit class weights on the interior."""
    bonds = Bonds(points, horizon)
    unknown = np.repeat(points.interior, 2)
    gammas, phis = [], []
    for unit in np.eye(len(bonds.families.classes.r)):
        parts = assemble(bonds, unit, 1.0)
        gammas.append(parts.gamma[:, unknown].toarray())
        phis.append(parts.phi[points.interior][:, unknown].toarray())
    return np.array(gammas), np.array(phis)


def _blocks(gammas: np.ndarray, phis: np.ndarray, x: np.ndarray) -> Blocks:
    """Γ_c and Φ_c between fields that both mirrors of the nodes keep or turn round.

    All as one block where a mirror takes some node of `x`, shape [I, 2], to a place without one.
    """
    mirrors = []
    for axis in (0, 1):
        image = x.copy()
        image[:, axis] = x[:, axis].min() + x[:, axis].max() - x[:, axis]
        distance, node = KDTree(x).query(image)
        if distance.max() > 1e-6 * np.ptp(x):
            return [(gammas, phis)]
        mirrors.append(np.eye(len(x))[node])
    blocks = []
    for signs in itertools.product((1, -1), repeat=2):
        # The component of u along an axis changes its sign in the mirror of that axis.
        scalar, along, across = (
            _kept(mirrors, [a * signs[0], b * signs[1]]) for a, b in ((1, 1), (-1, 1), (1, -1))
        )
        vector = np.zeros((2 * len(x), along.shape[1] + across.shape[1]))
        vector[::2, : along.shape[1]], vector[1::2, along.shape[1] :] = along, across
        blocks.append((vector.T @ gammas @ vector, scalar.T @ phis @ vector))
    return blocks


def _kept(mirrors: Sequence[np.ndarray], signs: Sequence[int]) -> np.ndarray:
    """Orthonormal scalar fields that each mirror multiplies by its sign, as columns."""
    one = np.eye(len(mirrors[0]))
    projection = (one + signs[0] * mirrors[0]) @ (one + signs[1] * mirrors[1]) / 4
    values, fields = eigh(projection)
    return np.array(fields[:, values > 0.5])


def _dense(blocks: Blocks, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least eigenvalues, shape [3], and their derivatives to w, shape [3, C]."""
    gammas, phis = ([np.tensordot(w, block[n], 1) for block in blocks] for n in (0, 1))

    def slope(number: int, e: np.ndarray, scale: float, f: np.ndarray) -> np.ndarray:
        """Derivatives of scale · eᵗΓe + 2 fᵗΦe, e and f held, to w."""
        of_gamma, of_phi = blocks[number]
        by_gamma = of_gamma.reshape(len(w), -1) @ np.outer(e, e).ravel()
        return np.asarray(scale * by_gamma + 2 * (of_phi @ e) @ f)

    number, coercive, e = _least(gammas)
    rows = [slope(number, e, 1.0, np.zeros(len(phis[number])))]
    if coercive > 0:
        flows = [cho_solve(cho_factor(gamma), phi.T) for gamma, phi in zip(gammas, phis)]
        number, inf_sup, y = _least([phi @ flow for phi, flow in zip(phis, flows)])
        rows.append(slope(number, flows[number] @ y, -1.0, y))
    else:  # no inf-sup constant without coercivity: its condition asks for that first
        inf_sup = coercive
        rows.append(rows[0])
    number, schwarz, e = _least([g - 2 * phi.T @ phi for g, phi in zip(gammas, phis)])
    rows.append(slope(number, e, 1.0, -2 * phis[number] @ e))
    return np.array([coercive, inf_sup, schwarz]), np.array(rows)


def _least(matrices: Sequence[np.ndarray]) -> tuple[int, float, np.ndarray]:
    """Which of some symmetric matrices has the smallest eigenvalue, the value and its vector.

    A matrix that is positive definite after the least value so far is taken away has none smaller:
    a tenth of the work of its eigenvalues.
    """
    which, least, vector = 0, np.inf, np.zeros(0)
    for number, matrix in enumerate(matrices):
        if np.isfinite(least):
            with suppress(LinAlgError):
                cholesky(matrix - least * np.eye(len(matrix)))
                continue
        values, vectors = eigh(matrix, subset_by_index=[0, 0])
        if values[0] < least:
            which, least, vector = number, float(values[0]), vectors[:, 0]
    return which, least, vector


@dataclass(frozen=True)
class Progress:
    """What stage 2 needs to go on: its tensors, the losses so far, penalty and iteration."""

    tensors: list[np.ndarray]
    losses: list[float]
    penalty: float
    iteration: int


class Checkpoint:
    """The state of one run, as an ArrayFile.

    Args:
        path: of the file.
        key: says what the run depends on; a file of another run is refused.
    """

    def __init__(self, path: str | os.PathLike[str], key: str) -> None:
        self.path, self.file = Path(path), ArrayFile(path, key, "a run on other data or settings")

    def save(
        self, tensors: Sequence[np.ndarray], *, losses: list[float], penalty: float, iteration: int
    ) -> None:
        """Write the state to the checkpoint's file, whole."""
        content = {f"tensor{number}": value for number, value in enumerate(tensors)}
        kept = {"losses": np.array(losses), "penalty": penalty, "iteration": iteration}
        self.file.write(kept | content)

    def load(self) -> Progress | None:
        """The state, or None when there is no file.

        Raises InputError for a file that cannot be read or belongs to another run.
        """
        return self.file.read(
            lambda kept: Progress(
                [kept[f"tensor{number}"] for number in range(len(kept) - 3)],
                kept["losses"].tolist(),
                float(kept["penalty"]),
                int(kept["iteration"]),
            )
        )


LEARNING_RATE = 1e-3
STAGNATION = 1e-3
"""A stage ends when its loss fell by less than this fraction over the last window of epochs."""
WINDOW = 200
PENALTY_GROWTH, REQUIRED_DECREASE, TOLERANCE = 5.0, 0.25, 1e-5
LARGEST_PENALTY = 1e20


def positive_stage(
    terms: Sequence[ReducedLoss | FullLoss],
    start: Parameters,
    method: TwoStage,
    *,
    tick: Callable[[float], None],
) -> Parameters:
    """Stage 1: Adam with D ≥ 0.

    Args:
        terms: the loss of each training set, reduced on lattices, full on scattered points.
        start: λ, μ, α and D to start from.
        method: how the bounds are kept, and the most epochs.
        tick: called with the loss after every epoch.
    """
    variables = Variables(start, positive=True, parametrisation=method.parametrisation)

    def objective() -> tuple[torch.Tensor, torch.Tensor]:
        loss = variables.loss(terms)
        return loss, loss

    return variables.parameters(_adam(variables, [], objective, method.epochs, tick))


def sign_changing_stage(
    terms: Sequence[ReducedLoss | FullLoss],
    start: Parameters,
    margins: SymbolMargins | DenseMargins,
    method: TwoStage,
    *,
    checkpoint: Checkpoint | None = None,
    tick: Callable[[float], None],
) -> Parameters:
    """Stage 2: D of any sign, the conditions held by an augmented Lagrangian with slacks ϖ.

    H_p = margin of condition p − ϖ_p². Where the printed algorithm is inconsistent, |H| is what is
    tested, against 1e-5, and the multiplier term is φ_p H_p + (ψ/2) H_p², so that
    φ_p ← φ_p + ψ H_p is the ascent of the dual.

    Args:
        terms: the loss of each training set, reduced on lattices, full on scattered points.
        start: result of stage 1.
        margins: of the conditions.
        method: how the bounds are kept, and the most epochs and iterations.
        checkpoint: kept after every outer iteration; a run that finds one goes on from it.
        tick: called with the loss after every epoch.

    Raises InputError for a checkpoint of another run, or one that another job writes to.
    """
    with locked(checkpoint.path) if checkpoint is not None else nullcontext():
        return _augmented_lagrangian(terms, start, margins, method, checkpoint, tick)


def _augmented_lagrangian(
    terms: Sequence[ReducedLoss | FullLoss],
    start: Parameters,
    margins: SymbolMargins | DenseMargins,
    method: TwoStage,
    checkpoint: Checkpoint | None,
    tick: Callable[[float], None],
) -> Parameters:
    variables = Variables(start, positive=False, parametrisation=method.parametrisation)
    slack = torch.ones(margins.count, dtype=torch.float64, requires_grad=True)
    multiplier = torch.zeros(margins.count, dtype=torch.float64)
    previous = torch.full_like(multiplier, torch.inf)
    penalty, done = 1.0, 0
    losses: list[float] = []

    def loss_and_violation() -> tuple[torch.Tensor, torch.Tensor]:
        lam, mu = variables.bounded()[:2]
        weights = variables.weights(margins.lattices)
        return variables.loss(terms), margins(lam, mu, weights) - slack**2

    def objective() -> tuple[torch.Tensor, torch.Tensor]:
        loss, H = loss_and_violation()
        return loss + multiplier @ H + penalty / 2 * (H @ H), loss

    tensors = [*variables.leaves, slack, multiplier, previous]
    if checkpoint is not None and (state := checkpoint.load()) is not None:
        losses, penalty, done = state.losses, state.penalty, state.iteration
        with torch.no_grad():
            for tensor, value in zip(tensors, state.tensors):
                tensor.copy_(torch.from_numpy(value))

    while done < method.outer_iterations:
        losses += _adam(variables, [slack], objective, method.inner_epochs, tick)
        done += 1
        with torch.no_grad():
            signed = loss_and_violation()[1]
        H = signed.abs()
        if (H <= TOLERANCE).all() and _stagnant(losses, method.inner_epochs):
            done = method.outer_iterations
        elif ((H >= REQUIRED_DECREASE * previous) & (H > TOLERANCE)).any():
            penalty *= PENALTY_GROWTH
            if penalty >= LARGEST_PENALTY:
                done = method.outer_iterations
        else:
            multiplier += penalty * signed
        previous.copy_(H)
        if checkpoint is not None:
            arrays = [tensor.detach().numpy() for tensor in tensors]
            checkpoint.save(arrays, losses=losses, penalty=penalty, iteration=done)
    return variables.parameters(losses)


def _adam(
    variables: Variables,
    extra: list[torch.Tensor],
    objective: Callable[[], tuple[torch.Tensor, torch.Tensor]],
    epochs: int,
    tick: Callable[[float], None],
) -> list[float]:
    """Adam on the variables until the objective stagnates; returns the loss by epoch.

    `objective` gives what is minimised and the loss that is part of it.
    """
    optimiser = torch.optim.Adam([*variables.leaves, *extra], lr=LEARNING_RATE)
    totals: list[float] = []
    losses: list[float] = []
    for _ in range(epochs):
        optimiser.zero_grad()
        total, loss = objective()
        total.backward()
        optimiser.step()
        variables.project()
        totals.append(total.item())
        losses.append(loss.item())
        tick(losses[-1])
        if _stagnant(totals, WINDOW):
            break
    return losses


def _stagnant(losses: list[float], window: int) -> bool:
    return len(losses) > window and losses[-1 - window] - losses[-1] < STAGNATION * abs(losses[-1])
