"""Equilibria of a law on nodes with displacement given around them, or on a period (T15)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warp_peri.errors import InputError
from warp_peri.micromodulus.coarse import Filter, multigrid, sine, torus_inverse
from warp_peri.statics.conjugate_gradients import SolveRecord, definite

if TYPE_CHECKING:
    import torch

    from warp_peri.micromodulus.operator import Operator

METHODS = ("auto", "fft", "sine", "multigrid", "cg")
FLAT = 20_000
"""Unknown nodes from which a method whose iterations do not grow is worth its set-up."""


@dataclass
class Solved(SolveRecord):
    """What solves took, the worst of all fields, and the method."""

    method: str = ""


def solve(
    operator: Operator,
    b: np.ndarray,
    u: np.ndarray,
    *,
    method: str = "auto",
    tolerance: float = 1e-8,
) -> tuple[np.ndarray, Solved]:
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
    record, product = Solved(method=method), _product(operator)
    answer = np.where(asked, 0.0, fields)
    right = nodes.lay_out(np.where(asked, loads, 0.0))
    if nodes.periodic:
        right = right[(slice(None), slice(None), *nodes.core)]
        right = right - right.mean(axis=tuple(range(2, right.ndim)), keepdims=True)
    else:
        right = right - operator.pull(nodes.lay_out(answer))
    for n, one in enumerate(right):
        z, took = definite(
            lambda p: _tensor(product(p.numpy())),
            lambda r: _tensor(filtered(r.numpy())),
            _tensor(one),
            tolerance,
            hint="; is the law certified?",
        )
        record.iterations = max(record.iterations, took.iterations)
        record.residual = max(record.residual, took.residual)
        answer[n, points.interior] = nodes.take_up(z.numpy()[None])[0]
    return answer.reshape(*lead, *answer.shape[1:]), record


def _tensor(field: np.ndarray) -> torch.Tensor:
    import torch

    return torch.from_numpy(np.ascontiguousarray(field, dtype=float))


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
