"""The influence function of each bond class and its adjoint, (4); compiled for each degree."""

from functools import cache

import warp as wp


@cache
def influence(degree, scalar):
    """K(r) W = W r^(−α) Σ_k D_k binom(M,k) t^k (1−t)^(M−k), t = min(r/δ, 1).

    The loop over k is unrolled: Warp's adjoint is wrong for products built up in a dynamic loop.
    """
    terms = degree + 1

    @wp.kernel(module="unique", module_options={"max_unroll": degree + 2})
    def influence(
        first: wp.int32,
        horizon: scalar,
        binomial: wp.array(dtype=scalar),
        r: wp.array(dtype=scalar),
        weight: wp.array(dtype=scalar),
        alpha: wp.array(dtype=scalar),
        D: wp.array(dtype=scalar),
        kw: wp.array(dtype=scalar),
    ):
        c = first + wp.tid()
        t = wp.min(r[c] / horizon, scalar(1.0))
        power = scalar(1.0)
        total = scalar(0.0)
        for k in range(terms):
            total = total * (scalar(1.0) - t) + D[k] * binomial[k] * power
            power = power * t
        kw[c] = weight[c] * wp.exp(-alpha[0] * wp.log(r[c])) * total

    return influence


@cache
def influence_adjoint(degree, scalar):
    """From ∂/∂(K W) of the classes first ≤ c < last: gradient[block] = ∂/∂D_0 … ∂/∂D_M, ∂/∂α."""
    terms = degree + 1
    coefficients = wp.types.vector(terms, scalar)

    @wp.kernel(module="unique", enable_backward=False)
    def influence_adjoint(
        block: wp.int32,
        first: wp.int32,
        last: wp.int32,
        horizon: scalar,
        binomial: wp.array(dtype=scalar),
        r: wp.array(dtype=scalar),
        weight: wp.array(dtype=scalar),
        alpha: wp.array(dtype=scalar),
        D: wp.array(dtype=scalar),
        kw_bar: wp.array(dtype=scalar),
        gradient: wp.array2d(dtype=scalar),
    ):
        by_D = coefficients()
        by_alpha = scalar(0.0)
        for c in range(first, last):
            t = wp.min(r[c] / horizon, scalar(1.0))
            scale = kw_bar[c - first] * weight[c] * wp.exp(-alpha[0] * wp.log(r[c]))
            basis = coefficients()
            power = scale
            for k in range(terms):
                basis[k] = binomial[k] * power
                power = power * t
            power = scalar(1.0)
            total = scalar(0.0)
            for n in range(terms):
                k = degree - n
                basis[k] = basis[k] * power
                power = power * (scalar(1.0) - t)
                total = total + D[k] * basis[k]
            by_D = by_D + basis
            by_alpha = by_alpha - wp.log(r[c]) * total
        for k in range(terms):
            gradient[block, k] = by_D[k]
        gradient[block, terms] = by_alpha

    return influence_adjoint
