"""Polak and Ribière's conjugate directions: equilibria of any law, from its force alone."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike

from warp_peri.errors import InputError
from warp_peri.points.arrays import checked, checked_fields
from warp_peri.statics.solution import PolakRibiere, Solution

TRIAL = 1e-3
"""First trial step, as a share of the distance between nodes."""


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


def at_rest(operator: Any, b: ArrayLike | None, u: ArrayLike, asked: PolakRibiere) -> Solution:
    """The equilibrium of an operator of any law under b, u given on the collar.

    Args:
        operator: a material on points.
        b: load [stress/length], shape [N, d] or [S, N, d], or [N] or [S, N] of a scalar field;
            None for none. Only interior values count.
        u: displacement [length], same shape; only collar values count.
        asked: tolerance, steps and start.

    The details of the solution are a Descent for each sample. Raises InputError for arrays that do
    not fit, and for a sample without an equilibrium, naming it.
    """
    x, inside = operator.points.x, operator.points.interior
    given = checked("u", u, read=False)
    axes = 2 if given.ndim > 1 and given.shape[-2] == len(x) else 1
    one = (len(x), *given.shape[given.ndim - axes + 1 :])
    load, given = checked_fields(operator.points, b, u, one)
    mask = inside.reshape(-1, *(axes - 1) * [1])
    held, loads = np.where(mask, 0.0, given).reshape(-1, *one), load.reshape(-1, *one)
    starts = _starts(asked.start, given.shape, one, len(held))
    trial = TRIAL * float(np.ptp(x, axis=0).max()) / len(x) ** (1 / x.shape[1])
    found: list[np.ndarray] = []
    records: list[Descent] = []
    for number, (field, force) in enumerate(zip(held, loads)):
        before = found[-1] if found else field
        start = np.where(mask, before if starts is None else starts[number], field)
        answer, record = _one(operator, field, start, operator.load(force), asked, trial)
        if not record.converged:
            raise InputError(
                f"sample {number}: no equilibrium was found; residual {record.residual:.1e} after "
                f"{record.steps} steps, {asked.tolerance:.1e} was asked for"
            )
        found.append(answer)
        records.append(record)
    return Solution(
        np.stack(found).reshape(given.shape),
        operator.points,
        operator,
        operator.load(load),
        "polak-ribière",
        tuple(record.steps for record in records),
        details=tuple(records),
        measured=max(record.residual for record in records),
    )


def _starts(
    start: Any, shape: tuple[int, ...], one: tuple[int, ...], count: int
) -> np.ndarray | None:
    """Where each search begins, shape [S, N, d]; None for the answer of the sample before."""
    if isinstance(start, str):
        return None
    fields = np.zeros(one) if start is None else checked("start", start)
    if fields.shape not in (one, shape):
        raise InputError(f"start: expected shape {[*one]} or {[*shape]}, got {[*fields.shape]}")
    return np.broadcast_to(fields.reshape(-1, *one), (count, *one))


def _one(
    operator: Any,
    held: np.ndarray,
    start: np.ndarray,
    load: np.ndarray,
    asked: PolakRibiere,
    trial: float,
) -> tuple[np.ndarray, Descent]:
    """One equilibrium, its residual over that of the collar alone."""
    inside, field = operator.points.interior, start.copy()

    def left(inner: torch.Tensor) -> torch.Tensor:
        field[inside] = inner.numpy()
        return torch.as_tensor(operator(field) - load)

    scale = float(np.linalg.norm(operator(held) - load))
    first = float(np.linalg.norm(operator(start) - load))
    if first <= asked.tolerance * scale:
        return start, Descent(0, first / scale if scale else 0.0, True)
    share = first / (scale or first)
    inner, record = polak_ribiere(
        left,
        torch.as_tensor(start[inside]),
        tolerance=asked.tolerance / share,
        most=asked.most,
        trial=trial,
    )
    field[inside] = inner.numpy()
    return field, Descent(record.steps, share * record.residual, record.converged)
