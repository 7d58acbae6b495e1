"""The constrained optimum by Adam and an augmented Lagrangian (theory, 28b).

Conditions have slacks as in Algorithm 1 of You et al. (2021): m(y) − ϖ² = 0. Adam works in
coordinates x in which the curvature of the Lagrangian, as Gauss and Newton take it, is one in each
direction. In λ, μ, α and D it spans twenty orders, and no rate of steps suits them all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from scipy.linalg import block_diag

from warp_peri.fitting.regression import (
    LatticeRows,
    Linearised,
    Numbers,
    Regression,
    Settled,
    felt,
    particular,
)

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
        size = felt(np.sqrt(curvature.diagonal()))
        values, axes = np.linalg.eigh(curvature / np.outer(size, size))
        frame = axes / np.sqrt(np.maximum(values, 0) + damping) / size[:, None]
        self.frame = free @ frame

    def __call__(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Its value and its derivative, shape [X]."""
        y, slacks = np.split(self.start + self.frame @ x, [self.size])
        now = self.state(y)
        missed = now.margins - slacks**2
        value = float(now.loss + self.phi @ missed + self.psi / 2 * missed @ missed)
        push = self.phi + self.psi * missed
        slope = np.append(2 * now.residual @ now.J + push @ now.M, -2 * slacks * push)
        return value, slope @ self.frame

    def multiplied(self, now: Linearised) -> tuple[np.ndarray, float]:
        """φ of the next round, slacks at their best, and the most that a condition is missed by."""
        missed = now.margins - np.maximum(now.margins + self.phi / self.psi, 0)
        return self.phi + self.psi * missed, float(np.abs(missed).max())


def augmented_lagrangian(
    blocks: Sequence[LatticeRows],
    law: Callable[[np.ndarray], Numbers],
    theta: np.ndarray,
    zeta: float,
    *,
    steps: int,
    rounds: int,
    tick: Callable[[float], None] = lambda loss: None,
) -> tuple[Settled, float]:
    """Minimise a loss under the conditions over the whole zone, from one start.

    Args:
        blocks: rows of the loss on each lattice; their sum is minimised.
        law: what θ stands for.
        theta: where to begin.
        zeta: ζ [stress].
        steps: of Adam in a round.
        rounds: at most, each with its own multipliers, coordinates and waves to keep.
        tick: called with the loss after every step.

    Returns the result, and of ζ, how little a margin of it may miss.
    """
    problem = Regression(blocks, law, zeta, 1.0)
    y = _equal(problem, theta)
    damping, penalty, slack, before = DAMPING, PENALTY, SLACK, np.inf
    now, margin = problem.state(y), -np.inf
    multipliers, losses = np.zeros(len(now.margins)), [now.loss]
    for _ in range(rounds):
        lagrangian = _Lagrangian(problem.state, y, multipliers, penalty * now.loss, slack, damping)
        x, gain = _adam(lagrangian, steps, tick)
        if not gain >= 0:
            damping *= 10
            continue
        y = _equal(problem, (lagrangian.start + lagrangian.frame @ x)[: len(y)])
        now = problem.state(y)
        multipliers, missed = lagrangian.multiplied(now)
        margin = problem.look(law(y))
        new = len(problem.state(y).margins) - len(multipliers)
        multipliers = np.append(multipliers, np.zeros(new))
        losses.append(now.loss)
        met = margin >= -TOLERANCE and missed <= TOLERANCE
        if met and abs(losses[-2] - now.loss) <= 0.1 * TOLERANCE * now.loss:
            break
        if missed > max(DECREASE * before, TOLERANCE):
            penalty = min(GROWTH * penalty, MOST_PENALTY)
        before = missed
        if abs(losses[-2] - now.loss) <= NEAR * now.loss:
            slack = max(SHORTENED * slack, LEAST_SLACK)
        damping = max(EASED * damping, LEAST_DAMPING)
    return problem.found(y, losses, margin), TOLERANCE


def _equal(problem: Regression, y: np.ndarray) -> np.ndarray:
    """The nearest y that meets the equalities, as they are linear about it."""
    now = problem.state(y)
    width = 1 / felt(np.linalg.norm(now.J, axis=0))
    met: np.ndarray = y + width * particular(now.A * width, -now.equal)[0]
    return met


def _adam(
    lagrangian: _Lagrangian, steps: int, tick: Callable[[float], None]
) -> tuple[np.ndarray, float]:
    """The x that Adam ends at from 0, its rate falling as a cosine, and what it gains."""
    x = np.zeros(lagrangian.frame.shape[1])
    leaf = torch.from_numpy(x).requires_grad_()  # shares the memory of x
    first, slope = lagrangian(x)
    optimiser = torch.optim.Adam(
        [leaf], lr=RATE * float(np.linalg.norm(slope)), betas=MOMENTS, eps=1e-300
    )
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    value = first
    for _ in range(steps):
        leaf.grad = torch.from_numpy(slope)
        optimiser.step()
        schedule.step()
        tick(value)
        value, slope = lagrangian(x)
    return x, first - value
