"""Sums over nodes and bonds for the derivatives to tables and numbers of the material, (N9).

Laid out as rows.py says, a sum for each lane. Of a pair of bonds ±ξ, d = u(ξ) − u(−ξ) and
g at the node, bars hold Σ g₁c₁, Σ g₁c₂ + g₂c₁ and Σ g₂c₂ with c = u(ξ) + u(−ξ) − 2 u,
Σ (H̄ ξ)·d and Σ g·(P(ξ) − P(−ξ)) ξ.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.nonlinear.law import CLIP, CLIPPED, SLOPES
from warp_peri.kernels.nonlinear.rows import HERE, OF_STATE, PAIR, STATE_PAIR, native, rows

SUMS = 5
"""Numbers that every pair of bonds gathers for the derivatives to its tables."""

OWN = """
    const REAL* state = states.data + size_t(s) * states.shape[1] + base;
    const REAL* back = backs.data + size_t(s) * backs.shape[1] + base;
    const REAL* own_x = seeds.data + size_t(s) * seeds.shape[1] + base;
    REAL x[LANES], y[LANES], gx[LANES] = {}, gy[LANES] = {};
    REAL i00[LANES] = {}, i01[LANES] = {}, i10[LANES] = {}, i11[LANES] = {};
    for (int l = 0; l < LANES; ++l) {
        x[l] = REAL(2) * ux[l];
        y[l] = REAL(2) * uy[l];
    }
    for (int l = 0; l < count; ++l) {  // zero beyond: what is summed is linear in these
        gx[l] = own_x[l];
        gy[l] = own_x[places + l];
        i00[l] = back[l];
        i01[l] = back[places + l];
        i10[l] = back[2 * places + l];
        i11[l] = back[3 * places + l];
    }
"""
BY_PAIR = """
        REAL* sums = bars.data + size_t(block) * bars.shape[1] + 5 * LANES * p;
        for (int l = 0; l < LANES; ++l) {
            const REAL dx = vx[l] - wx[l], dy = vy[l] - wy[l];
            const REAL cx = vx[l] + wx[l] - x[l], cy = vy[l] + wy[l] - y[l];
            sums[l] += gx[l] * cx;
            sums[LANES + l] += gx[l] * cy + gy[l] * cx;
            sums[2 * LANES + l] += gy[l] * cy;
            sums[3 * LANES + l] += (i00[l] * a + i01[l] * b) * dx + (i10[l] * a + i11[l] * b) * dy;
            sums[4 * LANES + l] += gx[l] * (a * (f00[l] - b00[l]) + b * (f01[l] - b01[l]))
                + gy[l] * (a * (f10[l] - b10[l]) + b * (f11[l] - b11[l]));
        }
"""
BY_NUMBERS = """
    REAL* material = by_numbers.data + size_t(block) * by_numbers.shape[1];
    const REAL* seen = state;
    CLIP
    for (int l = 0; l < count; ++l) {
        LAW
        const REAL d00 = back[4 * places + l], d01 = back[5 * places + l];
        const REAL d10 = back[6 * places + l], d11 = back[7 * places + l];
        SLOPES
        material[l] += n0;
        material[LANES + l] += n1;
        material[2 * LANES + l] += n2;
        material[3 * LANES + l] += n3;
        material[4 * LANES + l] += n4;
        material[5 * LANES + l] += n5;
    }
"""
BODY = (
    HERE
    + OWN
    + "for (int p = 0; p < offset.shape[0]; ++p) {"
    + PAIR
    + STATE_PAIR
    + BY_PAIR
    + "}"
    + BY_NUMBERS.replace("CLIP", CLIP.replace("OF", OF_STATE))
    .replace("LAW", OF_STATE + CLIPPED)
    .replace("SLOPES", SLOPES)
)


@cache
def sums(scalar):
    """The kernel in one precision, and the size of what it writes for a pair and a material."""
    of = rows(scalar)
    return SimpleNamespace(
        kernel=_sums(scalar, of.pair, native(BODY, scalar)),
        pair=SUMS * of.lanes,
        material=6 * of.lanes,
    )


def _sums(scalar, pair, body):
    @wp.func_native(body)
    def piecewise(
        block: wp.int32,
        s: wp.int32,
        piece: wp.vec3i,
        offset: wp.array(dtype=wp.int32),
        bonds: wp.array(dtype=pair),
        radius: scalar,
        planes: wp.array2d(dtype=scalar),
        states: wp.array2d(dtype=scalar),
        seeds: wp.array2d(dtype=scalar),
        backs: wp.array2d(dtype=scalar),
        bars: wp.array2d(dtype=scalar),
        by_numbers: wp.array2d(dtype=scalar),
    ): ...

    @wp.kernel(enable_backward=False, module="unique")
    def gathered(
        first: wp.int32,
        ends: wp.array(dtype=wp.int32),
        pieces: wp.array(dtype=wp.vec3i),
        offset: wp.array(dtype=wp.int32),
        bonds: wp.array(dtype=pair),
        radius: scalar,
        planes: wp.array2d(dtype=scalar),
        states: wp.array2d(dtype=scalar),
        seeds: wp.array2d(dtype=scalar),
        backs: wp.array2d(dtype=scalar),
        bars: wp.array2d(dtype=scalar),
        by_numbers: wp.array2d(dtype=scalar),
    ):
        """Adds what the pieces ends[block] ≤ t < ends[block + 1] of every sample hold."""
        block = first + wp.tid()
        for s in range(planes.shape[0]):
            for t in range(ends[block], ends[block + 1]):
                piecewise(
                    block, s, pieces[t], offset, bonds, radius,
                    planes, states, seeds, backs, bars, by_numbers,
                )  # fmt: skip

    return gathered
