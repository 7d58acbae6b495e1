"""Equilibria of a law on nodes with displacement given around them, or on a period (T15)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warp_peri.errors import InputError
from warp_peri.micromodulus.coarse import Filter, multigrid, sine, torus_inverse

if TYPE_CHECKING:
    from warp_peri.micromodulus.operator import Operator

METHODS = ("auto", "fft", "sine", "multigrid", "cg")
MOST_ITERATIONS = 1500
RESTARTS = 2
FLAT = 20_000
"""Unknown nodes from which a method whose iterations do not grow is worth its set-up."""


@dataclass
class SolveRecord:
    """What a solve took: iterations of conjugate gradients, the method, and the true ‖L u − b‖/‖b‖
    of the right-hand side that the collar leaves, the worst of all fields."""

    method: str
    iterations: int = 0
    residual: float = 0.0


def solve(
    operator: Operator,
    b: np.ndarray,
    u: np.ndarray,
    *,
    method: str = "auto",
    tolerance: float = 1e-8,
) -> tuple[np.ndarray, SolveRecord]:
    """Displacement [S, N, d] with L u = b at the interior nodes and u as given elsewhere.

    Args:
        operator: of a law whose certificate holds; in float64.
        b: loads [stress/length] on all nodes, shape [S, N, d] or [N, d].
        u: displacement on all nodes; only the collar's is read. On a period nothing is, and the
            answer's mean is zero.
        method: "sine" for boxes, "multigrid" for any mask, "fft" (the inverse symbol), "cg"
            without a preconditioner, or "auto".
        tolerance: of the true relative residual.

    Raises InputError for shapes, a method that does not fit, or a solve that stalls.
    """
    fields, lead = operator.checked(u)
    loads = operator.checked(b)[0]
    if loads.shape != fields.shape:
        raise InputError(f"b: expected shape {list(fields.shape)}, got {list(loads.shape)}")
    nodes, points = operator.nodes, operator.points
    asked = points.interior[:, None]
    filtered, method = _preconditioner(operator, method)
    record = SolveRecord(method)
    answer = np.where(asked, 0.0, fields)
    right = nodes.lay_out(np.where(asked, loads, 0.0))
    if nodes.periodic:
        right = right[(slice(None), slice(None), *nodes.core)]
        right = right - right.mean(axis=tuple(range(2, right.ndim)), keepdims=True)
    else:
        right = right - operator.pull(nodes.lay_out(answer))
    for n, one in enumerate(right):
        z = _conjugate_gradients(_product(operator), filtered, one, tolerance, record)
        answer[n, points.interior] = nodes.take_up(z[None])[0]
    return answer.reshape(*lead, *answer.shape[1:]), record


def _product(operator: Operator) -> Callable[[np.ndarray], np.ndarray]:
    """L of planes [d, *box] that are zero off the unknowns, there."""
    nodes = operator.nodes
    around = [(0, 0), *[(nodes.reach,) * 2] * nodes.dimension]

    def product(field: np.ndarray) -> np.ndarray:
        wide = np.pad(field, around, mode="wrap") if nodes.periodic else field
        return np.asarray(operator.pull(wide[None])[0])

    return product


def _preconditioner(operator: Operator, method: str) -> tuple[Filter, str]:
    """z ≈ L⁻¹ r, of the law in its own units, and what it is called."""
    nodes, steps, elastic = operator.nodes, operator.steps, operator.elastic
    if operator.dtype != np.float64:
        raise InputError(f"dtype: expected float64 for a solve, got {operator.dtype}")
    if method not in METHODS:
        raise InputError(f"method: expected one of {', '.join(METHODS)}, got {method!r}")
    h2 = operator.spacing**2
    tensors = operator.tensors * h2
    box = bool(nodes.periodic or nodes.mask()[nodes.core].all())
    if method == "auto":
        large = len(nodes.interior) > FLAT and not nodes.periodic
        method = ("sine" if box else "multigrid") if large else "fft"
    if nodes.periodic and method in ("sine", "multigrid"):
        method = "fft"
    if method == "sine" and not box:
        raise InputError("method: sine is for boxes of nodes; try multigrid")
    if method == "cg":
        middle = 2 * float(tensors[:, 0, 0].sum())
        return (lambda r: r * (h2 / middle)), method
    if method == "fft":
        inner = torus_inverse(nodes, steps, tensors)
    else:
        make = sine if method == "sine" else multigrid
        inner = make(nodes, steps, tensors, elastic)
    return (lambda r: inner(r) * h2), method


def _conjugate_gradients(
    product: Callable[[np.ndarray], np.ndarray],
    filtered: Filter,
    right: np.ndarray,
    tolerance: float,
    record: SolveRecord,
) -> np.ndarray:
    """u with L u = right to a true relative residual; adds what it took to the record."""
    size = float(np.linalg.norm(right))
    u = np.zeros_like(right)
    if size == 0:
        return u
    scale = float(np.abs(right).max())  # squares of very small and very large loads are no numbers
    right = right / scale
    size = float(np.linalg.norm(right))
    taken, left = 0, right
    for _ in range(1 + RESTARTS):
        r = left.copy()
        z = filtered(r)
        p, rz = z.copy(), float(np.vdot(r, z))
        while np.linalg.norm(r) > 0.9 * tolerance * size and taken < MOST_ITERATIONS:
            q = product(p)
            energy = float(np.vdot(p, q))
            if not (energy > 0 and rz > 0):
                raise InputError(
                    f"the operator on these nodes is indefinite: a direction has the energy "
                    f"{energy:.1e}; is the law certified?"
                )
            taken += 1
            step = rz / energy
            u += step * p
            r -= step * q
            z = filtered(r)
            last, rz = rz, float(np.vdot(r, z))
            p *= rz / last
            p += z
        left = right - product(u)
        residual = float(np.linalg.norm(left)) / size
        if residual <= tolerance or taken >= MOST_ITERATIONS:
            break
    record.iterations = max(record.iterations, taken)
    record.residual = max(record.residual, residual)
    if residual > tolerance:
        raise InputError(
            f"the solve stalled: residual {residual:.1e} after {taken} iterations, "
            f"{tolerance:.1e} was asked for; is the law certified?"
        )
    return u * scale
