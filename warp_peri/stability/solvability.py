"""How far from singular the operator is on given nodes, symmetric or not (theory.md, 48)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from warp_peri.lps.matrices import matrices
from warp_peri.lps.model import Model
from warp_peri.points.families import families_of
from warp_peri.points.quadrature import DEGREE
from warp_peri.points.samples import PointsLike

DENSE = 1500
"""Numbers of unknowns up to which eigenvalues are computed densely."""


@dataclass(frozen=True)
class Solvability:
    """Figures of L on the unknown displacements of a point set.

    Attributes:
        symmetric_min: smallest eigenvalue of (L + Lᵗ)/2 [TPa/Å²]; above 0, every Dirichlet problem
            on the nodes has exactly one solution.
        singular_min: smallest singular value of L [TPa/Å²]; above 0, this one has.
        asymmetry: ‖L − Lᵗ‖ / ‖L + Lᵗ‖ in the Frobenius norm; rounding on lattices.
        negative_weights: share of the interior nodes' bonds whose quadrature weight is below zero.
    """

    symmetric_min: float
    singular_min: float
    asymmetry: float
    negative_weights: float


def solvability(
    model: Model, points: PointsLike, *, quadrature_degree: int = DEGREE
) -> Solvability:
    """Smallest eigenvalue of (L + Lᵗ)/2 and smallest singular value of L on the interior.

    On scattered points W_ij ≠ W_ji, so that L is not symmetric and no certificate speaks for it.

    Args:
        model: the model; certified or not.
        points: a lattice or scattered points.
        quadrature_degree: as for LPSOperator.

    Raises InputError for a point set that does not carry the horizon.
    """
    L = matrices(model, points, quadrature_degree=quadrature_degree).operator(model.lam, model.mu)
    A = sp.csc_array(L[:, np.repeat(points.interior, points.x.shape[1])])
    symmetric = (A + A.T) / 2
    asymmetry = sp.linalg.norm(A - A.T) / (2 * sp.linalg.norm(symmetric))
    negative = _negative_weights(model, points, quadrature_degree)
    smallest = smallest_eigenvalue(symmetric)
    if A.shape[0] <= DENSE:
        singular = np.linalg.svd(A.toarray(), compute_uv=False)[-1]
        return Solvability(float(smallest), float(singular), float(asymmetry), negative)
    try:
        factors = splu(A)
    except RuntimeError:  # exactly singular
        return Solvability(float(smallest), 0.0, float(asymmetry), negative)
    squared = LinearOperator(A.shape, lambda v: factors.solve(factors.solve(v, "T")))
    singular = 1 / np.sqrt(eigsh(squared, which="LM", tol=1e-8, **_one(A))[0])
    return Solvability(float(smallest), float(singular), float(asymmetry), negative)


def _negative_weights(model: Model, points: PointsLike, degree: int) -> float:
    families = families_of(points, model.horizon, bond_based=model.bond_based, degree=degree)
    if families.lattice is not None:
        weight = families.weight[families.lattice.bond_class]
    else:
        of_node = np.repeat(np.arange(len(points.x)), np.diff(families.row))
        weight = families.weight[points.interior[of_node]]
    return float(np.mean(weight < 0))


def smallest_eigenvalue(symmetric: sp.csc_array) -> float:
    """Smallest eigenvalue of a symmetric matrix; dense for few unknowns."""
    if symmetric.shape[0] <= DENSE:
        return float(np.linalg.eigvalsh(symmetric.toarray())[0])
    return float(eigsh(symmetric, which="SA", tol=1e-6, **_one(symmetric))[0])


def _one(matrix: sp.csc_array) -> dict[str, Any]:
    """One eigenvalue, from the fixed start."""
    start = lanczos_start(matrix.shape[0])
    return {"k": 1, "ncv": 80, "v0": start, "return_eigenvectors": False}


def lanczos_start(size: int) -> np.ndarray:
    """A start of Lanczos iterations, shape [size], the same every time so that results repeat.

    It has no symmetry of the body's: ones would be orthogonal to half of a symmetric body's modes.
    """
    return np.random.default_rng(0).standard_normal(size)
