"""The sweeps of the nonlinear solid over rows of a lattice, many nodes at a time, (N1–N10).

Planes, pieces and lanes are those of kernels/lps/rows.py. A bond ξ and its opposite have the same
tables, so that they are taken together: Σ p (u_j − u_i) ⊗ ξ needs u(ξ) − u(−ξ), the force of the
linear bonds u(ξ) + u(−ξ) − 2 u, that of stress the difference. bonds[p] holds ξ of one of a pair,
then C₁₁, C₁₂, C₂₂, 2 p_in and 2 p_out.

A state is eight planes: what the force reads, a matrix M, and the gradient M was made of. Forwards
these are P and H; backwards, of the derivative g to L u in the place of u, ∂/∂H and ∂/∂P, and the
force sweep on them is ∂/∂u, with p_in for p_out.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.lps.rows import BYTES
from warp_peri.kernels.nonlinear.law import CLIP, CLIP_BACK, CLIPPED, CURVED, STRESS

PLANES = 8
"""Of a state."""
P_IN, P_OUT = 5, 6
"""Columns of the weights in the table of bonds."""

HERE = """
    const int base = piece.c[0], number = piece.c[1], count = piece.c[2];
    const size_t places = planes.shape[1] / 2;
    const REAL* ux = planes.data + size_t(s) * planes.shape[1] + base;
    const REAL* uy = ux + places;
"""
PAIR = """
        const REAL* pair = bonds.data[p].c;
        const int step = offset.data[p];
        const REAL a = pair[0], b = pair[1];
        const REAL *vx = ux + step, *vy = uy + step, *wx = ux - step, *wy = uy - step;
"""
STATE_PAIR = """
        const REAL *f00 = state + step, *b00 = state - step;
        const REAL *f01 = f00 + places, *b01 = b00 + places, *f10 = f01 + places;
        const REAL *b10 = b01 + places, *f11 = f10 + places, *b11 = b10 + places;
"""
GRADIENT = (
    HERE
    + """
    REAL xx[LANES] = {}, xy[LANES] = {}, yx[LANES] = {}, yy[LANES] = {};
    for (int p = 0; p < offset.shape[0]; ++p) {"""
    + PAIR
    + """
        const REAL ka = pair[column] * a, kb = pair[column] * b;
        for (int l = 0; l < LANES; ++l) {
            const REAL x = vx[l] - wx[l], y = vy[l] - wy[l];
            xx[l] += ka * x;
            xy[l] += kb * x;
            yx[l] += ka * y;
            yy[l] += kb * y;
        }
    }
    CLIP
    REAL m00[LANES], m01[LANES], m10[LANES], m11[LANES];
    for (int l = 0; l < LANES; ++l) {
        LAW
    }
    REAL* out = result.data + size_t(s) * result.shape[1] + base;
    for (int l = 0; l < count; ++l) {
        out[l] = m00[l];
        out[places + l] = m01[l];
        out[2 * places + l] = m10[l];
        out[3 * places + l] = m11[l];
        out[4 * places + l] = xx[l];
        out[5 * places + l] = xy[l];
        out[6 * places + l] = yx[l];
        out[7 * places + l] = yy[l];
    }
"""
)
KEPT = """
    m00[l] = r00;
    m01[l] = r01;
    m10[l] = r10;
    m11[l] = r11;
"""
OF_FIELD = "const REAL k00 = xx[l], k01 = xy[l], k10 = yx[l], k11 = yy[l];"
FORWARD = GRADIENT.replace("CLIP", CLIP.replace("OF", OF_FIELD)).replace(
    "LAW", OF_FIELD + CLIPPED + STRESS + KEPT
)
OF_STATE = """
    const REAL k00 = seen[4 * places + l], k01 = seen[5 * places + l];
    const REAL k10 = seen[6 * places + l], k11 = seen[7 * places + l];
"""
DIRECTED = "const REAL d00 = xx[l], d01 = xy[l], d10 = yx[l], d11 = yy[l];"
BACKWARD = GRADIENT.replace("CLIP", CLIP.replace("OF", OF_STATE)).replace(
    "LAW", OF_STATE + DIRECTED + CLIPPED + CURVED + CLIP_BACK + KEPT.replace("= r", "= c")
)
SEEN = "const REAL* seen = state.data + size_t(s) * state.shape[1] + piece.c[0];"
FORCE = (
    HERE
    + """
    const REAL* state = states.data + size_t(s) * states.shape[1] + base;
    REAL x[LANES], y[LANES], fx[LANES] = {}, fy[LANES] = {};
    for (int l = 0; l < LANES; ++l) {
        x[l] = REAL(2) * ux[l];
        y[l] = REAL(2) * uy[l];
    }
    for (int p = 0; p < offset.shape[0]; ++p) {"""
    + PAIR
    + STATE_PAIR
    + """
        const REAL ka = pair[column] * a, kb = pair[column] * b;
        const REAL c11 = pair[2], c12 = pair[3], c22 = pair[4];
        for (int l = 0; l < LANES; ++l) {
            const REAL dx = vx[l] + wx[l] - x[l], dy = vy[l] + wy[l] - y[l];
            fx[l] += c11 * dx + c12 * dy;
            fy[l] += c12 * dx + c22 * dy;
            fx[l] += ka * (f00[l] - b00[l]) + kb * (f01[l] - b01[l]);
            fy[l] += ka * (f10[l] - b10[l]) + kb * (f11[l] - b11[l]);
        }
    }
    REAL* out = (REAL*)(vectors.data + size_t(s) * vectors.shape[1] + number);
    for (int l = 0; l < count; ++l) {
        out[2 * l] = -fx[l];
        out[2 * l + 1] = -fy[l];
    }
