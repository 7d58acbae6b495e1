"""Adam under conditions, by an augmented Lagrangian: m − ϖ² = 0 with slacks ϖ (theory, 25, 28b).

One Adam serves Algorithm 1 of You et al. (2021), on the printed variables, and the way to the
optimum, in coordinates in which the curvature of the Lagrangian, as Gauss and Newton take it, is
one in each direction; in λ, μ, α and D, where it spans twenty orders, no rate of steps suits all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy import ndarray
from numpy.linalg import eigh, norm

from warp_peri.fitting.regression import Linearised, Regression, Settled, felt, particular

if TYPE_CHECKING:
    from warp_peri.materials.lps_law import AugmentedLagrangian, TwoStage

Tick = Callable[[float], None]
LEARNING_RATE, STAGNATION, WINDOW = 1e-3, 1e-3, 200
"""Of the printed variables; they end where a loss fell by less, relative, over so many epochs."""
RATE, MOMENTS = 0.05, (0.9, 0.99)
"""First rate of a framed round's steps, over the size of its first gradient, and two averages."""
DAMPING, LEAST_DAMPING, EASED = 0.1, 1e-7, 0.3
"""Of curvatures in parts of the largest: in the first round, at least, and from round to round."""
PENALTY, MOST_PENALTY, GROWTH = 0.3, 30.0, 4.0
"""ψ over the loss: at first, at most, and how it grows."""
DECREASE = 0.25
"""ψ grows where a round leaves more than this of what conditions missed before."""
CLOSE = 0.1
"""Of ζ: conditions that are met by less may bind on the way."""
MET, SETTLED, NO_LOSS = 1e-4, 1e-3, 1e-10
"""Conditions are met to this part of ζ; the loss is settled at this change, relative, or so low."""


def adam(
    leaves: Sequence[torch.Tensor],
    objective: Callable[[], tuple[torch.Tensor, torch.Tensor]],
    steps: int,
    tick: Tick,
    *,
    framed: bool = False,
) -> tuple[list[float], list[float]]:
    """Minimise an objective, which tells the loss beside it, by Adam; returns both by epoch.
    `framed`, the rate follows the first gradient and falls as a cosine; else it is constant, and
    stagnation ends the run."""
    how: Any = {"lr": LEARNING_RATE}
    if framed:
        first, loss = objective()
        tick(loss.item())
        slopes = torch.autograd.grad(first, leaves)
        size = float(torch.cat([one.reshape(-1) for one in slopes]).norm())
        how = {"lr": RATE * size, "betas": MOMENTS, "eps": 1e-300}
    optimiser = torch.optim.Adam(leaves, **how)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, max(steps, 1))
    totals, losses = list[float](), list[float]()
    for _ in range(steps):
        optimiser.zero_grad()
        total, loss = objective()
        total.backward()
        optimiser.step()
        totals.append(total.item())
        losses.append(loss.item())
        tick(losses[-1])
        if framed:
            schedule.step()
        elif stagnant(totals, WINDOW):
            break
    return totals, losses


def stagnant(losses: list[float], window: int) -> bool:
    """Whether a loss fell by less than STAGNATION over `window` epochs."""
    return len(losses) > window and losses[-1 - window] - losses[-1] < STAGNATION * abs(losses[-1])


TOLERANCE, PENALTY_GROWTH, REQUIRED_DECREASE, LARGEST_PENALTY = 1e-5, 5.0, 0.25, 1e20
"""Of |H|, and of ψ from round to round of the printed algorithm, which ends at the last."""


def as_printed(
    state: Sequence[torch.Tensor],
    losses: list[float],
    loss: Callable[[], torch.Tensor],
    margins: Callable[[], torch.Tensor],
    method: TwoStage,
    tick: Tick,
    keep: Callable[[], None] = lambda: None,
) -> None:
    """Run stage 2 of Algorithm 1: H_p = margin of condition p − ϖ_p², state and losses in place;
    `keep` is called after every round. Where the printed one is inconsistent, |H| is tested, and
    the multiplier term is φ_p H_p + (ψ/2) H_p², so that φ_p ← φ_p + ψ H_p ascends the dual."""
    *variables, slack, multiplier, previous, penalty, done = state

    def objective() -> tuple[torch.Tensor, torch.Tensor]:
        value, H = loss(), margins() - slack**2
        return value + multiplier @ H + penalty / 2 * (H @ H), value

    while done < method.outer_iterations:
        losses += adam([*variables, slack], objective, method.inner_epochs, tick)[1]
        done += 1
        with torch.no_grad():
            signed = margins() - slack**2
            H = signed.abs()
            if (H <= TOLERANCE).all() and stagnant(losses, method.inner_epochs):
                done.fill_(method.outer_iterations)
            elif ((H >= REQUIRED_DECREASE * previous) & (H > TOLERANCE)).any():
                penalty *= PENALTY_GROWTH
                if penalty >= LARGEST_PENALTY:
                    done.fill_(method.outer_iterations)
            else:
                multiplier += penalty * signed
            previous.copy_(H)
        keep()


