"""Factors of positive definite matrices: full ones of small bodies, sparse ones of others."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.linalg import lapack

from warp_peri.stability.inertia import definite_factors

DENSE = 1200
"""Unknowns up to which a matrix is eliminated as a full one: tangents have hundreds in each row."""


class FullFactors:
    """Cholesky's factors of a full matrix."""

    def __init__(self, factor: np.ndarray) -> None:
        self.factor = factor

    def solve(self, y: np.ndarray) -> np.ndarray:
        """K⁻¹ y by the factors."""
        x: np.ndarray = lapack.dpotrs(self.factor, y, lower=1)[0].reshape(y.shape)
        return x


def positive_factors(K: sp.csc_matrix) -> Any:
    """Factors with a `solve` of a symmetric matrix where it is positive definite, else None."""
    if K.shape[0] > DENSE:
        return definite_factors(K)
    factor, fault = lapack.dpotrf(K.toarray(order="F"), lower=1, overwrite_a=1, clean=0)
    # LAPACK need not call numbers that are none a fault
    return None if fault or not np.isfinite(factor.diagonal()).all() else FullFactors(factor)
