"""Steady and transient diffusion with φ given on the collar (theory.md, D1 and D4)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.sparse.linalg import splu

from warp_peri.diffusion.operator import DiffusionOperator
from warp_peri.errors import InputError

RESIDUAL = 1e-9


def steady(
    operator: DiffusionOperator, phi: np.ndarray, source: np.ndarray | float = 0.0
) -> np.ndarray:
    """φ with L φ = source on the interior, given on all other nodes.

    Args:
        operator: the operator.
        phi: holds the given values, shape [N].
        source: g, one or by interior node, shape [I].

    Raises InputError for other shapes, values that are not finite, and when the matrix is singular,
    as of a piece that nothing touches, or has eigenvalues below zero (`DiffusionOperator.inner`).
    """
    matrix, inner = operator.matrix(), operator.inner()
    solved = _shaped("phi", phi, len(operator.points.x))
    solved[operator.rows] = 0
    right = _source(source, len(operator.rows)) - matrix @ _finite("phi", solved)
    try:
        x = splu(inner).solve(right)
    except RuntimeError as error:
        raise InputError(f"diffusion: the problem has no one solution ({error})") from None
    if np.linalg.norm(inner @ x - right) > RESIDUAL * np.linalg.norm(right):
        raise InputError("diffusion: the solve lost its digits")
    solved[operator.rows] = x
    return solved


def transient(
    operator: DiffusionOperator,
    phi: np.ndarray,
    step: float,
    steps: int,
    *,
    source: np.ndarray | float = 0.0,
    collar: Callable[[float], np.ndarray] | None = None,
) -> np.ndarray:
    """∂φ/∂t = −L φ + source by Crank–Nicolson; φ at every step, shape [steps + 1, N].

    Args:
        operator: the operator.
        phi: at the start, shape [N].
        step: Δt > 0, any length is stable: L + Lᵗ is looked at where the kernel changes sign.
        steps: number of steps.
        source: g, one or by interior node, shape [I].
        collar: φ of all nodes at a time, of which those off the interior are taken; unchanged by
            default.

    Raises InputError for other shapes, a step not > 0, a number of steps below 0, and as
    `DiffusionOperator.inner`.
    """
    if not (0 < step < np.inf and isinstance(steps, (int, np.integer)) and steps >= 0):
        raise InputError(
            f"step: expected a number > 0 and a whole number of steps ≥ 0, got {step} and {steps}; "
            "`steady` solves the state at rest"
        )
    count = len(operator.points.x)
    matrix, rows = operator.matrix(), operator.rows
    factors = splu(sp.csc_matrix(sp.eye_array(len(rows)) + step / 2 * operator.inner()))
    now = _finite("phi", _shaped("phi", phi, count))
    gain = step * _source(source, len(rows))
    kept = [now]
    for number in range(1, steps + 1):
        later = now.copy()
        if collar is not None:
            later = _shaped("collar", collar(number * step), count)
        later[rows] = 0
        right = now[rows] - step / 2 * (matrix @ now + matrix @ _finite("collar", later)) + gain
        later[rows] = factors.solve(right)
        now = later
        kept.append(now)
    return np.stack(kept)


def _shaped(name: str, values: ArrayLike, count: int) -> np.ndarray:
    field = np.array(values, dtype=float)
    if field.shape != (count,):
        raise InputError(f"{name}: expected shape [{count}], got {list(field.shape)}")
    return field


def _finite(name: str, field: np.ndarray) -> np.ndarray:
    if not np.isfinite(field).all():
        raise InputError(f"{name}: expected finite values where they are given")
    return field


def _source(source: np.ndarray | float, count: int) -> np.ndarray:
    values = np.asarray(source, dtype=float)
    values = values if values.ndim else np.full(count, values)
    return _finite("source", _shaped("source", values, count))