def printed_state(conditions: int) -> list[torch.Tensor]:
    """Start of the printed algorithm: slacks of one, multipliers, last violations, ψ, rounds."""
    zero = torch.zeros(conditions, dtype=torch.float64)
    none = torch.zeros((), dtype=torch.float64)
    return [torch.ones_like(zero).requires_grad_(), zero, zero + torch.inf, none + 1, none]


def to_the_optimum(
    problem: Regression,
    theta: ndarray,
    loss: Callable[[torch.Tensor], torch.Tensor],
    method: AugmentedLagrangian,
    tick: Tick,
) -> tuple[Settled, float]:
    """Minimise a differentiable loss under the conditions over the whole zone, from one start.

    Slacks at their best, ϖ² = max(m + φ/ψ, 0), are no variables: what is minimised beside the loss
    is (ψ/2) min(m + φ/ψ, 0)² (Rockafellar 1973). Curvatures, and waves below the floor, are those
    of the problem's rows. Returns the result, and of ζ, how little a margin of it may miss.
    """

    def lagrangian(
        x: torch.Tensor, start: torch.Tensor, frame: torch.Tensor, phi: torch.Tensor, psi: float
    ) -> tuple[torch.Tensor, torch.Tensor]:
        z = start + frame @ x
        value, missed = loss(z), torch.clamp(margins_of(problem, z) + phi / psi, max=0)
        return value + psi / 2 * missed @ missed, value

    y = _equal(theta, problem.state(theta))
    now = problem.state(y)
    damping, penalty, before, margin = DAMPING, PENALTY, np.inf, -np.inf
    phi, losses = np.zeros(len(now.margins)), [now.loss]
    for _ in range(method.rounds):
        far = float((np.minimum(now.margins, 0) ** 2).sum())
        psi = penalty * now.loss / max(1.0, far)  # far from all conditions the loss counts as well
        frame = _frame(now, phi, psi, damping)
        x = torch.zeros(frame.shape[1], dtype=torch.float64, requires_grad=True)
        at, along, held = map(torch.from_numpy, (y, frame, phi))
        objective = partial(lagrangian, x, at, along, held, psi)
        totals, _ = adam([x], objective, method.steps, tick, framed=True)
        if not objective()[0].item() <= totals[0]:
            damping *= 10
            continue
        y = y + frame @ x.detach().numpy()
        y = _equal(y, problem.state(y))
        margin = problem.look(problem.law(y))
        now = problem.state(y)  # with the waves that were found below the floor, at the end
        there = np.minimum(phi + psi * now.margins[: len(phi)], 0)
        most = float(np.abs(there - phi).max()) / psi
        phi = np.pad(there, (0, len(now.margins) - len(there)))
        losses.append(now.loss)
        met = margin >= -MET and most <= MET
        if met and (abs(losses[-2] - now.loss) <= SETTLED * now.loss or now.loss <= NO_LOSS):
            break
        if most > max(DECREASE * before, MET):
            penalty = min(GROWTH * penalty, MOST_PENALTY)
        before, damping = most, max(EASED * damping, LEAST_DAMPING)
    return problem.found(y, losses, margin), MET


def margins_of(problem: Regression, theta: torch.Tensor) -> torch.Tensor:
    """Margins of a problem at θ, with their slopes, in torch."""
    there = theta.detach()
    now = problem.state(there.numpy())
    return torch.from_numpy(now.margins) + torch.from_numpy(now.M) @ (theta - there)


def _frame(now: Linearised, phi: ndarray, psi: float, damping: float) -> ndarray:
    """Matrix of θ by x within the equalities, curvatures damped relative to the largest."""
    free = particular(now.A, now.equal)[1]
    J, M = now.J @ free, now.M[now.margins + phi / psi < CLOSE] @ free
    curvature = 2 * J.T @ J + psi * M.T @ M
    size = felt(np.sqrt(curvature.diagonal()))
    values, axes = eigh(curvature / np.outer(size, size))
    return np.asarray(free @ (axes / np.sqrt(np.maximum(values, 0) + damping) / size[:, None]))


def _equal(y: ndarray, now: Linearised) -> ndarray:
    """Nearest y that meets the linearised equalities."""
    width = 1 / felt(norm(now.J, axis=0))
    return np.asarray(y + width * particular(now.A * width, -now.equal)[0])
