"""Quadrature weights of families, exact on a singular reproducing space (theory, 7–8, V4)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import warp as wp
from numpy.typing import ArrayLike
from scipy.special import beta

from warp_peri.errors import InputError
from warp_peri.kernels import quadrature as kernels
from warp_peri.points.arguments import check_whole, listed
from warp_peri.points.points import nearest
from warp_peri.runtime import floats, ints, launch_slices, zeros

DEGREE = 5
SINGULARITY = 3
RESIDUAL = 1e-10
"""Largest relative residual of the exactness conditions that is accepted."""
DEPENDENT = 1e-12
"""Singular values below this fraction of the largest count as zero."""
INDEPENDENT = 1e-4
"""Pivots of the Gram matrix, by their roots, above this fraction of the largest need no SVD, which
takes a hundred times as long."""


def quadrature_weights(xi: ArrayLike, horizon: float, *, degree: int = DEGREE) -> np.ndarray:
    """Minimum-norm quadrature weights W of a family with Σ_j W_j q(ξ_j) = ∫ q over the ball, [Å^d],
    [B].

    q = p / r³ with monomials p of 4 − d ≤ degree of p ≤ degree: those whose quotient is integrable
    in d dimensions (Trask et al. 2019; You et al. 2021, section 3.2).

    Args:
        xi: bond vectors of the family [Å], shape [B, d], d = 2 or 3, none of them zero.
        horizon: δ [Å].
        degree: of the polynomials, at least 2.

    Raises InputError when no weights meet the conditions (the family is too poor).
    """
    xi = np.asarray(xi, dtype=float)
    weights, residual = family_weights(xi, horizon, degree=degree)
    if residual > RESIDUAL:
        raise InputError(
            f"quadrature: no weights are exact for a family of {len(xi)} bonds (relative residual "
            f"{residual:.1e}, allowed {RESIDUAL:.0e}); a larger horizon has more bonds"
        )
    return weights


def family_weights(
    xi: np.ndarray, horizon: float, *, degree: int = DEGREE
) -> tuple[np.ndarray, float]:
    """Weights as of `quadrature_weights`, by the SVD, and the largest relative residual."""
    powers, exact = conditions(degree, xi.shape[1])
    scaled = xi / horizon
    rows = np.array([(scaled**p).prod(axis=1) for p in powers])
    rows /= np.linalg.norm(scaled, axis=1) ** SINGULARITY
    left, size, right = np.linalg.svd(rows, full_matrices=False)
    large = size > DEPENDENT * size[0]
    weights = np.divide(exact @ left, size, out=np.zeros_like(size), where=large) @ right
    residual = np.abs(rows @ weights - exact).max() / np.abs(exact).max()
    return weights * horizon ** xi.shape[1], float(residual)


def conditions(degree: int, dimension: int) -> tuple[list[tuple[int, ...]], np.ndarray]:
    """Exponents of the Q polynomials in d variables, and their integrals over the unit ball, [Q];
    InputError for a degree that is no whole number ≥ 2."""
    check_whole("quadrature degree", degree, SINGULARITY - 1)
    lowest = SINGULARITY + 1 - dimension
    every = itertools.product(range(degree, -1, -1), repeat=dimension)
    powers = sorted((p for p in every if lowest <= sum(p) <= degree), key=sum)
    return powers, np.array([ball_integral(p, SINGULARITY) for p in powers])


def ball_integral(powers: Sequence[int], exponent: float) -> float:
    """Integral ∫ ξ₁ᵃ ξ₂ᵇ … r^(−exponent) over the unit ball in as many dimensions as powers."""
    if any(n % 2 for n in powers):
        return 0.0
    sphere, half = 2.0, (powers[0] + 1) / 2
    for n in powers[1:]:
        sphere *= beta(half, (n + 1) / 2)
        half += (n + 1) / 2
    return float(sphere / (sum(powers) + len(powers) - exponent))


FAMILY = 50
"""How much more than a node's sweep its weights take a thread."""


def weights(
    x: np.ndarray,
    nodes: np.ndarray,
    row: np.ndarray,
    neighbour: np.ndarray,
    box: tuple[float, ...] | None,
    horizon: float,
    degree: int,
) -> np.ndarray:
    """Quadrature weights of the families of `nodes` [Å^d], zero on all other bonds, shape [E];
    InputError naming the nodes whose family is too poor."""
    d = x.shape[1]
    powers, exact = conditions(degree, d)
    vec = wp.types.vector(d, wp.float64)
    links = (floats(x, vec), ints(row), ints(neighbour), vec(*(box or d * (0.0,))))
    found = zeros(len(neighbour)), zeros(len(nodes))
    inputs = (ints(nodes), *links, horizon, INDEPENDENT, floats(exact))
    kernel = kernels.family_weights(tuple(powers))
    launch_slices(kernel, len(nodes), inputs, found, weight=FAMILY)
    weight, residual = (array.numpy() for array in found)
    for n in np.flatnonzero(residual < 0):  # normal equations do not do near a line
        bonds = slice(*row[nodes[n] : nodes[n] + 2])
        xi = nearest(x[neighbour[bonds]] - x[nodes[n]], box)
        weight[bonds], residual[n] = family_weights(xi, horizon, degree=degree)
    if len(poor := nodes[~(residual <= RESIDUAL)]):
        raise InputError(
            f"quadrature: no weights are exact for the families of {len(poor)} nodes: "
            f"{listed(np.sort(poor))}; a larger horizon has more bonds"
        )
    return np.asarray(weight)
