"""The influence function of each bond class, (4), compiled for each degree."""

from functools import cache

import warp as wp


@cache
def influence(degree):
    """K(r) W = W r^(−α) Σ_k D_k binom(M,k) t^k (1−t)^(M−k), t = min(r/δ, 1), ln r given.

    The loop over k is unrolled: Warp's adjoint is wrong for products built up in a dynamic loop.
    """
    terms = degree + 1
    numbers = wp.array(dtype=wp.float64)

    @wp.kernel(module="unique", module_options={"max_unroll": degree + 2})
    def influence(
        first: wp.int32,
        horizon: wp.float64,
        binomial: numbers,
        r: numbers,
        log_r: numbers,
        weight: numbers,
        alpha: numbers,
        D: numbers,
        kw: numbers,
    ):
        c = first + wp.tid()
        t = wp.min(r[c] / horizon, wp.float64(1.0))
        power = wp.float64(1.0)
        total = wp.float64(0.0)
        for k in range(terms):
            total = total * (wp.float64(1.0) - t) + D[k] * binomial[k] * power
            power = power * t
        kw[c] = weight[c] * wp.exp(-alpha[0] * log_r[c]) * total

    return influence
