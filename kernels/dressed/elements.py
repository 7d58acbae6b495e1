"""K u of square elements whose moduli vary, many nodes of a row at a time (theory.md, Dr22).

Planes and pieces are those of micromodulus/rows.py. A site is the element whose first corner is its
place; `row` says how many places there are along the second axis. The site sweep turns displacement
into what an element pulls with, five numbers: three of its mean strain and two of its hourglass
modes; the node sweep gathers those of four elements.
For the processor only: the loops over lanes are C++, which Warp's compiler turns into vectors.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.micromodulus.rows import BYTES

SITES = """
    const int base = piece.c[0], count = piece.c[1];
    const size_t places = factors.shape[1];
    const REAL* u = planes.data + size_t(s) * planes.shape[1] + base;
    REAL m[9][LANES], a[2][LANES], b[2][LANES], h[2][LANES];
    for (int n = 0; n < 2; ++n) {
        const REAL* v = u + n * (planes.shape[1] / 2);
        for (int l = 0; l < LANES; ++l) {
            const REAL first = v[l + row + 1] - v[l], second = v[l + row] - v[l + 1];
            a[n][l] = first + second;
            b[n][l] = first - second;
            h[n][l] = v[l] + v[l + row + 1] - v[l + row] - v[l + 1];
        }
    }
    REAL t[5][LANES];
    for (int k = 0; k < 9; ++k) {
        for (int l = 0; l < LANES; ++l)
            m[k][l] = REAL(0);
        for (int p = 0; p < factors.shape[0]; ++p) {
            const REAL c = table.data[size_t(p) * 9 + k];
            const REAL* f = factors.data + size_t(p) * places + base;
            for (int l = 0; l < LANES; ++l)
                m[k][l] += c * f[l];
        }
    }
    for (int l = 0; l < LANES; ++l) {
        const REAL shear = b[0][l] + a[1][l];
        t[0][l] = m[0][l] * a[0][l] + m[1][l] * b[1][l] + m[2][l] * shear;
        t[1][l] = m[1][l] * a[0][l] + m[3][l] * b[1][l] + m[4][l] * shear;
        t[2][l] = m[2][l] * a[0][l] + m[4][l] * b[1][l] + m[5][l] * shear;
        t[3][l] = m[6][l] * h[0][l] + m[7][l] * h[1][l];
        t[4][l] = m[7][l] * h[0][l] + m[8][l] * h[1][l];
    }
    REAL* out = stresses.data + size_t(s) * stresses.shape[1] + base;
    for (int n = 0; n < 5; ++n)
        for (int l = 0; l < count; ++l)
            out[n * places + l] = t[n][l];
"""
NODES = """
    const int base = piece.c[0], count = piece.c[1];
    const size_t places = stresses.shape[1] / 5;
    const REAL* t = stresses.data + size_t(s) * stresses.shape[1] + base;
    REAL f[2][LANES] = {};
    for (int c = 0; c < 4; ++c) {
        const REAL x = c / 2 ? REAL(1) : REAL(-1), y = c % 2 ? REAL(1) : REAL(-1);
        const REAL* e = t - (c / 2) * row - c % 2;
        for (int l = 0; l < LANES; ++l) {
            f[0][l] += x * e[l] + y * e[2 * places + l] + x * y * e[3 * places + l];
            f[1][l] += y * e[places + l] + x * e[2 * places + l] + x * y * e[4 * places + l];
        }
    }
    const size_t wide = force.shape[1] / 2;
    REAL* out = force.data + size_t(s) * force.shape[1] + base;
    for (int n = 0; n < 2; ++n)
        for (int l = 0; l < count; ++l)
            out[n * wide + l] = f[n][l];
"""


@cache
def elements(scalar):
    """The two kernels in one precision, and how many lanes they have."""
    lanes = BYTES // wp.types.type_size_in_bytes(scalar)
    sites, nodes = (
        body.replace("REAL", f"wp::{scalar.__name__}").replace("LANES", str(lanes))
        for body in (SITES, NODES)
    )

    @wp.func_native(sites)
    def strain(
        s: wp.int32,
        piece: wp.vec2i,
        row: wp.int32,
        table: wp.array2d(dtype=scalar),
        factors: wp.array2d(dtype=scalar),
        planes: wp.array2d(dtype=scalar),
        stresses: wp.array2d(dtype=scalar),
    ): ...

    @wp.func_native(nodes)
    def gather(
        s: wp.int32,
        piece: wp.vec2i,
        row: wp.int32,
        stresses: wp.array2d(dtype=scalar),
        force: wp.array2d(dtype=scalar),
    ): ...

    @wp.kernel(enable_backward=False, module="unique")
    def stressed(
        first: wp.int32,
        pieces: wp.array(dtype=wp.vec2i),
        row: wp.int32,
        table: wp.array2d(dtype=scalar),
        factors: wp.array2d(dtype=scalar),
        planes: wp.array2d(dtype=scalar),
        stresses: wp.array2d(dtype=scalar),
    ):
        s, t = wp.tid()
        strain(s, pieces[first + t], row, table, factors, planes, stresses)

    @wp.kernel(enable_backward=False, module="unique")
    def gathered(
        first: wp.int32,
        pieces: wp.array(dtype=wp.vec2i),
        row: wp.int32,
        stresses: wp.array2d(dtype=scalar),
        force: wp.array2d(dtype=scalar),
    ):
        s, t = wp.tid()
        gather(s, pieces[first + t], row, stresses, force)

    return SimpleNamespace(stressed=stressed, gathered=gathered, lanes=lanes)
