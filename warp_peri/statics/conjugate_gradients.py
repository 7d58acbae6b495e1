"""Polak–Ribière nonlinear conjugate gradients, for any law whose force torch differentiates."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class Descent:
    """What a search took.

    Attributes:
        steps: taken.
        residual: ‖force − b‖ over that of the start.
        converged: whether that is within the tolerance.
    """

    steps: int
    residual: float
    converged: bool


def polak_ribiere(
    unbalanced: Callable[[torch.Tensor], torch.Tensor],
    u: torch.Tensor,
    *,
    tolerance: float = 1e-3,
    most: int = 100,
    trial: float = 1e-3,
) -> tuple[torch.Tensor, Descent]:
    """Where the unbalanced force vanishes, found by conjugate directions and secant steps.

    Args:
        unbalanced: force(u) − b of the unknowns, of their shape; torch in, torch out.
        u: where to start, any shape [length].
        tolerance: of ‖unbalanced‖ over that of the start.
        most: steps, each of two evaluations.
        trial: length of the first trial step, as the largest component [length].

    The answer is differentiable in whatever `unbalanced` is, through every step; without gradients
    nothing is kept. The force need not have an energy; the search then may end before a zero, and
    it ends where a step leads to no number.
    """
    left = -unbalanced(u)
    first = float(left.detach().norm())
    record = Descent(0, 1.0, first == 0)
    direction = left
    length = trial / max(float(left.detach().abs().max()), torch.finfo(u.dtype).tiny)
    for step in range(most if first > 0 else 0):
        slope = (left * direction).sum()
        if slope.item() <= 0:  # no descent: start anew
            direction, slope = left, (left * left).sum()
        bend = slope + (unbalanced(u + length * direction) * direction).sum()
        # where the force does not rise along the direction: go on, and look again
        move = length * slope / bend if bend.item() > 0 else torch.full_like(slope, 2 * length)
        there = u + move * direction
        before, left = left, -unbalanced(there)
        size = float(left.detach().norm()) / first
        if not math.isfinite(size):
            break
        u, record = there, Descent(step + 1, size, size <= tolerance)
        if record.converged:
            break
        length = move.item()
        beta = (left * (left - before)).sum() / (before * before).sum()
        direction = left + torch.clamp(beta, min=0) * direction
    return u, record
