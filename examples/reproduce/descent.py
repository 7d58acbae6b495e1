"""Jafarzadeh et al. 2024's search: Polak and Ribière's conjugate directions, with secant steps."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class Descent:
    """What a search took: its steps, ‖force‖ over that of the start, whether that was enough."""

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
    """Where the unbalanced force vanishes, differentiable through every step of the search.

    Args:
        unbalanced: force(u) − b of the unknowns, of their shape.
        u: where to start, any shape [length].
        tolerance: of ‖unbalanced‖ over that of the start.
        most: steps, each of two evaluations.
        trial: length of the first trial step, as the largest component [length].
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
