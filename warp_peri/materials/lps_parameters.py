"""The numbers of a linear peridynamic solid: λ, μ, and the influence function of α and D."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import comb

from warp_peri.errors import InputError
from warp_peri.points.arguments import typed
from warp_peri.points.arrays import checked
from warp_peri.protocols import is_tensor

ALPHA_BOUND = 3.0
"""The quadrature is consistent for α below this (You et al. 2021, remark 1)."""
LARGEST_DEGREE = 1000
"""Above 1029 the binomial coefficients are no floating-point numbers."""


def bernstein_basis(r: ArrayLike, horizon: float, degree: int) -> np.ndarray:
    """Bernstein polynomials B_k,M(r/δ), shape [..., M + 1].

    Args:
        r: bond lengths [Å] in [0, δ]; a rounding error beyond δ counts as δ.
        horizon: δ [Å].
        degree: M from 0 to LARGEST_DEGREE.
    """
    if degree > LARGEST_DEGREE:
        raise InputError(f"degree: expected at most {LARGEST_DEGREE}, got {degree}")
    t = np.minimum(np.asarray(r, dtype=float) / horizon, 1.0)[..., None]
    k = np.arange(degree + 1)
    basis: np.ndarray = comb(degree, k) * t**k * (1 - t) ** (degree - k)
    return basis


@typed
@dataclass(frozen=True, eq=False)
class LPSParameters:
    """λ, μ, α and the Bernstein coefficients of the influence function (theory, 4–9).

    Numbers and arrays, or torch tensors with their gradients.

    Attributes:
        lam: Lamé parameter λ [TPa].
        mu: Lamé parameter μ, the shear modulus [TPa].
        alpha: exponent α < 3.
        D: Bernstein coefficients, shape [M + 1].

    Raises InputError where λ, μ or α is no single real number, D no list of them, and for α ≥ 3.
    """

    lam: Any
    mu: Any
    alpha: Any
    D: Any

    def __post_init__(self) -> None:
        given = vars(self).items()
        found = {n: checked(n, v.detach().cpu() if is_tensor(v) else v) for n, v in given}
        for name, value in found.items():
            if name != "D" and value.size != 1:
                raise InputError(
                    f"{name}: expected one number of a homogeneous solid, got shape "
                    f"{list(value.shape)}"
                )
        check_influence(found["alpha"].item(), np.atleast_1d(found["D"]))

    def values(self) -> tuple[Any, ...]:
        """λ, μ, α and D."""
        return self.lam, self.mu, self.alpha, self.D


def check_influence(alpha: float, D: np.ndarray) -> None:
    """Raise InputError for an exponent or coefficients that make no influence function."""
    if D.ndim != 1:
        raise InputError(f"D: expected a list of numbers, got lists of shape {list(D.shape)}")
    if len(D) == 0:
        raise InputError("D: expected at least one coefficient (degree ≥ 0), got none")
    if len(D) > LARGEST_DEGREE + 1:
        raise InputError(f"D: expected at most {LARGEST_DEGREE + 1}, got {len(D)} of them")
    if not alpha < ALPHA_BOUND:
        raise InputError(f"alpha: expected less than {ALPHA_BOUND:g}, got {alpha}")
