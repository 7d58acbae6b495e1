"""The sweeps over a lattice whose nodes lie row by row in a rectangle, many nodes at a time.

A field is laid out in planes: component a of sample s at place q of the rectangle of P places is
planes[s, a P + q]. Bond p leads from every place q to place q + offset[p], so no list of neighbours
is read, and LANES nodes next to one another go through a bond together, in vector registers. A
piece is (first place, first number, count): count ≤ LANES nodes that follow one another in the
rectangle and in their numbering. Lanes beyond the count compute what nobody keeps.

Bond by bond the expressions are those of force.py and adjoint.py, so that the bits are the same.
For the processor only: the loops over lanes are C++, which Warp's compiler turns into vectors.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.bonds import bonds, shared
from warp_peri.kernels.lps.adjoint import structs

BYTES = 128
"""Of all lanes together: two of the widest registers."""

OWN = """
    const int base = piece.c[0], number = piece.c[1], count = piece.c[2];
    const size_t half = planes.shape[1] / 2;
    const REAL* ux = planes.data + size_t(s) * planes.shape[1] + base;
    const REAL* uy = ux + half;
    REAL x[LANES], y[LANES];
    for (int l = 0; l < LANES; ++l) {
        x[l] = ux[l];
        y[l] = uy[l];
    }
"""
FAR = """
        const int c = bonds.bond_class.data[p];
        const REAL* vx = ux + offset.data[p];
        const REAL* vy = uy + offset.data[p];
        const REAL a = bonds.pattern.data[p].c[0], b = bonds.pattern.data[p].c[1];
"""
LAID_OUT = """
    const int base = piece.c[0], number = piece.c[1], count = piece.c[2];
    const REAL* v = (const REAL*)(values.data + size_t(s) * values.shape[1] + number);
    REAL* x = planes.data + size_t(s) * planes.shape[1] + base;
    REAL* y = x + planes.shape[1] / 2;
    for (int l = 0; l < count; ++l) {
        x[l] = v[2 * l] / divisor;
        y[l] = v[2 * l + 1] / divisor;
    }
"""
DILATATION = (
    OWN
    + """
    const REAL factor = REAL(2) / law.m.data[0];
    REAL total[LANES] = {};
    for (int p = 0; p < offset.shape[0]; ++p) {"""
    + FAR
    + """
        const REAL k = factor * law.kw.data[c];
        for (int l = 0; l < LANES; ++l)
            total[l] += k * (a * (vx[l] - x[l]) + b * (vy[l] - y[l]));
    }
    REAL* out = theta.data + size_t(s) * theta.shape[1] + base;
    for (int l = 0; l < count; ++l)
        out[l] = total[l];
"""
)
FORCE = (
    OWN
    + """
    const REAL dilatational = REAL(-2) * (law.lam.data[0] - law.mu.data[0]) / law.m.data[0];
    const REAL deviatoric = REAL(-16) * law.mu.data[0] / law.m.data[0];
    const REAL* own = theta.data + size_t(s) * theta.shape[1] + base;
    REAL fx[LANES] = {}, fy[LANES] = {}, d[LANES];
    for (int l = 0; l < LANES; ++l)
        d[l] = own[l];
    for (int p = 0; p < offset.shape[0]; ++p) {"""
    + FAR
    + """
        const REAL* far = own + offset.data[p];
        const REAL inverse_square = bonds.pattern.data[p].c[2];
        const REAL k = law.kw.data[c], bulk = k * dilatational, shear = k * deviatoric;
        for (int l = 0; l < LANES; ++l) {
            const REAL stretch = (a * (vx[l] - x[l]) + b * (vy[l] - y[l])) * inverse_square;
            REAL density = bulk * (d[l] + far[l]);
            density += shear * stretch;
            fx[l] += density * a;
            fy[l] += density * b;
        }
    }
    REAL* out = (REAL*)(vectors.data + size_t(s) * vectors.shape[1] + number);
    for (int l = 0; l < count; ++l) {
        out[2 * l] = fx[l];
        out[2 * l + 1] = fy[l];
    }
"""
)
DILATATION_ADJOINT = (
    OWN
    + """
    const REAL factor = REAL(-4) * (law.lam.data[0] - law.mu.data[0]) / law.m.data[0];
    REAL total[LANES] = {};
    for (int p = 0; p < offset.shape[0]; ++p) {"""
    + FAR
    + """
        const REAL k = law.kw.data[c];
        for (int l = 0; l < LANES; ++l)
            total[l] += a * (k * x[l] - k * vx[l]) + b * (k * y[l] - k * vy[l]);
    }
    REAL* out = theta.data + size_t(s) * theta.shape[1] + base;
    for (int l = 0; l < count; ++l)
        out[l] = factor * total[l];
