"""Forces of square elements at finite strain: G u, pulls of elements, their sums (Dr14–Dr16).

Nodes and elements are numbered as they come; a table leads from each to its neighbours, −1 where
none is. Fields are of plane vectors, [S, N].
"""

import warp as wp


@wp.kernel(enable_backward=False)
def spread(
    first: wp.int32,
    near: wp.array2d(dtype=wp.int32),
    along: wp.float64,
    across: wp.float64,
    u: wp.array2d(dtype=wp.vec2d),
    out: wp.array2d(dtype=wp.vec2d),
):
    """u + Σ g (u(x + ξ) − u(x)) over four neighbours along the axes and four across, where all
    eight are there; elsewhere u."""
    s, t = wp.tid()
    n = first + t
    own = u[s, n]
    side = wp.vec2d()
    corner = wp.vec2d()
    whole = wp.bool(True)
    for k in range(4):
        a = near[n, k]
        c = near[n, 4 + k]
        if a < 0 or c < 0:
            whole = wp.bool(False)
        else:
            side += u[s, a] - own
            corner += u[s, c] - own
    if whole:
        own += along * side + across * corner
    out[s, n] = own


@wp.kernel(enable_backward=False)
def pull(
    first: wp.int32,
    corner: wp.array2d(dtype=wp.int32),
    slope: wp.array2d(dtype=wp.float64),
    C: wp.array2d(dtype=wp.float64),
    T: wp.array2d(dtype=wp.float64),
    weight: wp.float64,
    v: wp.array2d(dtype=wp.vec2d),
    out: wp.array2d(dtype=wp.vec2d),
):
    """weight Σ_g P ∇N of each element's corners, P of C e + ½ T e e at its Gauss points.

    slope has ∂₁N and ∂₂N of the corners at each point in turn, [8, 4]; T its products with
    e₁e₁, e₂e₂, e₃e₃, 2e₁e₂, 2e₂e₃, 2e₁e₃, [3, 6]; out is [S, 4 E].
    """
    s, t = wp.tid()
    e = first + t
    half = wp.float64(0.5)
    u = wp.matrix(shape=(4, 2), dtype=wp.float64)
    f = wp.matrix(shape=(4, 2), dtype=wp.float64)
    for k in range(4):
        own = v[s, corner[e, k]]
        u[k, 0] = own[0]
        u[k, 1] = own[1]
    for g in range(4):
        a = wp.float64(0.0)
        b = wp.float64(0.0)
        c = wp.float64(0.0)
        d = wp.float64(0.0)
        for k in range(4):
            x = slope[2 * g, k]
            y = slope[2 * g + 1, k]
            a += x * u[k, 0]
            b += y * u[k, 0]
            c += x * u[k, 1]
            d += y * u[k, 1]
        e0 = a + half * (a * a + c * c)
        e1 = d + half * (b * b + d * d)
        e2 = b + c + a * b + c * d
        a, d = a + wp.float64(1.0), d + wp.float64(1.0)
        r0 = e0 * e0
        r1 = e1 * e1
        r2 = e2 * e2
        r3 = e0 * e1
        r4 = e1 * e2
        r5 = e0 * e2
        S = wp.vec3d()
        for k in range(3):
            plain = C[k, 0] * e0 + C[k, 1] * e1 + C[k, 2] * e2
            square = half * (T[k, 0] * r0 + T[k, 1] * r1 + T[k, 2] * r2)
            S[k] = plain + square + T[k, 3] * r3 + T[k, 4] * r4 + T[k, 5] * r5
        P0 = weight * (a * S[0] + b * S[2])
        P1 = weight * (a * S[2] + b * S[1])
        P2 = weight * (c * S[0] + d * S[2])
        P3 = weight * (c * S[2] + d * S[1])
        for k in range(4):
            x = slope[2 * g, k]
            y = slope[2 * g + 1, k]
            f[k, 0] = f[k, 0] + x * P0 + y * P1
            f[k, 1] = f[k, 1] + x * P2 + y * P3
    for k in range(4):
        out[s, 4 * e + k] = wp.vec2d(f[k, 0], f[k, 1])


@wp.kernel(enable_backward=False)
def gather(
    first: wp.int32,
    around: wp.array2d(dtype=wp.int32),
    pulls: wp.array2d(dtype=wp.vec2d),
    out: wp.array2d(dtype=wp.vec2d),
):
    """Sums of the pulls at each node, numbers of up to four of them in `around`, [N, 4]."""
    s, t = wp.tid()
    n = first + t
    total = wp.vec2d()
    for k in range(4):
        if around[n, k] >= 0:
            total += pulls[s, around[n, k]]
    out[s, n] = total
