"""The influence function K(r) = r^(−α) Σ_k D_k B_k,M(r/δ) (theory.md, equation 4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import comb

from warp_peri.errors import InputError
from warp_peri.points.arrays import check_whole

ALPHA_BOUND = 3.0
"""The quadrature is consistent for α below this (You et al. 2021, remark 1)."""


CANCELLED = 1e-10
"""A weighted volume below this fraction of the sum of its terms' sizes counts as zero."""
LARGEST_DEGREE = 1000
"""Above 1029 the binomial coefficients are no floating-point numbers."""


def bernstein_basis(r: ArrayLike, horizon: float, degree: int) -> np.ndarray:
    """Bernstein polynomials B_k,M(r/δ), shape [..., M + 1].

    Args:
        r: bond lengths [Å] in [0, δ]; a rounding error beyond δ counts as δ.
        horizon: δ [Å].
        degree: M from 0 to LARGEST_DEGREE.
    """
    check_whole("degree", degree, 0)
    if degree > LARGEST_DEGREE:
        raise InputError(f"degree: expected at most {LARGEST_DEGREE}, got {degree}")
    t = np.minimum(np.asarray(r, dtype=float) / horizon, 1.0)[..., None]
    k = np.arange(degree + 1)
    basis: np.ndarray = comb(degree, k) * t**k * (1 - t) ** (degree - k)
    return basis
