"""The energy Ψ of a displacement gradient, its stress and the product with its Hessian, (N1–N5).

H = (t/2) I + Q + ω J with the deviator Q = [[d, c], [c, −d]] and J a quarter turn. With q = d + i c
and z = 1 + t/2 + i ω, the Green strain has the trace e = t + t²/4 + ω² + |q|² and the deviator
w = q z̄. The numbers of a material are λ, μ, t3, tq2, and q3 e^(−6ia) by real and imaginary part.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp


@cache
def _times(scalar):
    vec = wp.types.vector(2, scalar)

    @wp.func
    def times(a: vec, b: vec):
        """The product of complex numbers."""
        return vec(a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0])

    return times


@cache
def _parts(scalar):
    mat, four = wp.types.matrix((2, 2), scalar), wp.types.vector(4, scalar)
    half = scalar(0.5)

    @wp.func
    def parts(H: mat):
        """t, d, c and ω of a gradient: trace, half differences, shear, rotation."""
        return four(
            H[0, 0] + H[1, 1],
            half * (H[0, 0] - H[1, 1]),
            half * (H[0, 1] + H[1, 0]),
            half * (H[1, 0] - H[0, 1]),
        )

    return parts


@cache
def _joined(scalar):
    mat = wp.types.matrix((2, 2), scalar)
    half = scalar(0.5)

    @wp.func
    def joined(by_t: scalar, by_d: scalar, by_c: scalar, by_w: scalar):
        """The matrix whose product with δH is by_t δt + by_d δd + by_c δc + by_w δω."""
        return mat(
            by_t + half * by_d, half * (by_c - by_w), half * (by_c + by_w), by_t - half * by_d
        )

    return joined


@cache
def _stress(scalar):
    vec, mat = wp.types.vector(2, scalar), wp.types.matrix((2, 2), scalar)
    numbers = wp.types.vector(6, scalar)
    half, unit, two = scalar(0.5), scalar(1.0), scalar(2.0)
    times, parts, joined = _times(scalar), _parts(scalar), _joined(scalar)

    @wp.func
    def stress(H: mat, m: numbers):
        """P = Ψ′(H), (N4)."""
        h = parts(H)
        t = h[0]
        w = h[3]
        q = vec(h[1], h[2])
        x = unit + half * t
        z = vec(x, -w)
        rho = wp.dot(q, q)
        zz = x * x + w * w
        e = t + scalar(0.25) * t * t + w * w + rho
        s = rho * zz
        K = m[0] + m[1]
        by_e = K * e + scalar(3.0) * m[2] * e * e + m[3] * s
        by_s = two * m[1] + m[3] * e
        g = times(q, z)
        y = scalar(3.0) * times(vec(m[4], m[5]), times(g, g))
        yz = times(y, z)
        yq = times(y, q)
        A = by_e + by_s * rho
        B = by_e + m[3] * e * zz + two * m[1] * (zz - unit)
        return joined(
            A * x - K * t + half * yq[0],
            two * q[0] * B + yz[0],
            two * q[1] * B - yz[1],
            two * w * A + yq[1],
        )

    return stress


@cache
def _curved(scalar):
    vec, mat = wp.types.vector(2, scalar), wp.types.matrix((2, 2), scalar)
    numbers = wp.types.vector(6, scalar)
    half, unit, two = scalar(0.5), scalar(1.0), scalar(2.0)
    times, parts, joined = _times(scalar), _parts(scalar), _joined(scalar)

    @wp.func
    def curved(H: mat, m: numbers, D: mat):
        """Ψ″(H) D, (N5)."""
        h = parts(H)
        v = parts(D)
        t = h[0]
        w = h[3]
        q = vec(h[1], h[2])
        x = unit + half * t
        z = vec(x, -w)
        rho = wp.dot(q, q)
        zz = x * x + w * w
        e = t + scalar(0.25) * t * t + w * w + rho
        s = rho * zz
        K = m[0] + m[1]
        by_e = K * e + scalar(3.0) * m[2] * e * e + m[3] * s
        by_s = two * m[1] + m[3] * e
        A = by_e + by_s * rho
        B = by_e + m[3] * e * zz + two * m[1] * (zz - unit)
        dq = vec(v[1], v[2])
        dz = vec(half * v[0], -v[3])
        d_rho = two * wp.dot(q, dq)
        d_zz = x * v[0] + two * w * v[3]
        d_e = d_zz + d_rho
        d_s = d_rho * zz + rho * d_zz
        d_by_e = (K + scalar(6.0) * m[2] * e) * d_e + m[3] * d_s
        d_A = d_by_e + m[3] * d_e * rho + by_s * d_rho
        d_B = d_by_e + m[3] * d_e * zz + by_s * d_zz
        g = times(q, z)
        dg = times(dq, z) + times(q, dz)
        Q = vec(m[4], m[5])
        y = scalar(3.0) * times(Q, times(g, g))
        dy = scalar(6.0) * times(Q, times(g, dg))
        dyz = times(dy, z) + times(y, dz)
        dyq = times(dy, q) + times(y, dq)
        return joined(
            d_A * x + half * A * v[0] - K * v[0] + half * dyq[0],
            two * (q[0] * d_B + B * dq[0]) + dyz[0],
            two * (q[1] * d_B + B * dq[1]) - dyz[1],
            two * (w * d_A + A * v[3]) + dyq[1],
        )

    return curved


@cache
def _slopes(scalar):
    vec, mat = wp.types.vector(2, scalar), wp.types.matrix((2, 2), scalar)
    numbers = wp.types.vector(6, scalar)
    half, unit, two = scalar(0.5), scalar(1.0), scalar(2.0)
    times, parts = _times(scalar), _parts(scalar)

    @wp.func
    def slopes(H: mat, D: mat):
        """Derivatives of Ψ′(H):D to the six numbers; Ψ is linear in them."""
        h = parts(H)
        v = parts(D)
        t = h[0]
        w = h[3]
        q = vec(h[1], h[2])
        x = unit + half * t
        z = vec(x, -w)
        rho = wp.dot(q, q)
        zz = x * x + w * w
        e = t + scalar(0.25) * t * t + w * w + rho
        s = rho * zz
        dq = vec(v[1], v[2])
        dz = vec(half * v[0], -v[3])
        d_rho = two * wp.dot(q, dq)
        d_zz = x * v[0] + two * w * v[3]
        d_e = d_zz + d_rho
        d_s = d_rho * zz + rho * d_zz
        g = times(q, z)
        cubic = scalar(3.0) * times(times(g, g), times(dq, z) + times(q, dz))
        bulk = e * d_e - t * v[0]
        return numbers(
            bulk,
            bulk + two * (d_s - d_rho),
            scalar(3.0) * e * e * d_e,
            d_e * s + e * d_s,
            cubic[0],
            -cubic[1],
        )

    return slopes


@cache
def _clipped(scalar):
    mat = wp.types.matrix((2, 2), scalar)

    @wp.func
    def clipped(H: mat, radius: scalar):
        """The nearest matrix of |H| ≤ radius; H itself where the radius is 0."""
        size = wp.sqrt(wp.ddot(H, H))
        if radius > scalar(0.0) and size > radius:
            return (radius / size) * H
        return H

    return clipped


@cache
def _clipped_back(scalar):
    mat = wp.types.matrix((2, 2), scalar)
    unit = scalar(1.0)

    @wp.func
    def clipped_back(H: mat, radius: scalar, D: mat):
        """The derivative of `clipped` at H, which is symmetric, times D."""
        size = wp.sqrt(wp.ddot(H, H))
        if radius > scalar(0.0) and size > radius:
            n = (unit / size) * H
            return (radius / size) * (D - wp.ddot(n, D) * n)
        return D

    return clipped_back


@cache
def law(scalar):
    """Functions of H in one precision."""
    vec, mat = wp.types.vector(2, scalar), wp.types.matrix((2, 2), scalar)
    numbers = wp.types.vector(6, scalar)
    return SimpleNamespace(
        vec=vec,
        mat=mat,
        numbers=numbers,
        stress=_stress(scalar),
        curved=_curved(scalar),
        slopes=_slopes(scalar),
        clipped=_clipped(scalar),
        clipped_back=_clipped_back(scalar),
    )
