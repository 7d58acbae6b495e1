"""Ensembles of dumbbells under a velocity gradient: theory (F1)–(F6)."""

import warp as wp


@wp.func
def white_noise(seed: wp.int32, number: wp.int32):
    """Three independent numbers of mean 0 and variance 1, uniform: weak order 2 asks no more."""
    state = wp.rand_init(seed, number)
    return wp.vec3f(wp.randf(state) - 0.5, wp.randf(state) - 0.5, wp.randf(state) - 0.5) * 3.4641016


@wp.func
def spring_length(r: wp.float32, h: wp.float32, b: wp.float32):
    """The root in (0, √b) of x (1 + h / (1 − x²/b)) = r, the middle one of a cubic (F5)."""
    p = wp.sqrt((r * r + 3.0 * b * (1.0 + h)) / 9.0)
    c = (-2.0 * r * r * r - 9.0 * r * b * (1.0 + h) + 27.0 * r * b) / (54.0 * p * p * p)
    angle = wp.acos(wp.clamp(c, -1.0, 1.0))
    return r / 3.0 - 2.0 * p * wp.cos((angle - 6.2831853) / 3.0)


@wp.kernel(enable_backward=False)
def advance_hookean(
    first: wp.int32,
    P: wp.array2d(dtype=wp.float32),
    L: wp.array2d(dtype=wp.float32),
    seed: wp.int32,
    steps: wp.int32,
    common: wp.int32,
    blocks: wp.int32,
    q: wp.array2d(dtype=wp.vec3f),
    sums: wp.array2d(dtype=wp.float64),
):
    """Some steps of (F3) and then Σ q q, a block of dumbbells of one ensemble a thread."""
    t = first + wp.tid()
    i = t / blocks
    n = q.shape[1]
    begin = wp.int32(wp.int64(n) * wp.int64(t % blocks) / wp.int64(blocks))
    end = wp.int32(wp.int64(n) * wp.int64(t % blocks + 1) / wp.int64(blocks))
    pxx, pxy, pyx, pyy, pzz = P[i, 0], P[i, 1], P[i, 2], P[i, 3], P[i, 4]
    lxx, lyx, lyy, lzz = L[i, 0], L[i, 1], L[i, 2], L[i, 3]
    cxx = wp.float32(0.0)
    cxy = wp.float32(0.0)
    cyy = wp.float32(0.0)
    czz = wp.float32(0.0)
    for j in range(begin, end):
        number = j
        if common == 0:
            number = i * n + j
        p = q[i, j]
        for step in range(steps):
            w = white_noise(seed + step, number)
            p = wp.vec3f(
                pxx * p[0] + pxy * p[1] + lxx * w[0],
                pyx * p[0] + pyy * p[1] + lyx * w[0] + lyy * w[1],
                pzz * p[2] + lzz * w[2],
            )
        q[i, j] = p
        cxx += p[0] * p[0]
        cxy += p[0] * p[1]
        cyy += p[1] * p[1]
        czz += p[2] * p[2]
    sums[t, 0] = wp.float64(cxx)
    sums[t, 1] = wp.float64(cxy)
    sums[t, 2] = wp.float64(cyy)
    sums[t, 3] = wp.float64(czz)


@wp.kernel(enable_backward=False)
def advance_fene(
    first: wp.int32,
    K: wp.array2d(dtype=wp.float32),
    b: wp.float32,
    dt: wp.float32,
    seed: wp.int32,
    steps: wp.int32,
    common: wp.int32,
    blocks: wp.int32,
    q: wp.array2d(dtype=wp.vec3f),
    sums: wp.array2d(dtype=wp.float64),
):
    """Some steps of (F4)–(F5) and then Σ q q and Σ q q / (1 − q²/b)."""
    t = first + wp.tid()
    i = t / blocks
    n = q.shape[1]
    begin = wp.int32(wp.int64(n) * wp.int64(t % blocks) / wp.int64(blocks))
    end = wp.int32(wp.int64(n) * wp.int64(t % blocks + 1) / wp.int64(blocks))
    kxx, kxy, kyx, kyy = K[i, 0], K[i, 1], K[i, 2], K[i, 3]
    a = wp.sqrt(dt)
    cxx, cxy = wp.float32(0.0), wp.float32(0.0)
    cyy, czz = wp.float32(0.0), wp.float32(0.0)
    sxx = wp.float32(0.0)
    sxy = wp.float32(0.0)
    syy = wp.float32(0.0)
    szz = wp.float32(0.0)
    for j in range(begin, end):
        number = j
        if common == 0:
            number = i * n + j
        p = q[i, j]
        for step in range(steps):
            w = white_noise(seed + step, number) * a
            f = 1.0 / (1.0 - wp.dot(p, p) / b)
            v = wp.vec3f(kxx * p[0] + kxy * p[1], kyx * p[0] + kyy * p[1], 0.0)
            e = p + (v - p * (0.5 * f)) * dt + w
            u = wp.vec3f(kxx * e[0] + kxy * e[1], kyx * e[0] + kyy * e[1], 0.0)
            r = p + ((v + u) * 0.5 - p * (0.25 * f)) * dt + w
            length = wp.max(wp.length(r), 1.0e-12)
            x = wp.min(spring_length(length, 0.25 * dt, b), 0.99999 * wp.sqrt(b))
            p = r * (x / length)
        q[i, j] = p
        f = 1.0 / (1.0 - wp.dot(p, p) / b)
        cxx += p[0] * p[0]
        cxy += p[0] * p[1]
        cyy += p[1] * p[1]
        czz += p[2] * p[2]
        sxx += p[0] * p[0] * f
        sxy += p[0] * p[1] * f
        syy += p[1] * p[1] * f
        szz += p[2] * p[2] * f
    sums[t, 0] = wp.float64(cxx)
    sums[t, 1] = wp.float64(cxy)
    sums[t, 2] = wp.float64(cyy)
    sums[t, 3] = wp.float64(czz)
    sums[t, 4] = wp.float64(sxx)
    sums[t, 5] = wp.float64(sxy)
    sums[t, 6] = wp.float64(syy)
    sums[t, 7] = wp.float64(szz)
