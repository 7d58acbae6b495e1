"""Factors of positive definite matrices: full, banded or sparse ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.linalg import cho_solve_banded, cholesky_banded, lapack

from warp_peri.stability.inertia import definite_factors

DENSE = 1200
"""Unknowns up to which a matrix is eliminated as a full one: tangents have hundreds in each row."""


LARGEST_BAND = 4 * 10**7
"""Entries of a band that is eliminated as one, in a quarter of the time of sparse factors."""


class FullFactors:
    """Cholesky's factors of a full matrix."""

    def __init__(self, factor: np.ndarray) -> None:
        self.factor = factor

    def solve(self, y: np.ndarray) -> np.ndarray:
        """K⁻¹ y by the factors."""
        x: np.ndarray = lapack.dpotrs(self.factor, y, lower=1)[0].reshape(y.shape)
        return x


class BandFactors:
    """Cholesky's factors of a banded matrix, as rows of nodes on a lattice have it."""

    def __init__(self, factor: np.ndarray) -> None:
        self.factor, self.shape = factor, (factor.shape[1],) * 2

    def solve(self, y: np.ndarray) -> np.ndarray:
        """K⁻¹ y by the factors."""
        return np.asarray(cho_solve_banded((self.factor, True), y, check_finite=False))


def _banded(K: sp.csc_matrix) -> np.ndarray | None:
    """The lower triangle by diagonals; None where they are too many, or entries no numbers."""
    below = sp.tril(K, format="coo")
    away = below.row - below.col
    if (away.max() + 1) * K.shape[0] > LARGEST_BAND or not np.isfinite(below.data).all():
        return None
    band = np.zeros((away.max() + 1, K.shape[0]))
    band[away, below.col] = below.data
    return band


def positive_factors(K: sp.csc_matrix) -> Any:
    """Factors with a `solve` of a symmetric matrix where it is positive definite, else None."""
    if K.shape[0] > DENSE:
        if (band := _banded(K)) is None:
            return definite_factors(K)
        try:
            return BandFactors(cholesky_banded(band, True, True, check_finite=False))
        except np.linalg.LinAlgError:
            return None
    factor, fault = lapack.dpotrf(K.toarray(order="F"), lower=1, overwrite_a=1, clean=0)
    # LAPACK need not call numbers that are none a fault
    return None if fault or not np.isfinite(factor.diagonal()).all() else FullFactors(factor)
