"""The influence function of each bond class, (4), compiled for each number of coefficients."""

from functools import cache

import warp as wp

BLOCK = 256
"""Classes of a thread, which takes D and α once, and gives their derivatives once."""


@cache
def influence(terms):
    """K(r) W = W r^(−α) Σ_k D_k binom(M,k) t^k (1−t)^(M−k), t = min(r/δ, 1), ln r given.

    The basis has no gradient, for bonds keep their lengths; so its loops need not be unrolled.
    """
    numbers, vector = wp.array(dtype=wp.float64), wp.types.vector(terms, wp.float64)

    @wp.func
    def basis(t: wp.float64, binomial: numbers) -> vector:
        found = vector()
        power = wp.float64(1.0)
        for k in range(terms):
            found[k] = binomial[k] * power
            power = power * t
        power = wp.float64(1.0)
        for k in range(terms):
            found[terms - 1 - k] = found[terms - 1 - k] * power
            power = power * (wp.float64(1.0) - t)
        return found

    @wp.func_grad(basis)
    def no_gradient(t: wp.float64, binomial: numbers, adj_ret: vector):
        pass

    @wp.kernel(module="unique", module_options={"max_unroll": 0})
    def influence(
        first: wp.int32,
        horizon: wp.float64,
        binomial: numbers,
        r: numbers,
        log_r: numbers,
        weight: numbers,
        alpha: numbers,
        D: wp.array(dtype=vector),
        kw: numbers,
    ):
        begin = BLOCK * (first + wp.tid())
        a = alpha[0]
        d = D[0]
        for c in range(begin, wp.min(begin + BLOCK, r.shape[0])):
            t = wp.min(r[c] / horizon, wp.float64(1.0))
            kw[c] = weight[c] * wp.exp(-a * log_r[c]) * wp.dot(d, basis(t, binomial))

    return influence
