"""CG methods on one process or many: conjugate gradients, Newton with GMRES.

Of fields that ranks have pieces of too: scalar products are those of `Inner`, and so the answer has
the same bits on any number of ranks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from warp_peri.errors import InputError

MOST_ITERATIONS = 1500
RESTARTS = 2
"""Times that a solve goes on from where the true residual was found too large."""
Field = Callable[[Any], Any]


class Inner(NamedTuple):
    """Of fields: scalar product, norm, largest absolute value; u += a p in place of (u, a, p)."""

    dot: Callable[[Any, Any], float]
    norm: Callable[[Any], float]
    largest: Callable[[Any], float]
    add: Callable[[Any, float, Any], Any]


def _add(u: np.ndarray, a: float, p: np.ndarray) -> np.ndarray:
    u += a * p
    return u


HERE = Inner(
    lambda a, b: float(np.vdot(a, b)),
    lambda a: float(np.linalg.norm(a)),
    lambda a: float(np.abs(a).max(initial=0.0)),
    _add,
)
"""Of arrays that this process has the whole of."""


def norm(field: Any, inner: Inner = HERE) -> float:
    """‖field‖, also where the squares of very small and very large values are no numbers."""
    largest = inner.largest(field)
    return largest and largest * inner.norm(field / largest)


@dataclass
class SolveRecord:
    """What a solve took.

    Attributes:
        iterations: of conjugate gradients.
        residual: the true ‖L u − b‖ / ‖right-hand side‖ of the answer.
    """

    iterations: int = 0
    residual: float = 0.0


def definite(
    product: Field,
    precondition: Field,
    right: Any,
    tolerance: float,
    *,
    begin: Field | None = None,
    inner: Inner = HERE,
    where: str = "",
    hint: str = "",
) -> tuple[Any, SolveRecord]:
    """u with L u = right to a true relative residual, the tolerance, and its record.

    `precondition` makes z ≈ L⁻¹ r, in memory of its own; `begin` where a search for L u = r starts,
    zero by default. A field is an array, or what else `inner` measures. Of messages, `where` says
    which nodes, and `hint` what to try. Raises InputError when a direction has no positive energy,
    or the search stalls above the tolerance.
    """
    record, largest, u = SolveRecord(), inner.largest(right), right - right
    if largest == 0:
        return u, record

    def descend(r: Any) -> Any:
        """What the search adds, until the recursive residual meets the goal."""
        u, p, last = r - r if begin is None else begin(r), None, 1.0
        r = 1 * r if begin is None else r - product(u)
        while inner.norm(r) > 0.9 * tolerance * size and record.iterations < MOST_ITERATIONS:
            z = precondition(r)
            rz = inner.dot(r, z)
            if begin is not None and not rz > 0:
                break  # rounding of what the start answered, which the next start answers
            p = 1 * z if p is None else inner.add(z, rz / last, p)
            q = product(p)
            energy = inner.dot(p, q)
            if not (energy > 0 and rz > 0):
                shown = f"a direction has the energy {energy:.1e}"
                if energy > 0:
                    shown = f"the inverse of its waves answers a force with the work {rz:.1e}"
                raise InputError(f"the operator{where} is indefinite: {shown}")
            record.iterations += 1
            step, last = rz / energy, rz
            inner.add(u, step, p)
            inner.add(r, -step, q)
        return u

    right = right / largest  # squares of very small and very large loads are no numbers
    size, left = inner.norm(right), right
    for _ in range(1 + RESTARTS):
        u += descend(left)
        left = right - product(u)
        record.residual = inner.norm(left) / size
        if record.residual <= tolerance:
            return u * largest, record
        if record.iterations >= MOST_ITERATIONS:
            break
    raise InputError(
        f"the solve stalled: residual {record.residual:.1e} of the right-hand side after "
        f"{record.iterations} iterations, {tolerance:.1e} was asked for; the operator{where} is "
        f"nearly singular{hint}"
    )


FORCED, MOST, VECTORS = 0.03, 40, 30
"""Residual that GMRES leaves of a step's equation, most steps, and most vectors of a step."""
APART = 1e-6
"""Difference that the derivative is taken over, relative to the field."""
SHORTEST, DESCENT = 2.0**-8, 1e-4
"""Shortest share of a step that is tried, and what of its promise it must keep (Armijo)."""

Residual = Callable[[np.ndarray], np.ndarray]


def newton(residual: Residual, start: np.ndarray, tolerance: float) -> np.ndarray:
    """Where a preconditioned residual vanishes, as far as it comes.

    Args:
        residual: of a field, near the identity times what is missing.
        start: a field.
        tolerance: of the residual's norm.
    """
    v, r = start, residual(start)
    size = HERE.norm(r)
    for _ in range(MOST):
        if not tolerance < size < np.inf:
            break
        step, share = _newton_step(residual, v, r), 1.0
        while share >= SHORTEST:
            there = residual(v + share * step)
            new = HERE.norm(there)
            if new <= (1 - DESCENT * share) * size:
                break
            share /= 2
        else:
            break  # no share of the step descends
        v, r, size = v + share * step, there, new
    return v


def _newton_step(residual: Residual, v: np.ndarray, r: np.ndarray) -> np.ndarray:
    """p with a derivative along p at v of −r, the residual there, to FORCED, by GMRES."""
    apart = APART * (HERE.norm(v) or 1.0)

    def slope(p: np.ndarray) -> np.ndarray:
        t = apart / HERE.norm(p)
        return np.asarray((residual(v + t * p.reshape(v.shape)) - r) / t).ravel()

    J = LinearOperator(2 * (v.size,), matvec=slope, dtype=float)
    p, _ = gmres(J, -r.ravel(), rtol=FORCED, restart=VECTORS, maxiter=1)
    return np.asarray(p.reshape(v.shape))
