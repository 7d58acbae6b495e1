"""The constrained optimum by Adam and an augmented Lagrangian (theory.md, 28b).

Conditions have slacks as in Algorithm 1 of You et al. (2021): m(y) − ϖ² = 0. Adam works in
coordinates x in which the curvature of the Lagrangian, as Gauss and Newton take it, is one in each
direction. In λ, μ, α and D it spans twenty orders, and no rate of steps suits them all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from scipy.linalg import block_diag

from warp_peri.core.tensors import differentiable_once
from warp_peri.regression.coordinates import Parameters
from warp_peri.regression.losses import ReducedLoss
from warp_peri.regression.optimum import (
    ConstrainedProblem,
    LatticeConditions,
    Reached,
    coordinates_of,
)
from warp_peri.regression.search import Linearised, particular
from warp_peri.regression.settings import Optimum

RATE, MOMENTS = 0.05, (0.9, 0.99)
"""First rate of a round's steps, over the size of its first gradient, and Adam's two averages."""
DAMPING, LEAST_DAMPING, EASED = 0.1, 1e-7, 0.3
"""Of curvatures in parts of the largest: in the first round, at least, and from round to round."""
PENALTY, MOST_PENALTY, GROWTH = 0.3, 3.0, 4.0
"""ψ over the loss: at first, at most, and how it grows."""
DECREASE = 0.25
"""ψ grows where a round leaves more than this of what conditions missed before."""
SLACK, LEAST_SLACK, SHORTENED, NEAR = 2.0, 1e-3, 0.7, 0.05
"""Slacks that a round starts from, at least: at first, in the end, and after each round that
changed the loss by no more than NEAR, relative. A small one bends too much for long steps."""
TOLERANCE = 1e-5
"""Of ζ: conditions are met; and relative: the loss is settled at 0.1 of it."""
FELT = 1e-6
"""Of the largest curvature: others count as this much at least."""


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


known_values: Callable[..., torch.Tensor] = _Known.apply
"""known_values(evaluate, *inputs): evaluate gives values [V] and slopes [V, all inputs]."""


class _Lagrangian:
    """‖r‖² + φᵗ h + ψ/2 ‖h‖², h = m − ϖ², as a function of x; equalities bound where it may go.

    Args:
        state: of the problem.
        y: where x = 0 is.
        multipliers: φ.
        penalty: ψ.
        slack: the least ϖ at x = 0.
        damping: added to each curvature, in parts of the largest.
    """

    def __init__(
        self,
        state: Callable[[np.ndarray], Linearised],
        y: np.ndarray,
        multipliers: np.ndarray,
        penalty: float,
        slack: float,
        damping: float,
    ) -> None:
        self.state, self.phi, self.psi, self.size = state, multipliers, penalty, len(y)
        now = state(y)
        slacks = np.sqrt(np.maximum(now.margins + multipliers / penalty, slack**2))
        self.start = np.append(y, slacks)
        push = multipliers + penalty * (now.margins - slacks**2)
        free = block_diag(particular(now.A, now.equal)[1], np.eye(len(slacks)))
        slopes = np.hstack([now.M, np.diag(-2 * slacks)]) @ free
        J = now.J @ free[: len(y)]
        own = free[len(y) :] * np.maximum(-2 * push, 0)[:, None]
        curvature = 2 * J.T @ J + penalty * slopes.T @ slopes + free[len(y) :].T @ own
        size = np.sqrt(curvature.diagonal())
        size = np.maximum(size, FELT * size.max())
        values, axes = np.linalg.eigh(curvature / np.outer(size, size))
        frame = axes / np.sqrt(np.maximum(values, 0) + damping) / size[:, None]
        self.frame = free @ frame

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Its value, shape [1], and derivative, [1, X]."""
        y, slacks = np.split(self.start + self.frame @ x, [self.size])
        now = self.state(y)
        missed = now.margins - slacks**2
        value = now.loss + self.phi @ missed + self.psi / 2 * missed @ missed
        push = self.phi + self.psi * missed
        slope = np.append(2 * now.residual @ now.J + push @ now.M, -2 * slacks * push)
        return np.array([value]), (slope @ self.frame)[None]

    def multiplied(self, now: Linearised) -> tuple[np.ndarray, float]:
        """φ of the next round, slacks at their best, and the most that a condition is missed by."""
        missed = now.margins - np.maximum(now.margins + self.phi / self.psi, 0)
        return self.phi + self.psi * missed, float(np.abs(missed).max())


