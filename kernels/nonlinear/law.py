"""What a gradient H has for stress, and derivatives of that, (N1–N10), as C++ for one lane.

H = (t/2) I + Q + ω J with the deviator Q = [[d, c], [c, −d]] and J a quarter turn. With q = d + i c
and z = 1 + t/2 + i ω, the Green strain has the trace e = t + t²/4 + ω² + |q|² and the deviator
w = q z̄. The numbers m of a material are λ, μ, t3, tq2, and q3 e^(−6ia) by real and imaginary part.

The pieces read h00 … h11, and d00 … d11 for a direction, and leave r00 … r11.
"""

MEASURES = """
    const REAL t = h00 + h11, w = REAL(0.5) * (h10 - h01);
    const REAL d = REAL(0.5) * (h00 - h11), c = REAL(0.5) * (h01 + h10);
    const REAL x = REAL(1) + REAL(0.5) * t;
    const REAL rho = d * d + c * c, zz = x * x + w * w;
    const REAL e = t + REAL(0.25) * t * t + w * w + rho, product = rho * zz;
    const REAL gx = d * x + c * w, gy = c * x - d * w;
    const REAL ggx = gx * gx - gy * gy, ggy = REAL(2) * gx * gy;
"""
"""Of H: zz = |z|², g = q z̄ and its square."""

SLOPES_OF_ENERGY = """
    const REAL K = m.c[0] + m.c[1];
    const REAL by_e = K * e + REAL(3) * m.c[2] * e * e + m.c[3] * product;
    const REAL by_s = REAL(2) * m.c[1] + m.c[3] * e;
    const REAL A = by_e + by_s * rho;
    const REAL B = by_e + m.c[3] * e * zz + REAL(2) * m.c[1] * (zz - REAL(1));
    const REAL yx = REAL(3) * (m.c[4] * ggx - m.c[5] * ggy);
    const REAL yy = REAL(3) * (m.c[4] * ggy + m.c[5] * ggx);
"""
JOINED = """
    const REAL r00 = by_t + REAL(0.5) * by_d, r01 = REAL(0.5) * (by_c - by_w);
    const REAL r10 = REAL(0.5) * (by_c + by_w), r11 = by_t - REAL(0.5) * by_d;
"""
"""The matrix whose product with δH is by_t δt + by_d δd + by_c δc + by_w δω."""

STRESS = (
    MEASURES
    + SLOPES_OF_ENERGY
    + """
    const REAL by_t = A * x - K * t + REAL(0.5) * (yx * d - yy * c);
    const REAL by_d = REAL(2) * d * B + (yx * x + yy * w);
    const REAL by_c = REAL(2) * c * B - (yy * x - yx * w);
    const REAL by_w = REAL(2) * w * A + (yx * c + yy * d);
"""
    + JOINED
)
"""P = Ψ′(H), (N4)."""

DIRECTION = """
    const REAL dt = d00 + d11, dw = REAL(0.5) * (d10 - d01);
    const REAL dd = REAL(0.5) * (d00 - d11), dc = REAL(0.5) * (d01 + d10);
    const REAL dx = REAL(0.5) * dt;
    const REAL d_rho = REAL(2) * (d * dd + c * dc), d_zz = x * dt + REAL(2) * w * dw;
    const REAL d_e = d_zz + d_rho, d_s = d_rho * zz + rho * d_zz;
    const REAL dgx = dd * x + dc * w + d * dx + c * dw;
    const REAL dgy = dc * x - dd * w + c * dx - d * dw;
    const REAL dggx = gx * dgx - gy * dgy, dggy = gx * dgy + gy * dgx;
"""
"""How the measures change, that of g² by half."""

CURVED = (
    MEASURES
    + SLOPES_OF_ENERGY
    + DIRECTION
    + """
    const REAL d_by_e = (K + REAL(6) * m.c[2] * e) * d_e + m.c[3] * d_s;
    const REAL d_A = d_by_e + m.c[3] * d_e * rho + by_s * d_rho;
    const REAL d_B = d_by_e + m.c[3] * d_e * zz + by_s * d_zz;
    const REAL dyx = REAL(6) * (m.c[4] * dggx - m.c[5] * dggy);
    const REAL dyy = REAL(6) * (m.c[4] * dggy + m.c[5] * dggx);
    const REAL dyzx = dyx * x + dyy * w + yx * dx + yy * dw;
    const REAL dyzy = dyy * x - dyx * w + yy * dx - yx * dw;
    const REAL dyqx = dyx * d - dyy * c + yx * dd - yy * dc;
    const REAL dyqy = dyx * c + dyy * d + yx * dc + yy * dd;
    const REAL by_t = d_A * x + A * dx - K * dt + REAL(0.5) * dyqx;
    const REAL by_d = REAL(2) * (d * d_B + B * dd) + dyzx;
    const REAL by_c = REAL(2) * (c * d_B + B * dc) - dyzy;
    const REAL by_w = REAL(2) * (w * d_A + A * dw) + dyqy;
"""
    + JOINED
)
"""Ψ″(H) D, (N5)."""

SLOPES = (
    MEASURES
    + DIRECTION
    + """
    const REAL bulk_slope = e * d_e - t * dt;
    const REAL n0 = bulk_slope, n1 = bulk_slope + REAL(2) * (d_s - d_rho);
    const REAL n2 = REAL(3) * e * e * d_e, n3 = d_e * product + e * d_s;
    const REAL n4 = REAL(3) * (ggx * dgx - ggy * dgy), n5 = -REAL(3) * (ggx * dgy + ggy * dgx);
"""
)
"""n0 … n5: derivatives of Ψ′(H):D to the six numbers; Ψ is linear in them."""

CLIP = """
    REAL part[LANES], inverse[LANES] = {};
    for (int l = 0; l < LANES; ++l)
        part[l] = REAL(1);
    if (radius > REAL(0))
        for (int l = 0; l < LANES; ++l) {
            OF
            const REAL square = k00 * k00 + k01 * k01 + k10 * k10 + k11 * k11;
            if (square > radius * radius) {
                inverse[l] = REAL(1) / square;
                part[l] = radius / wp::sqrt(square);
            }
        }
"""
"""Before the loop over lanes: |h|/|k| of every lane where k00 … k11, which OF reads, become h00 …
h11, the nearest of |h| ≤ radius, (N10). Roots would be felt, and where the radius is 0 there are
none."""

CLIPPED = """
    const REAL h00 = part[l] * k00, h01 = part[l] * k01;
    const REAL h10 = part[l] * k10, h11 = part[l] * k11;
"""
CLIP_BACK = """
    const REAL along = inverse[l] * (k00 * r00 + k01 * r01 + k10 * r10 + k11 * r11);
    const REAL c00 = part[l] * (r00 - along * k00), c01 = part[l] * (r01 - along * k01);
    const REAL c10 = part[l] * (r10 - along * k10), c11 = part[l] * (r11 - along * k11);
"""
"""The derivative of clipping, which is symmetric, times r."""