"""
)
DISPLACEMENT_ADJOINT = (
    OWN
    + """
    const REAL factor = REAL(16) * law.mu.data[0];
    const REAL* own = theta.data + size_t(s) * theta.shape[1] + base;
    REAL fx[LANES] = {}, fy[LANES] = {}, d[LANES];
    for (int l = 0; l < LANES; ++l)
        d[l] = own[l];
    for (int p = 0; p < offset.shape[0]; ++p) {"""
    + FAR
    + """
        const REAL* far = own + offset.data[p];
        const REAL inverse_square = bonds.pattern.data[p].c[2];
        const REAL k = law.kw.data[c];
        for (int l = 0; l < LANES; ++l) {
            const REAL stretch = (a * (k * x[l] - k * vx[l]) + b * (k * y[l] - k * vy[l]));
            const REAL push = factor * (stretch * inverse_square) - k * d[l] - k * far[l];
            fx[l] += push * a;
            fy[l] += push * b;
        }
    }
    REAL* out = (REAL*)(vectors.data + size_t(s) * vectors.shape[1] + number);
    for (int l = 0; l < count; ++l) {
        out[2 * l] = fx[l];
        out[2 * l + 1] = fy[l];
    }
"""
)
BY_PAIR = (
    OWN
    + """
    const REAL* hx = seeds.data + size_t(s) * planes.shape[1] + base;
    const REAL* own = theta.data + size_t(s) * theta.shape[1] + base;
    const REAL* back = tau.data + size_t(s) * theta.shape[1] + base;
    REAL gx[LANES] = {}, gy[LANES] = {}, t[LANES] = {};
    for (int l = 0; l < count; ++l) {  // zero beyond: what is summed is linear in these
        gx[l] = hx[l];
        gy[l] = hx[half + l];
        t[l] = back[l];
    }
    for (int n = 0; n < pairs.shape[0]; ++n) {
        const int p = pairs.data[n], step = offset.data[p];
        const REAL *vx = ux + step, *vy = uy + step, *wx = ux - step, *wy = uy - step;
        const REAL *far = own + step, *near = own - step;
        const REAL a = bonds.pattern.data[p].c[0], b = bonds.pattern.data[p].c[1];
        REAL* sums = bars.data + size_t(block) * bars.shape[1] + 3 * LANES * n;
        for (int l = 0; l < LANES; ++l) {
            const REAL ahead = a * (vx[l] - x[l]) + b * (vy[l] - y[l]);
            const REAL behind = a * (wx[l] - x[l]) + b * (wy[l] - y[l]);
            const REAL along = a * gx[l] + b * gy[l];
            sums[l] += along * (ahead + behind);
            sums[LANES + l] += along * (far[l] - near[l]);
            sums[2 * LANES + l] += t[l] * (ahead - behind);
        }
    }
