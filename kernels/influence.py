"""The influence function of each bond length, (4), compiled for each number of coefficients."""

from functools import cache

import warp as wp

BLOCK = 256
"""Lengths of a thread, which takes D and α once, and gives their derivatives once."""


@cache
def influence(terms):
    """K(r) = r^(−α) Σ_k D_k binom(M,k) t^k (1−t)^(M−k), t = min(r/δ, 1), ln r given.

    Products of powers have no gradient, for bonds keep their lengths; so their loops need not be
    unrolled.
    """
    numbers, vector = wp.array(dtype=wp.float64), wp.types.vector(terms, wp.float64)

    @wp.func
    def powers(t: wp.float64) -> vector:
        found = vector()
        power = wp.float64(1.0)
        for k in range(terms):
            found[k] = power
            power = power * t
        power = wp.float64(1.0)
        for k in range(terms):
            found[terms - 1 - k] *= power
            power = power * (wp.float64(1.0) - t)
        return found

    @wp.func_grad(powers)
    def no_gradient(t: wp.float64, adj_ret: vector):
        pass

    @wp.kernel(module="unique", module_options={"max_unroll": 0})
    def influence(
        first: wp.int32,
        horizon: wp.float64,
        binomials: wp.array(dtype=vector),
        r: numbers,
        log_r: numbers,
        alpha: numbers,
        D: wp.array(dtype=vector),
        K: numbers,
    ):
        begin = BLOCK * (first + wp.tid())
        a = alpha[0]
        d = wp.cw_mul(D[0], binomials[0])
        for n in range(begin, wp.min(begin + BLOCK, r.shape[0])):
            t = wp.min(r[n] / horizon, wp.float64(1.0))
            K[n] = wp.exp(-a * log_r[n]) * wp.dot(d, powers(t))

    return influence
