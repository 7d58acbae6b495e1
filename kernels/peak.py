"""As many additions and multiplications as a core can do in compiled code: a roof."""

from functools import cache

import warp as wp

WIDTH = 64
"""Bytes of a vector register."""
IN_FLIGHT = 8
"""Sums, and products, that do not wait for one another."""


@cache
def peak(scalar):
    """A kernel that only computes, and how many sums and as many products a turn of it makes."""
    lanes = WIDTH // wp.types.type_size_in_bytes(scalar)
    body = """
    typedef REAL lane __attribute__((ext_vector_type(LANES)));
    lane s[FLIGHT], p[FLIGHT];
    for (int n = 0; n < FLIGHT; ++n)
        p[n] = s[n] = REAL(n) * x;
    for (int t = 0; t < turns; ++t)
        for (int n = 0; n < FLIGHT; ++n) {
            s[n] += x;
            p[n] *= x;
        }
    REAL total = 0;
    for (int n = 0; n < FLIGHT; ++n)
        for (int l = 0; l < LANES; ++l)
            total += s[n][l] + p[n][l];
    out.data[0] = total;
    """
    for name, value in (
        ("REAL", f"wp::{scalar.__name__}"),
        ("LANES", lanes),
        ("FLIGHT", IN_FLIGHT),
    ):
        body = body.replace(name, str(value))

    @wp.func_native(body)
    def work(turns: wp.int32, x: scalar, out: wp.array(dtype=scalar)): ...

    @wp.kernel(enable_backward=False, module="unique")
    def compute(turns: wp.int32, x: scalar, out: wp.array(dtype=scalar)):
        work(turns, x, out)

    return compute, lanes * IN_FLIGHT
