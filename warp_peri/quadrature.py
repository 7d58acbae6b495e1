"""Quadrature weights of one family, exact on a singular reproducing space (theory.md, 7–8)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import beta

from warp_peri.errors import InputError

DEGREE = 5
SINGULARITY = 3
RESIDUAL = 1e-10
"""Largest relative residual of the exactness conditions that is accepted."""


def quadrature_weights(xi: ArrayLike, horizon: float) -> np.ndarray:
    """Minimum-norm weights W with Σ_j W_j q(ξ_j) = ∫ q over the ball.

    q = ξ₁ᵃ ξ₂ᵇ / r³ with 2 ≤ a + b ≤ 5: the quintic polynomials whose quotient is integrable in
    two dimensions (Trask et al. 2019; You et al. 2021, section 3.2).

    Args:
        xi: bond vectors of the family [Å], shape [B, 2], none of them zero.
        horizon: δ [Å].

    Returns:
        W [Å²], shape [B].

    Raises InputError when no weights meet the conditions (the family is too poor).
    """
    xi = np.asarray(xi, dtype=float) / horizon
    r = np.hypot(*xi.T)
    powers = [(p - b, b) for p in range(SINGULARITY - 1, DEGREE + 1) for b in range(p + 1)]
    rows = np.array([xi[:, 0] ** a * xi[:, 1] ** b / r**SINGULARITY for a, b in powers])
    exact = np.array([_ball_integral(a, b) for a, b in powers])
    weights = np.linalg.lstsq(rows, exact, rcond=1e-12)[0]
    residual = np.abs(rows @ weights - exact).max() / np.abs(exact).max()
    if residual > RESIDUAL:
        raise InputError(
            f"quadrature: no weights are exact for a family of {len(xi)} bonds (relative residual "
            f"{residual:.1e}, allowed {RESIDUAL:.0e}); a larger horizon has more bonds"
        )
    return weights * horizon**2


def _ball_integral(a: int, b: int) -> float:
    """∫ ξ₁ᵃ ξ₂ᵇ / r³ over the unit ball."""
    if a % 2 or b % 2:
        return 0.0
    return 2 * beta((a + 1) / 2, (b + 1) / 2) / (a + b + 2 - SINGULARITY)