def augmented_lagrangian(
    grids: Sequence[ReducedLoss],
    start: Parameters,
    conditions: Sequence[LatticeConditions],
    method: Optimum,
    *,
    steps: int,
    rounds: int,
    two_functions: bool = False,
    tick: Callable[[float], None] = lambda loss: None,
) -> Reached:
    """Minimise the reduced loss under the conditions over the whole zone, from one start.

    Args:
        grids: the reduced loss of each lattice; their sum is minimised.
        start: where to begin.
        conditions: what must hold on each of the lattices.
        method: moduli to hold, and the smoothness.
        steps: of Adam in a round.
        rounds: at most, each with its own multipliers, coordinates and waves to keep.
        two_functions: give the dilatation coefficients of its own.
        tick: called with the loss after every step.
    """
    coordinates = coordinates_of(
        [grid.classes for grid in grids], start, two_functions=two_functions
    )
    problem = ConstrainedProblem(grids, conditions, coordinates, method.held, method.smoothness)
    zeta, y = problem.asked[0].zeta, _equal(problem, coordinates.start(start))
    damping, penalty, slack, before = DAMPING, PENALTY, SLACK, np.inf
    now, margin = problem.state(y), -np.inf
    multipliers, losses = np.zeros(len(now.margins)), [now.loss]
    for _ in range(rounds):
        lagrangian = _Lagrangian(problem.state, y, multipliers, penalty * now.loss, slack, damping)
        x = _adam(lagrangian, steps, tick)
        if not lagrangian(x)[0] <= lagrangian(0 * x)[0]:
            damping *= 10
            continue
        y = _equal(problem, (lagrangian.start + lagrangian.frame @ x)[: len(y)])
        now = problem.state(y)
        multipliers, missed = lagrangian.multiplied(now)
        blocks, margin = problem.blocks, problem.look(coordinates.point(y))
        multipliers = _padded(multipliers, blocks, problem.blocks)
        losses.append(now.loss)
        met = margin >= -TOLERANCE * zeta and missed <= TOLERANCE
        if met and abs(losses[-2] - now.loss) <= 0.1 * TOLERANCE * now.loss:
            break
        if missed > max(DECREASE * before, TOLERANCE):
            penalty = min(GROWTH * penalty, MOST_PENALTY)
        before = missed
        if abs(losses[-2] - now.loss) <= NEAR * now.loss:
            slack = max(SHORTENED * slack, LEAST_SLACK)
        damping = max(EASED * damping, LEAST_DAMPING)
    return problem.reached(y, losses, margin, TOLERANCE)


def _equal(problem: ConstrainedProblem, y: np.ndarray) -> np.ndarray:
    """The nearest y that meets the equalities, as they are linear about it."""
    now = problem.state(y)
    width = np.linalg.norm(now.J, axis=0)
    width = 1 / np.maximum(width, FELT * width.max())
    met: np.ndarray = y + width * particular(now.A * width, -now.equal)[0]
    return met


def _adam(lagrangian: _Lagrangian, steps: int, tick: Callable[[float], None]) -> np.ndarray:
    """The x that Adam ends at from 0, its rate falling to nothing as a cosine."""
    zero = np.zeros(lagrangian.frame.shape[1])
    rate = RATE * float(np.linalg.norm(lagrangian(zero)[1]))
    x = torch.zeros(len(zero), dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.Adam([x], lr=rate, betas=MOMENTS, eps=1e-300)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in range(steps):
        optimiser.zero_grad()
        value = known_values(lagrangian, x).sum()
        value.backward()
        optimiser.step()
        schedule.step()
        tick(value.item())
    return np.array(x.detach().numpy())


def _padded(multipliers: np.ndarray, before: list[int], after: list[int]) -> np.ndarray:
    """Multipliers with zeros for the waves that were added to each block of conditions."""
    parts = np.split(multipliers, np.cumsum(before))
    added = [*(new - old for old, new in zip(before, after)), 0]
    return np.concatenate([np.append(part, np.zeros(n)) for part, n in zip(parts, added)])
