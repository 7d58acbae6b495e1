"""The influence function of each bond class and its adjoint, (4); compiled for each degree.

Both also take many bonds of scattered points at a time, in vector registers of the processor.
"""

from functools import cache
from math import factorial
from types import SimpleNamespace

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
    """The same two kernels, log r given; of at least so many bonds as there are lanes."""
    lanes = BYTES // wp.types.type_size_in_bytes(scalar)
    integer, bias, digits, most, high, low, terms = NUMBERS[scalar]
    series = (f"p = p * y + REAL({1 / factorial(k)!r});" for k in range(terms, -1, -1))
    constants = {"SERIES": " ".join(series), "INT": integer, "BIAS": bias, "DIGITS": digits}
    constants |= {"MOST": f"REAL({most})", "HIGH": repr(high), "LOW": repr(low), "DEGREE": degree}
    constants |= {"REAL": f"wp::{scalar.__name__}", "LANES": lanes, "CHUNK": CHUNK}

    def native(body):
        text = POWER + body
        for name, value in constants.items():
            text = text.replace(name, str(value))
        return wp.func_native(text)

    @native(VALUES)
    def values(
        chunk: wp.int32,
        horizon: scalar,
        binomial: wp.array(dtype=scalar),
        r: wp.array(dtype=scalar),
        weight: wp.array(dtype=scalar),
        log_r: wp.array(dtype=scalar),
        alpha: wp.array(dtype=scalar),
        D: wp.array(dtype=scalar),
        kw: wp.array(dtype=scalar),
    ): ...

    @wp.kernel(enable_backward=False, module="unique")
    def influence_by_lanes(
        first: wp.int32,
        horizon: scalar,
        binomial: wp.array(dtype=scalar),
        r: wp.array(dtype=scalar),
        weight: wp.array(dtype=scalar),
        log_r: wp.array(dtype=scalar),
        alpha: wp.array(dtype=scalar),
        D: wp.array(dtype=scalar),
        kw: wp.array(dtype=scalar),
    ):
        values(first + wp.tid(), horizon, binomial, r, weight, log_r, alpha, D, kw)

    @native(GRADIENT)
    def gradients(
        block: wp.int32,
        first: wp.int32,
        last: wp.int32,
        horizon: scalar,
        binomial: wp.array(dtype=scalar),
        r: wp.array(dtype=scalar),
        weight: wp.array(dtype=scalar),
        log_r: wp.array(dtype=scalar),
        alpha: wp.array(dtype=scalar),
        D: wp.array(dtype=scalar),
        kw_bar: wp.array(dtype=scalar),
        gradient: wp.array2d(dtype=scalar),
    ): ...

    @wp.kernel(enable_backward=False, module="unique")
    def influence_adjoint_by_lanes(
        block: wp.int32,
        first: wp.int32,
        last: wp.int32,
        horizon: scalar,
        binomial: wp.array(dtype=scalar),
        r: wp.array(dtype=scalar),
        weight: wp.array(dtype=scalar),
        log_r: wp.array(dtype=scalar),
        alpha: wp.array(dtype=scalar),
        D: wp.array(dtype=scalar),
        kw_bar: wp.array(dtype=scalar),
        gradient: wp.array2d(dtype=scalar),
    ):
        gradients(
            block, first, last, horizon, binomial, r, weight, log_r, alpha, D, kw_bar, gradient
        )

    return SimpleNamespace(values=influence_by_lanes, adjoint=influence_adjoint_by_lanes)
