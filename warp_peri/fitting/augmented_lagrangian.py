"""Adam under conditions, by an augmented Lagrangian with slacks: m − ϖ² = 0 (theory, 25, 28b).

One Adam serves Algorithm 1 of You et al. (2021), on the printed variables, and the way to the
optimum, in coordinates x in which the curvature of the Lagrangian, as Gauss and Newton take it, is
one in each direction. In λ, μ, α and D it spans twenty orders, and no rate of steps suits them all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import torch
from scipy.linalg import block_diag

from warp_peri.fitting.regression import Linearised, Regression, Settled, felt, particular

Objective = Callable[[], tuple[torch.Tensor, torch.Tensor]]
"""What is minimised, and the loss that is part of it."""
Tick = Callable[[float], None]
LEARNING_RATE, STAGNATION, WINDOW = 1e-3, 1e-3, 200
"""Of the printed variables; they end where a loss fell by less, relative, over so many epochs."""
RATE, MOMENTS = 0.05, (0.9, 0.99)
"""First rate of a framed round's steps, over the size of its first gradient, and two averages."""
DAMPING, LEAST_DAMPING, EASED = 0.1, 1e-7, 0.3
"""Of curvatures in parts of the largest: in the first round, at least, and from round to round."""
PENALTY, MOST_PENALTY, GROWTH = 0.3, 3.0, 4.0
"""ψ over the loss: at first, at most, and how it grows."""
DECREASE = 0.25
"""ψ grows where a round leaves more than this of what conditions missed before."""
SLACK, LEAST_SLACK, SHORTENED, NEAR = 2.0, 1e-3, 0.7, 0.05
"""Slacks that a round starts from, at least: at first, in the end, and after each round that
changed the loss by no more than NEAR, relative. A small one bends too much for long steps."""
TOLERANCE, SETTLED, NO_LOSS = 1e-5, 3e-4, 1e-10
"""Conditions are met to this part of ζ; the loss is settled at this change, relative, or so low."""


def adam(
    leaves: Sequence[torch.Tensor],
    objective: Objective,
    steps: int,
    tick: Tick,
    *,
    framed: bool = False,
    project: Callable[[], None] = lambda: None,
) -> tuple[list[float], list[float]]:
    """Move leaves; what was minimised and the loss, by epoch.

    In a frame the rate follows the first gradient and falls as a cosine; else it is constant, the
    leaves are projected into their bounds after every step, and stagnation ends the run.
    """
    how: dict[str, Any] = {"lr": LEARNING_RATE}
    if framed:
        first, loss = objective()
        tick(loss.item())
        slopes = torch.autograd.grad(first, leaves)
        size = float(torch.cat([one.reshape(-1) for one in slopes]).norm())
        how = {"lr": RATE * size, "betas": MOMENTS, "eps": 1e-300}
    optimiser = torch.optim.Adam(leaves, **how)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, max(steps, 1))
    totals: list[float] = []
    losses: list[float] = []
    for _ in range(steps):
        optimiser.zero_grad()
        total, loss = objective()
        total.backward()
        optimiser.step()
        project()
        totals.append(total.item())
        losses.append(loss.item())
        tick(losses[-1])
        if framed:
            schedule.step()
        elif stagnant(totals, WINDOW):
            break
    return totals, losses


def stagnant(losses: list[float], window: int) -> bool:
    """Whether a loss fell by less than STAGNATION over so many epochs."""
    return len(losses) > window and losses[-1 - window] - losses[-1] < STAGNATION * abs(losses[-1])


PENALTY_GROWTH, REQUIRED_DECREASE, LARGEST_PENALTY = 5.0, 0.25, 1e20
"""Of ψ from round to round of the printed algorithm, which ends at the last."""


@dataclass
class PrintedState:
    """What a run of the printed algorithm needs to go on: variables, slacks, multipliers and what
    conditions missed before; losses by epoch; ψ; rounds that are done."""

    tensors: list[torch.Tensor]
    losses: list[float] = field(default_factory=list)
    penalty: float = 1.0
    done: int = 0


def as_printed(
    state: PrintedState,
    loss: Callable[[], torch.Tensor],
    margins: Callable[[], torch.Tensor],
    project: Callable[[], None],
    *,
    steps: int,
    rounds: int,
    tick: Tick,
    keep: Callable[[PrintedState], None] = lambda state: None,
) -> list[float]:
    """Stage 2 of Algorithm 1: H_p = margin of condition p − ϖ_p²; the losses by epoch.

    Where the printed algorithm is inconsistent, |H| is what is tested, against 1e-5, and the
    multiplier term is φ_p H_p + (ψ/2) H_p², so that φ_p ← φ_p + ψ H_p is the ascent of the dual.

    Args:
        state: to begin with, or to go on from.
        loss, margins: of the variables, differentiable.
        project: moves the variables into their bounds.
        steps: most epochs of a round.
        rounds: most rounds.
        tick: called with the loss after every epoch.
        keep: called with the state after every round.
    """
    *variables, slack, multiplier, previous = state.tensors

    def objective() -> tuple[torch.Tensor, torch.Tensor]:
        value, H = loss(), margins() - slack**2
        return value + multiplier @ H + state.penalty / 2 * (H @ H), value

    while state.done < rounds:
        state.losses += adam([*variables, slack], objective, steps, tick, project=project)[1]
        state.done += 1
        with torch.no_grad():
            signed = margins() - slack**2
            H = signed.abs()
            if (H <= TOLERANCE).all() and stagnant(state.losses, steps):
                state.done = rounds
            elif ((H >= REQUIRED_DECREASE * previous) & (H > TOLERANCE)).any():
                state.penalty *= PENALTY_GROWTH
                if state.penalty >= LARGEST_PENALTY:
                    state.done = rounds
            else:
                multiplier += state.penalty * signed
            previous.copy_(H)
        keep(state)
    return state.losses


