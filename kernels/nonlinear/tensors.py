"""The nonlinear solid on micromodulus tensors, (N22): gradients and forces of bonds in pairs.

Laid out as rows.py says. bonds[p] holds ξ of one of a pair, then C₁₁, C₁₂, 2 p_in, 2 p_out and C₂₂.
Of a state the plane of the dilatation is not written.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.nonlinear.law import CLIP, CLIPPED, STRESS
from warp_peri.kernels.nonlinear.rows import (
    HERE,
    KEPT,
    OF_FIELD,
    PAIR,
    force_of,
    native,
    rows,
    state_of,
)

STATE = (
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
"""
    + CLIP.replace("OF", OF_FIELD)
    + """
    REAL m00[LANES], m01[LANES], m10[LANES], m11[LANES];
    for (int l = 0; l < LANES; ++l) {
"""
    + OF_FIELD
    + CLIPPED
    + STRESS
    + KEPT
    + """
    }
    REAL* out = result.data + size_t(s) * result.shape[1] + base;
    for (int l = 0; l < count; ++l) {
        out[l] = m00[l];
        out[places + l] = m01[l];
        out[2 * places + l] = m10[l];
        out[3 * places + l] = m11[l];
        out[5 * places + l] = xx[l];
        out[6 * places + l] = xy[l];
        out[7 * places + l] = yx[l];
        out[8 * places + l] = yy[l];
    }
"""
)
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
    + """
        const REAL *f00 = state + step, *b00 = state - step;
        const REAL *f01 = f00 + places, *b01 = b00 + places, *f10 = f01 + places;
        const REAL *b10 = b01 + places, *f11 = f10 + places, *b11 = b10 + places;
        const REAL ka = pair[column] * a, kb = pair[column] * b;
        const REAL c11 = pair[2], c12 = pair[3], c22 = pair[6];
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


@cache
def tensor_rows(scalar):
    """The kernels in one precision; what they share with the LPS is that of rows.rows."""
    of = rows(scalar)
    pair = wp.types.vector(7, scalar)
    return SimpleNamespace(
        lanes=of.lanes,
        pair=pair,
        numbers=of.numbers,
        vec=of.vec,
        mat=of.mat,
        state=state_of(scalar, pair, native(STATE, scalar)),
        force=force_of(scalar, pair, native(FORCE, scalar)),
        tangents=of.tangents,
    )
