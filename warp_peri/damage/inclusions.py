"""Bodies of several materials: bond-wise μ and node-wise λ − μ (theory.md, C15)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from warp_peri.damage.lattice_body import Body
from warp_peri.damage.operator import cut_matrix
from warp_peri.errors import InputError
from warp_peri.stability.inertia import definite_factors

SAMPLES = 32
"""Places along a bond at which a field of moduli is read."""
MEANS = ("series", "harmonic", "arithmetic")


def bond_modulus(
    body: Body, mu: np.ndarray | Callable[[np.ndarray], np.ndarray], mean: str = "series"
) -> np.ndarray:
    """μ of each bond, the same in both directions, shape [N, B].

    Args:
        body: the body.
        mu: a function of positions [..., 2]; or, other than for "series", by node, shape [N].
        mean: "series" reads the function along the bond and adds compliances; "harmonic" and
            "arithmetic" take the two ends.

    Raises InputError for another mean, for values by node with "series", which must know what lies
    between them, and where moduli that are read, at nodes or between, are not finite and > 0.
    """
    if mean not in MEANS:
        raise InputError(f"mean: expected one of {', '.join(MEANS)}, got {mean!r}")
    at_nodes = np.asarray(mu(body.x) if callable(mu) else mu, dtype=float)
    if at_nodes.shape != (len(body.x),):
        raise InputError(f"mu: expected shape [{len(body.x)}], got {list(at_nodes.shape)}")
    _check_sign("mu: expected values > 0 that are finite", at_nodes, 1)
    far = np.maximum(body.neighbour, 0)
    near, other = at_nodes[:, None], at_nodes[far]
    if mean == "arithmetic":
        return np.asarray((near + other) / 2)
    if mean == "harmonic":
        return np.asarray(2 * near * other / (near + other))
    if not callable(mu):
        raise InputError(
            'mu: mean="series" reads a function of positions along the bonds, got values by node; '
            'mean="harmonic" takes these'
        )
    words = "mu: expected values > 0 that are finite all along the bonds"
    return 1 / _compliance(body, mu, words, 1, body.neighbour >= 0)


def _compliance(
    body: Body,
    field: Callable[[np.ndarray], np.ndarray],
    words: str,
    sign: float,
    read: np.ndarray,
) -> np.ndarray:
    """Mean of 1/field along each bond of the ball, 1 where it is not read, shape [N, B].

    Raises InputError with these words where a value that is read has not this sign.
    """
    total = np.zeros(body.neighbour.shape)
    for place in (np.arange(SAMPLES) + 0.5) / SAMPLES:
        values = np.asarray(field(body.x[:, None] + place * body.xi), dtype=float)
        values = np.where(read, values, sign)
        _check_sign(words, values, sign)
        total += 1 / values
    return total / SAMPLES


def _check_sign(words: str, values: np.ndarray, sign: float) -> None:
    if not (np.isfinite(values).all() and (np.sign(values) == sign).all()):
        wrong = values[~(np.isfinite(values) & (np.sign(values) == sign))]
        raise InputError(f"{words}, got {wrong[0]:g}")


def ball_excess(
    body: Body, weights: np.ndarray, excess: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """λ − μ of each node, [Σ_b w r² (mean of 1/(λ−μ) along b)]⁻¹, shape [N] (C15).

    Raises InputError where λ − μ, at nodes or between, has both signs, is zero or not finite; take
    it node by node there.
    """
    at_nodes = np.asarray(excess(body.x), dtype=float)
    sign = float(np.sign(at_nodes[0])) or 1.0  # zero is refused
    words = (
        "excess: expected λ − μ of one sign everywhere in the balls, finite; its values at the "
        "nodes are the way where it changes"
    )
    _check_sign(words, at_nodes, sign)
    compliance = _compliance(body, excess, words, sign, np.ones(body.neighbour.shape, bool))
    excess_of_balls: np.ndarray = 1 / (compliance @ (weights * body.r**2))
    return excess_of_balls


def mixed_matrix(
    body: Body, weights: np.ndarray, bond_mu: np.ndarray, excess: ArrayLike
) -> sp.csr_array:
    """L of a body of several materials, symmetric, shape [2N, 2N].

    Args:
        body: the body.
        weights: w of the ball, shape [B].
        bond_mu: μ by bond, shape [N, B].
        excess: λ − μ by node, shape [N].
    """
    return cut_matrix(body, weights, body.neighbour, bond_mu, np.asarray(excess, dtype=float))


def solve_mixed(matrix: sp.csr_array, held: np.ndarray, u: np.ndarray) -> np.ndarray:
    """u at rest without load, given at held nodes [N] bool; both of shape [N, 2].

    Raises InputError for other shapes, values that are not finite, and for moduli or holds that
    leave the body indefinite or loose.
    """
    count = matrix.shape[0] // 2
    held, given = np.asarray(held), np.array(u, dtype=float)
    if held.shape != (count,) or held.dtype != bool or given.shape != (count, 2):
        raise InputError(
            f"held, u: expected shapes [{count}] of bool and [{count}, 2], got "
            f"{list(held.shape)} and {list(given.shape)}"
        )
    free = np.repeat(~held, 2)
    solved = given.ravel()
    solved[free] = 0
    if not np.isfinite(solved).all():
        raise InputError("u: expected finite values at held nodes")
    right = -(matrix @ solved)[free]
    factors = definite_factors(sp.csc_array(matrix[free][:, free]))
    if factors is None:
        raise InputError(
            "mixed: the operator on the free nodes is not positive definite; hold the body, and "
            "expect λ + μ > 0 of its materials"
        )
    solved[free] = factors.solve(right)
    return solved.reshape(-1, 2)
