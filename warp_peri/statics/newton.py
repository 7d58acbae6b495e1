"""Newton's method with GMRES on differences of a preconditioned residual.

Of fields that ranks have pieces of too: scalar products are those of `Inner`, and so the answer has
the same bits on any number of ranks.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from warp_peri.statics.conjugate_gradients import Inner

FORCED, MOST, VECTORS = 0.03, 40, 30
"""Residual that GMRES leaves of a step's equation, most steps, and most vectors of a step."""
APART = 1e-6
"""Difference that the derivative is taken over, relative to the field."""
SHORTEST, DESCENT = 2.0**-8, 1e-4
"""Shortest share of a step that is tried, and what of its promise it must keep (Armijo)."""

Field = Callable[[np.ndarray], np.ndarray]


def newton(residual: Field, start: np.ndarray, tolerance: float, inner: Inner) -> np.ndarray:
    """Where a preconditioned residual vanishes, as far as it comes.

    Args:
        residual: of a field, near the identity times what is missing.
        start: a field.
        tolerance: of the residual's norm.
        inner: how fields are measured, over all ranks.
    """
    v, r = start, residual(start)
    size = inner.norm(r)
    for _ in range(MOST):
        if not tolerance < size < np.inf:
            break
        step, share = gmres(partial(_slope, residual, v, r, inner), -r, inner), 1.0
        while share >= SHORTEST:
            there = residual(v + share * step)
            new = inner.norm(there)
            if new <= (1 - DESCENT * share) * size:
                break
            share /= 2
        else:
            break  # no share of the step descends
        v, r, size = v + share * step, there, new
    return v


def _slope(
    residual: Field, v: np.ndarray, r: np.ndarray, inner: Inner, p: np.ndarray
) -> np.ndarray:
    """The derivative along p at v, where the residual is r."""
    t = APART * (inner.norm(v) or 1.0) / inner.norm(p)
    return np.asarray((residual(v + t * p) - r) / t)


def gmres(product: Field, right: np.ndarray, inner: Inner) -> np.ndarray:
    """p with product(p) = right to FORCED (Y. Saad and M. H. Schultz, 1986)."""
    size = inner.norm(right)
    basis, H = [right / size], np.zeros((VECTORS + 1, VECTORS))
    weights: Any = np.zeros(0)
    for n in range(VECTORS):
        w = product(basis[n])
        for k, q in enumerate(basis):
            H[k, n] = inner.dot(q, w)
            w = w - H[k, n] * q
        H[n + 1, n] = inner.norm(w)
        first = np.append(size, np.zeros(n + 1))
        weights = np.linalg.lstsq(H[: n + 2, : n + 1], first, rcond=None)[0]
        left = np.linalg.norm(first - H[: n + 2, : n + 1] @ weights)
        if left <= FORCED * size or not H[n + 1, n] > 0:
            break
        basis.append(w / H[n + 1, n])
    return np.asarray(sum(a * q for a, q in zip(weights, basis)))
