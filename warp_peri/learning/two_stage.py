"""Algorithm 1 of You et al. (2021): Adam on positive kernels, then an augmented Lagrangian."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext

import torch

from warp_peri.files.atomic import locked
from warp_peri.learning.checkpoint import Checkpoint
from warp_peri.learning.margins import DenseMargins, SymbolMargins
from warp_peri.learning.methods import TwoStage
from warp_peri.regression.full import FullLoss
from warp_peri.regression.parameters import Parameters, Variables
from warp_peri.regression.reduced import ReducedLoss

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
