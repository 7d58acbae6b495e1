"""A bound of the distance to the rich member's own solution, proven (theory.md, Q7–Q9)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_peri.points.lattice import lattice_steps
from warp_peri.prediction.placed import PlacedMembers
from warp_peri.third_order.uniqueness import curvature_bound

ACCURATE = 1e-5
"""Relative residual of the one solve that the bound takes."""


@dataclass(frozen=True)
class Guarantee:
    """What is proven of an answer: it speaks of the model, not of the atoms.

    Attributes:
        energy: bound of ‖u_rich − u‖_L [√(stress · length)] on the interior, ‖v‖²_L = Σ v·L v.
        relative: the same over ‖u‖_L.
        contraction: q of the fixed point; 0 of a linear member.
        largest_gradient: bound of |H| of u_rich, below the proven strain.
        without_solve: the same bound as `energy` from the certificate and the residual alone.
        displacement: bound of ‖u_rich − u‖₂ over ‖u‖₂.
        statement: in one sentence.
    """

    energy: float
    relative: float
    contraction: float
    largest_gradient: float
    without_solve: float
    displacement: float
    statement: str


def smallest_laplacian(points: Any) -> float:
    """A lower bound of λ₁ h² of the (2d + 1)-point Laplacian on the interior, of all ranks: that of
    its box."""
    if hasattr(points, "comm"):
        low, high = points.span
    else:
        grid = lattice_steps(points)[0][points.interior]
        low, high = grid.min(axis=0), grid.max(axis=0)
    sides = high - low + 1
    return float(sum(4 * np.sin(np.pi / 2 / (n + 1)) ** 2 for n in sides))


def guarantee(placed: PlacedMembers, load: np.ndarray, u: np.ndarray) -> Guarantee | None:
    """The bound for an answer u, or None where nothing is proven of the rich member there."""
    operator: Any = placed.rich
    points, inside = placed.points, placed.points.interior
    dot = placed.dot
    stiffness = proven_stiffness(operator, points.spacing)
    if not ((placed.on_ranks or points.is_plain_lattice) and stiffness > 0):
        return None
    smallest = stiffness * smallest_laplacian(points) / points.spacing**2

    def linear(v: np.ndarray) -> np.ndarray:
        field = np.zeros_like(u)
        field[inside] = v
        return placed.straight(field)

    r = load - operator(u)
    e = placed.inverse(r, ACCURATE)
    le = linear(e)
    rest = r - le
    # r·L⁻¹r = e·Le + 2 e·rest + rest·L⁻¹rest, and L ≥ smallest
    square = dot(e, le) + 2 * dot(e, rest) + dot(rest, rest) / smallest
    size, without = np.sqrt(max(square, 0.0)), placed.norm(r) / float(np.sqrt(smallest))
    q, largest = 0.0, 0.0
    if placed.nonlinear:
        found = contraction(operator, points.spacing, float(operator.largest_gradient(u)), size)
        if found is None:
            return None
        q, largest = found
    inner = u[inside]
    bound, whole = size / (1 - q), float(np.sqrt(max(dot(inner, linear(inner)), 0.0)))
    relative = bound / whole if whole > 0 else np.inf
    moved = bound / np.sqrt(smallest) / max(placed.norm(inner), 1e-300)
    words = (
        f"The model's own solution lies within {relative:.2g} of this answer in the energy norm"
        + (f", and no other has |H| ≤ {largest:.2%}." if placed.nonlinear else ".")
    )
    return Guarantee(bound, relative, q, largest, without / (1 - q), moved, words)


def contraction(
    operator: Any, spacing: float, gradient: float, size: float
) -> tuple[float, float] | None:
    """q and a radius ε for gradients that no iterate leaves; None where none is proven.

    From u on all iterates of the fixed point lie within size/(1 − q) of it in the energy norm, and
    their gradients, whose norm over all nodes is at most κ_in times that, below ε.
    """
    model = operator.model
    figures = model.proven
    figures = (
        figures.get(f"{model.linear.nominal_spacing(spacing):g}", {})
        if hasattr(model.linear, "nominal_spacing")
        else figures
    )
    names = ("strain", "kappa_in", "kappa_out", "largest_parts")
    if not all(name in figures for name in names):
        return None
    most, inner, outer, parts = (figures[name] for name in names)
    radius = gradient
    for _ in range(100):
        q = curvature_bound(parts, radius) * inner * outer
        if not (radius <= most and q < 1):
            return None
        needed = gradient + inner * size / (1 - q)
        if needed <= radius:
            return q, radius
        radius = 1.001 * needed
    return None


def proven_stiffness(operator: Any, spacing: float) -> float:
    """c with D(k) ≥ c s(k), proven [stress]; 0 without a certificate."""
    linear = getattr(operator.model, "linear", operator.model)
    proof = linear.certificate
    if isinstance(proof, dict):
        figures = proof.get(f"{linear.nominal_spacing(spacing):g}", {})
        return float(figures.get("symbol_bound") or 0.0)
    return float(getattr(proof, "proven", 0.0) or 0.0)