"""
)
UNIT = (
    """
    const size_t places = state.shape[1] / 8;
    const REAL* seen = state.data + place;
    const REAL h00 = seen[4 * places], h01 = seen[5 * places];
    const REAL h10 = seen[6 * places], h11 = seen[7 * places];
    const REAL d00 = k == 0, d01 = k == 1, d10 = k == 2, d11 = k == 3;
"""
    + CURVED
    + "return wp::mat_t<2, 2, REAL>(r00, r01, r10, r11);"
)


def lanes_of(scalar):
    """How many nodes go through a bond together."""
    return BYTES // wp.types.type_size_in_bytes(scalar)


def native(body, scalar):
    """The C++ in one precision."""
    return body.replace("REAL", f"wp::{scalar.__name__}").replace("LANES", str(lanes_of(scalar)))


@cache
def rows(scalar):
    """The kernels in one precision."""
    pair, numbers = wp.types.vector(7, scalar), wp.types.vector(6, scalar)
    mat = wp.types.matrix((2, 2), scalar)
    return SimpleNamespace(
        lanes=lanes_of(scalar),
        pair=pair,
        numbers=numbers,
        vec=wp.types.vector(2, scalar),
        mat=mat,
        state=_state(scalar, pair, numbers, native(FORWARD, scalar)),
        curved=_curved(scalar, pair, numbers, native(SEEN + BACKWARD, scalar)),
        force=_force(scalar, pair, native(FORCE, scalar)),
        tangents=_tangents(scalar, mat, numbers, native(UNIT, scalar)),
    )


def _state(scalar, pair, numbers, body):
    @wp.func_native(body)
    def piecewise(
        s: wp.int32,
        piece: wp.vec3i,
        offset: wp.array(dtype=wp.int32),
        bonds: wp.array(dtype=pair),
        column: wp.int32,
        m: numbers,
        radius: scalar,
        planes: wp.array2d(dtype=scalar),
        result: wp.array2d(dtype=scalar),
    ): ...

    p_in = wp.constant(P_IN)

    @wp.kernel(enable_backward=False, module="unique")
    def state(
        first: wp.int32,
        pieces: wp.array(dtype=wp.vec3i),
        offset: wp.array(dtype=wp.int32),
        bonds: wp.array(dtype=pair),
        m: numbers,
        radius: scalar,
        planes: wp.array2d(dtype=scalar),
        result: wp.array2d(dtype=scalar),
    ):
        """P = Ψ′(H) and H of u, (N1) and (N4); a radius clips H for P."""
        s, t = wp.tid()
        piecewise(s, pieces[first + t], offset, bonds, p_in, m, radius, planes, result)

    return state


def _curved(scalar, pair, numbers, body):
    @wp.func_native(body)
    def piecewise(
        s: wp.int32,
        piece: wp.vec3i,
        offset: wp.array(dtype=wp.int32),
        bonds: wp.array(dtype=pair),
        column: wp.int32,
        m: numbers,
        radius: scalar,
        state: wp.array2d(dtype=scalar),
        planes: wp.array2d(dtype=scalar),
        result: wp.array2d(dtype=scalar),
    ): ...

    @wp.kernel(enable_backward=False, module="unique")
    def curved(
        first: wp.int32,
        pieces: wp.array(dtype=wp.vec3i),
        offset: wp.array(dtype=wp.int32),
        bonds: wp.array(dtype=pair),
        column: wp.int32,
        m: numbers,
        radius: scalar,
        state: wp.array2d(dtype=scalar),
        planes: wp.array2d(dtype=scalar),
        result: wp.array2d(dtype=scalar),
    ):
        """Ψ″(H) of the gradient that the weights of a column give planes, and that gradient:
        ∂/∂H and ∂/∂P, (N7), of g that is zero off the interior with p_out, and
        how the state changes along a field with p_in."""
        s, t = wp.tid()
        piecewise(s, pieces[first + t], offset, bonds, column, m, radius, state, planes, result)

    return curved


def _force(scalar, pair, body):
    vec = wp.types.vector(2, scalar)

    @wp.func_native(body)
    def piecewise(
        s: wp.int32,
        piece: wp.vec3i,
        offset: wp.array(dtype=wp.int32),
        bonds: wp.array(dtype=pair),
        column: wp.int32,
        planes: wp.array2d(dtype=scalar),
        states: wp.array2d(dtype=scalar),
        vectors: wp.array2d(dtype=vec),
    ): ...

    @wp.kernel(enable_backward=False, module="unique")
    def force(
        first: wp.int32,
        pieces: wp.array(dtype=wp.vec3i),
        offset: wp.array(dtype=wp.int32),
        bonds: wp.array(dtype=pair),
        column: wp.int32,
        planes: wp.array2d(dtype=scalar),
        states: wp.array2d(dtype=scalar),
        vectors: wp.array2d(dtype=vec),
    ):
        """L u, (N2), with the weights p_out; ∂/∂u, (N8), with p_in."""
        s, t = wp.tid()
        piecewise(s, pieces[first + t], offset, bonds, column, planes, states, vectors)

    return force


def _tangents(scalar, mat, numbers, body):
    @wp.func_native(body)
    def curved(
        k: wp.int32, place: wp.int32, m: numbers, state: wp.array2d(dtype=scalar)
    ) -> mat: ...

    @wp.kernel(enable_backward=False, module="unique")
    def tangents(
        first: wp.int32,
        places: wp.array(dtype=wp.int32),
        m: numbers,
        state: wp.array2d(dtype=scalar),
        out: wp.array2d(dtype=mat),
    ):
        """Ψ″(H) times the matrices with one entry 1, in the order 11, 12, 21, 22, of one sample."""
        k, t = wp.tid()
        out[k, first + t] = curved(k, places[first + t], m, state)

    return tangents
