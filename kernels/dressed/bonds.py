"""K u of bonds whose moduli vary from node to node, row by row (theory, Dr25).

Planes and pieces are those of micromodulus/rows.py. Bond p of one half of the family leads
`offset[p]` places on; its row of the table is a d and the upper triangle of w d ⊗ d. Factors are
two planes, c = (κ − 2 μ)/h² and q = 8 μ/h². The site sweep leaves t = c θ with
θ = Σ a d·(u₊ − u₋), the node sweep pulls with t and q:

    f(x) = Σ w d ⊗ d [(q + q₊)(u − u₊) + (q + q₋)(u − u₋)] − a d (t₊ − t₋).

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
    const REAL* v = u + places;
    REAL theta[LANES] = {};
    for (int p = 0; p < offset.shape[0]; ++p) {
        const int step = offset.data[p];
        const REAL* c = table.data + size_t(p) * 5;
        for (int l = 0; l < LANES; ++l)
            theta[l] += c[0] * (u[l + step] - u[l - step]) + c[1] * (v[l + step] - v[l - step]);
    }
    const REAL* f = factors.data + base;
    REAL* out = stresses.data + size_t(s) * stresses.shape[1] + base;
    for (int l = 0; l < count; ++l)
        out[l] = f[l] * theta[l];
"""
NODES = """
    const int base = piece.c[0], count = piece.c[1];
    const size_t places = factors.shape[1];
    const REAL* u = planes.data + size_t(s) * planes.shape[1] + base;
    const REAL* v = u + places;
    const REAL* t = stresses.data + size_t(s) * stresses.shape[1] + base;
    const REAL* q = factors.data + places + base;
    REAL f[2][LANES] = {};
    for (int p = 0; p < offset.shape[0]; ++p) {
        const int step = offset.data[p];
        const REAL* c = table.data + size_t(p) * 5;
        for (int l = 0; l < LANES; ++l) {
            const REAL ahead = q[l] + q[l + step], behind = q[l] + q[l - step];
            const REAL x = ahead * (u[l] - u[l + step]) + behind * (u[l] - u[l - step]);
            const REAL y = ahead * (v[l] - v[l + step]) + behind * (v[l] - v[l - step]);
            const REAL pull = t[l + step] - t[l - step];
            f[0][l] += c[2] * x + c[3] * y - c[0] * pull;
            f[1][l] += c[3] * x + c[4] * y - c[1] * pull;
        }
    }
    REAL* out = force.data + size_t(s) * force.shape[1] + base;
    for (int n = 0; n < 2; ++n)
        for (int l = 0; l < count; ++l)
            out[n * places + l] = f[n][l];
"""


@cache
def bonds(scalar):
    """The two kernels in one precision."""
    lanes = BYTES // wp.types.type_size_in_bytes(scalar)
    sites, nodes = (
        body.replace("REAL", f"wp::{scalar.__name__}").replace("LANES", str(lanes))
        for body in (SITES, NODES)
    )

    @wp.func_native(sites)
    def dilate(
        s: wp.int32,
        piece: wp.vec2i,
        offset: wp.array(dtype=wp.int32),
        table: wp.array2d(dtype=scalar),
        factors: wp.array2d(dtype=scalar),
        planes: wp.array2d(dtype=scalar),
        stresses: wp.array2d(dtype=scalar),
    ): ...

    @wp.func_native(nodes)
    def pull(
        s: wp.int32,
        piece: wp.vec2i,
        offset: wp.array(dtype=wp.int32),
        table: wp.array2d(dtype=scalar),
        factors: wp.array2d(dtype=scalar),
        stresses: wp.array2d(dtype=scalar),
        planes: wp.array2d(dtype=scalar),
        force: wp.array2d(dtype=scalar),
    ): ...

    @wp.kernel(enable_backward=False, module="unique")
    def stressed(
        first: wp.int32,
        pieces: wp.array(dtype=wp.vec2i),
        offset: wp.array(dtype=wp.int32),
        table: wp.array2d(dtype=scalar),
        factors: wp.array2d(dtype=scalar),
        planes: wp.array2d(dtype=scalar),
        stresses: wp.array2d(dtype=scalar),
    ):
        s, t = wp.tid()
        dilate(s, pieces[first + t], offset, table, factors, planes, stresses)

    @wp.kernel(enable_backward=False, module="unique")
    def gathered(
        first: wp.int32,
        pieces: wp.array(dtype=wp.vec2i),
        offset: wp.array(dtype=wp.int32),
        table: wp.array2d(dtype=scalar),
        factors: wp.array2d(dtype=scalar),
        stresses: wp.array2d(dtype=scalar),
        planes: wp.array2d(dtype=scalar),
        force: wp.array2d(dtype=scalar),
    ):
        s, t = wp.tid()
        pull(s, pieces[first + t], offset, table, factors, stresses, planes, force)

    return SimpleNamespace(stressed=stressed, gathered=gathered)
