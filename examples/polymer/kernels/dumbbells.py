"""Ensembles of dumbbells under a velocity gradient: theory (F1)–(F3)."""

import warp as wp


@wp.func
def white_noise(seed: wp.int32, number: wp.int32):
    """Three independent numbers of mean 0 and variance 1, uniform: weak order 2 asks no more."""
    state = wp.rand_init(seed, number)
    return wp.vec3f(wp.randf(state) - 0.5, wp.randf(state) - 0.5, wp.randf(state) - 0.5) * 3.4641016


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