"""
)


@cache
def rows(scalar):
    """The kernels in one precision, and how many lanes they have."""
    of = bonds(scalar, 2)
    lanes = BYTES // wp.types.type_size_in_bytes(scalar)

    def native(body):
        return body.replace("REAL", f"wp::{scalar.__name__}").replace("LANES", str(lanes))

    return SimpleNamespace(
        lanes=lanes,
        laid_out=_laid_out(of, native(LAID_OUT)),
        taken_up=_taken_up(of),
        forward=_swept(of, native, DILATATION, FORCE),
        backward=_swept(of, native, DILATATION_ADJOINT, DISPLACEMENT_ADJOINT),
        by_pair=_by_pair(of, native(BY_PAIR)),
    )


def _laid_out(of, body):
    scalar, vec = of.scalar, of.vec

    @wp.func_native(body)
    def piecewise(
        s: wp.int32,
        piece: wp.vec3i,
        divisor: scalar,
        values: wp.array2d(dtype=vec),
        planes: wp.array2d(dtype=scalar),
    ): ...

    @wp.kernel(enable_backward=False, module="unique")
    def laid_out(
        first: wp.int32,
        pieces: wp.array(dtype=wp.vec3i),
        divisor: wp.array(dtype=scalar),
        values: wp.array2d(dtype=vec),
        planes: wp.array2d(dtype=scalar),
    ):
        """Vectors by number, over a divisor, into their planes."""
        s, t = wp.tid()
        piecewise(s, pieces[first + t], divisor[0], values, planes)

    return laid_out


def _taken_up(of):
    scalar, scalars_at = of.scalar, of.scalars_at

    @wp.kernel(enable_backward=False, module="unique")
    def taken_up(
        first: wp.int32,
        pieces: wp.array(dtype=wp.vec3i),
        plane: wp.array2d(dtype=scalar),
        numbers: wp.array2d(dtype=scalar),
    ):
        """One number a place back to the numbering of the nodes."""
        s, t = wp.tid()
        piece = pieces[first + t]
        for n in range(piece[2]):
            numbers[s, piece[1] + n] = scalars_at(plane, s, piece[0] + n)

    return taken_up


def _swept(of, native, to_numbers, to_vectors):
    """Vectors by number into their planes; of these numbers by place, of both vectors by number.

    θ of u, (6), and L u, (9); or τ of h, (43), and ∂/∂u, (44).
    """
    scalar, vec, BondArrays, Law = of.scalar, of.vec, of.BondArrays, structs(of.scalar, 2).Law
    phases = {"laid": LAID_OUT.replace("divisor", "divisor.data[0]")}
    for name, work in (("needed", to_numbers), ("asked", to_vectors)):
        half = work.replace("LANES", "LANES / 2")
        phases[name] = f"if (piece.c[2] > LANES / 2) {{{work}}} else {{{half}}}"
    body = native(shared("planes.shape[0]", **phases))

    @wp.func_native(body)
    def share(
        turns: wp.array(dtype=wp.int32),
        laid: wp.array(dtype=wp.vec3i),
        needed: wp.array(dtype=wp.vec3i),
        asked: wp.array(dtype=wp.vec3i),
        divisor: wp.array(dtype=scalar),
        offset: wp.array(dtype=wp.int32),
        bonds: BondArrays,
        law: Law,
        values: wp.array2d(dtype=vec),
        planes: wp.array2d(dtype=scalar),
        theta: wp.array2d(dtype=scalar),
        vectors: wp.array2d(dtype=vec),
    ): ...

    @wp.kernel(enable_backward=False, module="unique")
    def swept(
        turns: wp.array(dtype=wp.int32),
        laid: wp.array(dtype=wp.vec3i),
        needed: wp.array(dtype=wp.vec3i),
        asked: wp.array(dtype=wp.vec3i),
        divisor: wp.array(dtype=scalar),
        offset: wp.array(dtype=wp.int32),
        bonds: BondArrays,
        law: Law,
        values: wp.array2d(dtype=vec),
        planes: wp.array2d(dtype=scalar),
        theta: wp.array2d(dtype=scalar),
        vectors: wp.array2d(dtype=vec),
    ):
        share(
            turns, laid, needed, asked, divisor, offset, bonds, law, values, planes, theta, vectors
        )

    return swept


def _by_pair(of, body):
    """Sums behind ∂/∂(K W), (45, 46), of each pair of bonds ±ξ and each lane: Σ ξ·h (stretches of
    both), Σ ξ·h (θ(ξ) − θ(−ξ)) and Σ τ ξ·(u(ξ) − u(−ξ))."""
    scalar, BondArrays = of.scalar, of.BondArrays

    @wp.func_native(body)
    def piecewise(
        block: wp.int32,
        s: wp.int32,
        piece: wp.vec3i,
        pairs: wp.array(dtype=wp.int32),
        offset: wp.array(dtype=wp.int32),
        bonds: BondArrays,
        planes: wp.array2d(dtype=scalar),
        theta: wp.array2d(dtype=scalar),
        seeds: wp.array2d(dtype=scalar),
        tau: wp.array2d(dtype=scalar),
        bars: wp.array2d(dtype=scalar),
    ): ...

    @wp.kernel(enable_backward=False, module="unique")
    def by_pair(
        first: wp.int32,
        ends: wp.array(dtype=wp.int32),
        pieces: wp.array(dtype=wp.vec3i),
        pairs: wp.array(dtype=wp.int32),
        offset: wp.array(dtype=wp.int32),
        bonds: BondArrays,
        planes: wp.array2d(dtype=scalar),
        theta: wp.array2d(dtype=scalar),
        seeds: wp.array2d(dtype=scalar),
        tau: wp.array2d(dtype=scalar),
        bars: wp.array2d(dtype=scalar),
    ):
        """Adds what the pieces ends[block] ≤ t < ends[block + 1] of every sample hold."""
        block = first + wp.tid()
        for s in range(planes.shape[0]):
            for t in range(ends[block], ends[block + 1]):
                piecewise(
                    block, s, pieces[t], pairs, offset, bonds, planes, theta, seeds, tau, bars
                )

    return by_pair
