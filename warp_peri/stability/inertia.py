"""Elimination of sparse symmetric matrices in place, whose pivots have the eigenvalues' signs."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu


def symmetric_factors(matrix: sp.sparray | sp.spmatrix) -> Any:
    """Sparse factors with pivots on the diagonal. Raises RuntimeError for a singular matrix."""
    return splu(
        sp.csc_matrix(matrix),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )


def pivots(factors: Any) -> np.ndarray | None:
    """Pivots of symmetric_factors, signed as the eigenvalues are (Sylvester's law of inertia).

    None where one was zero, so that rows were exchanged.
    """
    if not np.array_equal(factors.perm_r, factors.perm_c):
        return None
    signed: np.ndarray = factors.U.diagonal()
    return signed


def definite_factors(matrix: sp.sparray | sp.spmatrix) -> Any:
    """The factors of a symmetric matrix where it is positive definite, else None."""
    try:
        factors = symmetric_factors(matrix)
    except RuntimeError:  # exactly singular
        return None
    signed = pivots(factors)
    return factors if signed is not None and (signed > 0).all() else None
