"""Smoothed particles in a channel, periodic along x: theory (F25)–(F29).

Fluid particles come first in every array, then their images behind the walls. A stress is kept
with its pressure, (xx, xy, yy, p).
"""

import warp as wp


@wp.func
def between(a: wp.vec2d, b: wp.vec2d, period: wp.float64):
    """From b to the nearest image of a."""
    d = a - b
    return wp.vec2d(d[0] - period * wp.rint(d[0] / period), d[1])


@wp.kernel(enable_backward=False)
def gather(
    row: wp.array(dtype=wp.int32),
    neighbour: wp.array(dtype=wp.int32),
    x: wp.array(dtype=wp.vec2d),
    v: wp.array(dtype=wp.vec2d),
    shape: wp.vec4d,
    mass: wp.float64,
    bond: wp.array(dtype=wp.vec3d),
    inverse: wp.array(dtype=wp.mat22d),
    kappa: wp.array(dtype=wp.vec4d),
    rho: wp.array(dtype=wp.float64),
):
    """(F26), (F27) in one sweep; shape is period, h, reach, sharp.

    κ = Σ w (v_j − v_i) d B⁻¹, exact for linear velocities on any particles, B = Σ w d d, and ρ by
    summation. A bond keeps d and its decay e^(−r²/h²), 0 beyond the reach, for `acceleration`.
    """
    i = wp.tid()
    h2 = shape[1] * shape[1]
    B = wp.mat22d()
    G = wp.mat22d()
    total = wp.float64(1.0)
    for e in range(row[i], row[i + 1]):
        j = neighbour[e]
        d = between(x[j], x[i], shape[0])
        r2 = wp.dot(d, d)
        decay = wp.float64(0.0)
        if r2 < shape[2] * shape[2]:
            decay = wp.exp(-r2 / h2)
            w = decay * (wp.float64(1.0) - shape[3] * r2 / h2)
            B += wp.outer(d, d) * w
            G += wp.outer(v[j] - v[i], d) * w
            total += decay
        bond[e] = wp.vec3d(d[0], d[1], decay)
    C = wp.inverse(B)
    k = G * C
    inverse[i] = C
    kappa[i] = wp.vec4d(k[0, 0], k[0, 1], k[1, 0], k[1, 1])
    rho[i] = mass * total / (wp.float64(3.141592653589793) * h2)


@wp.kernel(enable_backward=False)
def total_stress(
    sigma: wp.array(dtype=wp.vec4d),
    kappa: wp.array(dtype=wp.vec4d),
    rho: wp.array(dtype=wp.float64),
    sound2: wp.float64,
    solvent: wp.float64,
    stress: wp.array(dtype=wp.vec4d),
):
    """The polymer's stress in the plane with the solvent's (F10), and beside it Cs² (ρ − 1)."""
    i = wp.tid()
    s = sigma[i]
    k = kappa[i]
    stress[i] = wp.vec4d(
        s[0] + wp.float64(2.0) * solvent * k[0],
        s[1] + solvent * (k[1] + k[2]),
        s[2] + wp.float64(2.0) * solvent * k[3],
        sound2 * (rho[i] - wp.float64(1.0)),
    )


@wp.kernel(enable_backward=False)
def place_images(fluid: wp.int32, parent: wp.array(dtype=wp.int32), x: wp.array(dtype=wp.vec2d)):
    """Images behind the nearer wall, after the fluid in the same array."""
    i = wp.tid()
    p = x[parent[i]]
    if p[1] < wp.float64(0.5):
        x[fluid + i] = wp.vec2d(p[0], -p[1])
    else:
        x[fluid + i] = wp.vec2d(p[0], wp.float64(2.0) - p[1])


@wp.kernel(enable_backward=False)
def image_fields(
    fluid: wp.int32,
    parent: wp.array(dtype=wp.int32),
    x: wp.array(dtype=wp.vec2d),
    force: wp.float64,
    v: wp.array(dtype=wp.vec2d),
    stress: wp.array(dtype=wp.vec4d),
):
    """What images carry (F28): v odd about the wall, stress even but for the slope −F of σ_xy."""
    i = wp.tid()
    j = parent[i]
    y = x[j][1]
    d = y
    turn = force
    if y > wp.float64(0.5):
        d = wp.float64(1.0) - y
        turn = -force
    v[fluid + i] = -v[j]
    s = stress[j]
    stress[fluid + i] = wp.vec4d(s[0], s[1] + wp.float64(2.0) * turn * d, s[2], s[3])


@wp.kernel(enable_backward=False)
def acceleration(
    row: wp.array(dtype=wp.int32),
    neighbour: wp.array(dtype=wp.int32),
    bond: wp.array(dtype=wp.vec3d),
    inverse: wp.array(dtype=wp.mat22d),
    stress: wp.array(dtype=wp.vec4d),
    shape: wp.vec4d,
    mass: wp.float64,
    numbers: wp.vec3d,
    a: wp.array(dtype=wp.vec2d),
):
    """(F29): the stress by corrected differences, the pressure symmetrised; numbers Cs², F, Re."""
    i = wp.tid()
    push = wp.vec2d()
    gxx = wp.vec2d()
    gxy = wp.vec2d()
    gyy = wp.vec2d()
    here = stress[i]
    ri = wp.float64(1.0) + here[3] / numbers[0]
    own = here[3] / (ri * ri)
    narrow = wp.float64(1.0) / (shape[1] * shape[1])
    strength = wp.float64(2.0) * mass * narrow * narrow / wp.float64(3.141592653589793)
    for e in range(row[i], row[i + 1]):
        decay = bond[e][2]
        if decay > wp.float64(0.0):
            there = stress[neighbour[e]]
            d = wp.vec2d(bond[e][0], bond[e][1])
            rj = wp.float64(1.0) + there[3] / numbers[0]
            push -= d * ((own + there[3] / (rj * rj)) * strength * decay)
            w = d * (decay * (wp.float64(1.0) - shape[3] * wp.dot(d, d) * narrow))
            gxx += w * (there[0] - here[0])
            gxy += w * (there[1] - here[1])
            gyy += w * (there[2] - here[2])
    C = inverse[i]
    fx = wp.dot(wp.vec2d(C[0, 0], C[0, 1]), gxx) + wp.dot(wp.vec2d(C[1, 0], C[1, 1]), gxy)
    fy = wp.dot(wp.vec2d(C[0, 0], C[0, 1]), gxy) + wp.dot(wp.vec2d(C[1, 0], C[1, 1]), gyy)
    a[i] = (push + wp.vec2d(fx / ri + numbers[1], fy / ri)) / numbers[2]


@wp.kernel(enable_backward=False)
def kick(a: wp.array(dtype=wp.vec2d), t: wp.float64, v: wp.array(dtype=wp.vec2d)):
    """v += a t."""
    i = wp.tid()
    v[i] = v[i] + a[i] * t


@wp.kernel(enable_backward=False)
def drift(v: wp.array(dtype=wp.vec2d), t: wp.float64, x: wp.array(dtype=wp.vec2d)):
    """x += v t."""
    i = wp.tid()
    x[i] = x[i] + v[i] * t