def to_the_optimum(
    problem: Regression,
    theta: np.ndarray,
    loss: Callable[[torch.Tensor], torch.Tensor],
    *,
    steps: int,
    rounds: int,
    tick: Tick,
) -> tuple[Settled, float]:
    """Minimise a loss under the conditions over the whole zone, from one start.

    Args:
        problem: conditions, and rows that curvatures and waves below the floor are found from.
        theta: where to begin.
        loss: of θ, differentiable.
        steps: of Adam in a round.
        rounds: at most, each with its own multipliers, coordinates and waves to keep.
        tick: called with the loss after every step.

    Returns the result, and of ζ, how little a margin of it may miss.
    """

    def lagrangian(
        x: torch.Tensor, start: torch.Tensor, frame: torch.Tensor, phi: torch.Tensor, psi: float
    ) -> tuple[torch.Tensor, torch.Tensor]:
        z, slacks = torch.split(start + frame @ x, [len(theta), len(phi)])
        value, missed = loss(z), margins_of(problem, z) - slacks**2
        return value + phi @ missed + psi / 2 * missed @ missed, value

    y = _equal(problem, theta)
    damping, penalty, slack, before = DAMPING, PENALTY, SLACK, np.inf
    now, margin = problem.state(y), -np.inf
    phi, losses = np.zeros(len(now.margins)), [now.loss]
    for _ in range(rounds):
        psi = penalty * now.loss
        start, frame = _frame(problem.state(y), y, phi, psi, slack, damping)
        x = torch.zeros(frame.shape[1], dtype=torch.float64, requires_grad=True)
        at, along, held = map(torch.from_numpy, (start, frame, phi))
        objective = partial(lagrangian, x, at, along, held, psi)
        totals, _ = adam([x], objective, steps, tick, framed=True)
        if not objective()[0].item() <= totals[0]:
            damping *= 10
            continue
        y = _equal(problem, (start + frame @ x.detach().numpy())[: len(y)])
        now = problem.state(y)
        missed = now.margins - np.maximum(now.margins + phi / psi, 0)  # slacks at their best
        most, margin = float(np.abs(missed).max()), problem.look(problem.law(y))
        phi = phi + psi * missed
        phi = np.append(phi, np.zeros(len(problem.state(y).margins) - len(phi)))
        losses.append(now.loss)
        change = abs(losses[-2] - now.loss)
        met = margin >= -TOLERANCE and most <= TOLERANCE
        if met and (change <= SETTLED * now.loss or now.loss <= NO_LOSS):
            break
        if most > max(DECREASE * before, TOLERANCE):
            penalty = min(GROWTH * penalty, MOST_PENALTY)
        before = most
        if change <= NEAR * now.loss:
            slack = max(SHORTENED * slack, LEAST_SLACK)
        damping = max(EASED * damping, LEAST_DAMPING)
    return problem.found(y, losses, margin), TOLERANCE


def margins_of(problem: Regression, theta: torch.Tensor) -> torch.Tensor:
    """The margins of a problem at θ, with their slopes."""
    there = theta.detach()
    now = problem.state(there.numpy())
    return torch.from_numpy(now.margins) + torch.from_numpy(now.M) @ (theta - there)


def _frame(
    now: Linearised, y: np.ndarray, phi: np.ndarray, psi: float, slack: float, damping: float
) -> tuple[np.ndarray, np.ndarray]:
    """(θ, ϖ) where x = 0 is, and how it moves with x, within the equalities.

    `slack` is the least ϖ at x = 0; `damping` is added to each curvature, in parts of the largest.
    """
    slacks = np.sqrt(np.maximum(now.margins + phi / psi, slack**2))
    push = phi + psi * (now.margins - slacks**2)
    free = block_diag(particular(now.A, now.equal)[1], np.eye(len(slacks)))
    slopes = np.hstack([now.M, np.diag(-2 * slacks)]) @ free
    J = now.J @ free[: len(y)]
    own = free[len(y) :] * np.maximum(-2 * push, 0)[:, None]
    curvature = 2 * J.T @ J + psi * slopes.T @ slopes + free[len(y) :].T @ own
    size = felt(np.sqrt(curvature.diagonal()))
    values, axes = np.linalg.eigh(curvature / np.outer(size, size))
    frame = axes / np.sqrt(np.maximum(values, 0) + damping) / size[:, None]
    return np.append(y, slacks), free @ frame


def _equal(problem: Regression, y: np.ndarray) -> np.ndarray:
    """The nearest y that meets the equalities, as they are linear about it."""
    now = problem.state(y)
    width = 1 / felt(np.linalg.norm(now.J, axis=0))
    met: np.ndarray = y + width * particular(now.A * width, -now.equal)[0]
    return met
