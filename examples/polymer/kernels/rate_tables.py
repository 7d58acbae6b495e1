"""A learned rate by tables of one input each, advanced by Heun's rule: theory (F20)."""

import warp as wp


@wp.func
def looked_up(
    table: wp.array3d(dtype=wp.vec3d),
    i: wp.int32,
    x: wp.float64,
    low: wp.float64,
    scale: wp.float64,
):
    """The cubic of input i; beyond its ends the table is constant."""
    last = wp.float64(table.shape[1])
    place = wp.clamp((x - low) * scale, wp.float64(0.0), last)
    n = wp.min(wp.int32(place), table.shape[1] - 1)
    t = place - wp.float64(n)
    return ((table[i, n, 0] * t + table[i, n, 1]) * t + table[i, n, 2]) * t + table[i, n, 3]


@wp.func
def rate_of(
    K: wp.vec4d,
    C: wp.vec4d,
    table: wp.array3d(dtype=wp.vec3d),
    low: wp.array(dtype=wp.float64),
    scale: wp.array(dtype=wp.float64),
    middle: wp.vec3d,
    kinematics: wp.float64,
):
    """dC/dt, with K C + C Kᵗ times `kinematics`, 0 or 1; C = I + s."""
    f = middle
    for i in range(4):
        f += looked_up(table, i, K[i], low[i], scale[i])
    f += looked_up(table, 4, C[0] - wp.float64(1.0), low[4], scale[4])
    f += looked_up(table, 5, C[1], low[5], scale[5])
    f += looked_up(table, 6, C[2] - wp.float64(1.0), low[6], scale[6])
    two = wp.float64(2.0) * kinematics
    return wp.vec4d(
        f[0] + two * (K[0] * C[0] + K[1] * C[1]),
        f[1] + kinematics * ((K[0] + K[3]) * C[1] + K[1] * C[2] + K[2] * C[0]),
        f[2] + two * (K[2] * C[1] + K[3] * C[2]),
        wp.float64(1.0) - C[3],
    )


@wp.kernel(enable_backward=False)
def heun_steps(
    K: wp.array(dtype=wp.vec4d),
    table: wp.array3d(dtype=wp.vec3d),
    low: wp.array(dtype=wp.float64),
    scale: wp.array(dtype=wp.float64),
    middle: wp.vec3d,
    kinematics: wp.float64,
    h: wp.float64,
    parts: wp.int32,
    C: wp.array(dtype=wp.vec4d),
):
    """Some steps of h relaxation times under K held, a state a thread."""
    n = wp.tid()
    k = K[n]
    c = C[n]
    for _part in range(parts):
        a = rate_of(k, c, table, low, scale, middle, kinematics)
        b = rate_of(k, c + a * h, table, low, scale, middle, kinematics)
        c = c + (a + b) * (wp.float64(0.5) * h)
    C[n] = c
