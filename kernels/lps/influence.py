"""The influence function of each bond class and its adjoint, (4); compiled for each degree.

For the processor there are kernels without a tape that take many bonds at a time.
"""

from functools import cache
from math import factorial
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.bonds import unpacked


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


BYTES, CHUNK = 128, 64
"""Of all lanes together, two of the widest registers; how many of those an index goes through."""
NUMBERS = {  # exponents; ln 2 in two parts, n times the first being exact; Taylor's terms
    wp.float64: (
        "long long",
        1023,
        52,
        708,
        6.93147180369123816490e-01,
        1.90821492927058770e-10,
        13,
    ),
    wp.float32: ("int", 127, 23, 87, 0.693359375, -2.12194440e-4, 7),
}
POWER = """
    typedef REAL V __attribute__((ext_vector_type(LANES)));
    typedef REAL At __attribute__((ext_vector_type(LANES), aligned(sizeof(REAL))));  // any place
    typedef INT I __attribute__((ext_vector_type(LANES)));
    const auto power_of = [&](V log_r) {  // r^(−α) = 2^n exp(y), |y| ≤ ln 2/2
        V x = __builtin_elementwise_min(-alpha.data[0] * log_r, V(MOST));
        x = __builtin_elementwise_max(x, V(-MOST));
        const V n = __builtin_elementwise_rint(x * REAL(1.44269504088896340736));
        const V y = (x - n * REAL(HIGH)) - n * REAL(LOW);
        V p = 0;
        SERIES
        const I exponent = (__builtin_convertvector(n, I) + BIAS) << DIGITS;
        return p * __builtin_bit_cast(V, exponent);
    };
"""
VALUES = """
    const int size = r.shape[0], begin = chunk * CHUNK * LANES, past = begin + CHUNK * LANES;
    for (int e = begin; e < past && e < size; e += LANES) {
        const int at = e + LANES <= size ? e : size - LANES;  // the last ones once more
        const V t = __builtin_elementwise_min(*(const At*)(r.data + at) / horizon, V(1));
        V power = 1, total = 0;
        for (int k = 0; k <= DEGREE; ++k) {
            total = total * (REAL(1) - t) + D.data[k] * binomial.data[k] * power;
            power *= t;
        }
        total *= power_of(*(const At*)(log_r.data + at));
        *(At*)(kw.data + at) = *(const At*)(weight.data + at) * total;
    }
"""
GRADIENT = """
    V by_D[DEGREE + 1] = {}, by_alpha = 0;
    for (int e = first; e < last; e += LANES) {
        REAL given[4][LANES] = {};  // zeros beyond the last, of which nothing comes
        for (int l = 0; l < LANES && e + l < last; ++l) {
            given[0][l] = r.data[e + l];
            given[1][l] = log_r.data[e + l];
            given[2][l] = weight.data[e + l];
            given[3][l] = kw_bar.data[e - first + l];
        }
        const V t = __builtin_elementwise_min(*(const At*)given[0] / horizon, V(1));
        const V log_r = *(const At*)given[1];
        V power = *(const At*)given[3] * *(const At*)given[2] * power_of(log_r), total = 0;
        V basis[DEGREE + 1];
        for (int k = 0; k <= DEGREE; ++k) {
            basis[k] = binomial.data[k] * power;
            power *= t;
        }
        power = 1;
        for (int k = DEGREE; k >= 0; --k) {
            basis[k] *= power;
            power *= REAL(1) - t;
            total += D.data[k] * basis[k];
            by_D[k] += basis[k];
        }
        by_alpha -= log_r * total;
    }
    for (int k = 0; k <= DEGREE + 1; ++k) {
        REAL sums[LANES], sum = 0;
        *(At*)sums = k <= DEGREE ? by_D[k] : by_alpha;
        for (int l = 0; l < LANES; ++l)
            sum += sums[l];
        gradient.data[block * gradient.shape[1] + k] = sum;
    }
"""


@cache
def by_lanes(degree, scalar):
    """K W of many bonds at a time, and the adjoint of it, log r given."""
    lanes = BYTES // wp.types.type_size_in_bytes(scalar)
    integer, bias, digits, most, high, low, terms = NUMBERS[scalar]
    series = (f"p = p * y + REAL({1 / factorial(k)!r});" for k in range(terms, -1, -1))
    constants = {"SERIES": " ".join(series), "INT": integer, "BIAS": bias, "DIGITS": digits}
    constants |= {"MOST": f"REAL({most})", "HIGH": repr(high), "LOW": repr(low), "DEGREE": degree}
    constants |= {"REAL": f"wp::{scalar.__name__}", "LANES": lanes, "CHUNK": CHUNK}

    def native(body):
        for name, value in constants.items():
            body = body.replace(name, str(value))
        return wp.func_native(body)

    @wp.struct
    class Powers:
        horizon: scalar
        binomial: wp.array(dtype=scalar)
        r: wp.array(dtype=scalar)
        weight: wp.array(dtype=scalar)
        log_r: wp.array(dtype=scalar)
        alpha: wp.array(dtype=scalar)
        D: wp.array(dtype=scalar)

    array, table = wp.array(dtype=scalar), wp.array2d(dtype=scalar)

    @native(unpacked(Powers) + POWER + VALUES)
    def values(chunk: wp.int32, of: Powers, kw: array): ...

    @wp.kernel(enable_backward=False, module="unique")
    def influence_by_lanes(first: wp.int32, of: Powers, kw: array):
        """K W of so many bonds as a chunk has, at least as many as there are lanes."""
        values(first + wp.tid(), of, kw)

    @native(unpacked(Powers) + POWER + GRADIENT)
    def gradients(
        block: wp.int32, first: wp.int32, last: wp.int32, of: Powers, kw_bar: array, gradient: table
    ): ...

    @wp.kernel(enable_backward=False, module="unique")
    def influence_adjoint(
        block: wp.int32, first: wp.int32, last: wp.int32, of: Powers, kw_bar: array, gradient: table
    ):
        """From ∂/∂(K W) of the bonds first ≤ e < last: gradient[block] = ∂/∂D_0 … ∂/∂D_M, ∂/∂α."""
        gradients(block, first, last, of, kw_bar, gradient)

    return SimpleNamespace(
        Powers=Powers, size=CHUNK * lanes, values=influence_by_lanes, adjoint=influence_adjoint
    )
