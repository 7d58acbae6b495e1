"""L u of a lattice by half families, many nodes of a row at a time (theory, T1).

A field is laid out in planes: component a of sample s at place q of a box of P places is
planes[s, a P + q]. Bond p leads from place q to q + offset[p], and its other half to q − offset[p];
both go through C(ξ)(2 u(x) − u(x + ξ) − u(x − ξ)) together. A piece is (first place, count):
count ≤ LANES nodes that follow one another. Each place is written by one piece, and every sum runs
over the bonds in their order, so that slices on threads change no bit.
For the processor only: the loops over lanes are C++, which Warp's compiler turns into vectors.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

BYTES = 128
"""Of all lanes of one component together."""

FORCE = """
    const int base = piece.c[0], count = piece.c[1];
    const size_t places = planes.shape[1] / DIM;
    const REAL* u = planes.data + size_t(s) * planes.shape[1] + base;
    REAL own[DIM][LANES], f[DIM][LANES] = {};
    for (int a = 0; a < DIM; ++a)
        for (int l = 0; l < LANES; ++l)
            own[a][l] = REAL(2) * u[a * places + l];
    for (int p = 0; p < offset.shape[0]; ++p) {
        const int step = offset.data[p];
        const REAL* c = tensors.data + size_t(p) * tensors.shape[1];
        REAL w[DIM][LANES];
        for (int a = 0; a < DIM; ++a) {
            const REAL* ahead = u + a * places + step;
            const REAL* behind = u + a * places - step;
            for (int l = 0; l < LANES; ++l)
                w[a][l] = own[a][l] - (ahead[l] + behind[l]);
        }
        SUMS
    }
    REAL* out = force.data + size_t(s) * force.shape[1] + base;
    for (int a = 0; a < DIM; ++a)
        for (int l = 0; l < count; ++l)
            out[a * places + l] = f[a][l];
"""
SUMS = {
    2: """for (int l = 0; l < LANES; ++l) {
            f[0][l] += c[0] * w[0][l] + c[1] * w[1][l];
            f[1][l] += c[1] * w[0][l] + c[2] * w[1][l];
        }""",
    3: """for (int l = 0; l < LANES; ++l) {
            f[0][l] += c[0] * w[0][l] + c[1] * w[1][l] + c[2] * w[2][l];
            f[1][l] += c[1] * w[0][l] + c[3] * w[1][l] + c[4] * w[2][l];
            f[2][l] += c[2] * w[0][l] + c[4] * w[1][l] + c[5] * w[2][l];
        }""",
}


@cache
def rows(scalar, dimension):
    """The kernel in one precision and dimension, and how many lanes it has."""
    lanes = BYTES // wp.types.type_size_in_bytes(scalar)
    body = FORCE.replace("SUMS", SUMS[dimension]).replace("DIM", str(dimension))
    body = body.replace("REAL", f"wp::{scalar.__name__}").replace("LANES", str(lanes))

    @wp.func_native(body)
    def piecewise(
        s: wp.int32,
        piece: wp.vec2i,
        offset: wp.array(dtype=wp.int32),
        tensors: wp.array2d(dtype=scalar),
        planes: wp.array2d(dtype=scalar),
        force: wp.array2d(dtype=scalar),
    ): ...

    @wp.kernel(enable_backward=False, module="unique")
    def pulled(
        first: wp.int32,
        pieces: wp.array(dtype=wp.vec2i),
        offset: wp.array(dtype=wp.int32),
        tensors: wp.array2d(dtype=scalar),
        planes: wp.array2d(dtype=scalar),
        force: wp.array2d(dtype=scalar),
    ):
        s, t = wp.tid()
        piecewise(s, pieces[first + t], offset, tensors, planes, force)

    return SimpleNamespace(pulled=pulled, lanes=lanes)
