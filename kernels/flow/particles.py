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


@wp.func
def bell(r2: wp.float64, h: wp.float64):
    """The Gaussian of unit integral (F25)."""
    return wp.exp(-r2 / (h * h)) / (wp.float64(3.141592653589793) * h * h)


@wp.func
def flat_bell(r2: wp.float64, h: wp.float64, sharp: wp.float64):
    """Weight of differences; with sharp = 1/3 its third moments cancel (F26)."""
    return wp.exp(-r2 / (h * h)) * (wp.float64(1.0) - sharp * r2 / (h * h))


@wp.kernel(enable_backward=False)
def velocity_gradient(
    row: wp.array(dtype=wp.int32),
    neighbour: wp.array(dtype=wp.int32),
    x: wp.array(dtype=wp.vec2d),
    v: wp.array(dtype=wp.vec2d),
    period: wp.float64,
    h: wp.float64,
    reach: wp.float64,
    sharp: wp.float64,
    kappa: wp.array(dtype=wp.vec4d),
):
    """κ = Σ w (v_j − v_i) d (Σ w d d)⁻¹, exact for linear velocities on any particles (F26)."""
    i = wp.tid()
    B = wp.mat22d()
    G = wp.mat22d()
    for e in range(row[i], row[i + 1]):
        j = neighbour[e]
        d = between(x[j], x[i], period)
        r2 = wp.dot(d, d)
        if r2 < reach * reach:
            w = flat_bell(r2, h, sharp)
            B += wp.outer(d, d) * w
            G += wp.outer(v[j] - v[i], d) * w
    k = G * wp.inverse(B)
    kappa[i] = wp.vec4d(k[0, 0], k[0, 1], k[1, 0], k[1, 1])


@wp.kernel(enable_backward=False)
def density(
    row: wp.array(dtype=wp.int32),
    neighbour: wp.array(dtype=wp.int32),
    x: wp.array(dtype=wp.vec2d),
    sigma: wp.array(dtype=wp.vec4d),
    mass: wp.float64,
    period: wp.float64,
    h: wp.float64,
    reach: wp.float64,
    sound2: wp.float64,
    rho: wp.array(dtype=wp.float64),
    stress: wp.array(dtype=wp.vec4d),
):
    """ρ by summation, and beside the polymer's stress the pressure Cs² (ρ − 1) (F27)."""
    i = wp.tid()
    total = bell(wp.float64(0.0), h)
    for e in range(row[i], row[i + 1]):
        d = between(x[neighbour[e]], x[i], period)
        r2 = wp.dot(d, d)
        if r2 < reach * reach:
            total += bell(r2, h)
    rho[i] = mass * total
    s = sigma[i]
    stress[i] = wp.vec4d(s[0], s[1], s[2], sound2 * (mass * total - wp.float64(1.0)))


@wp.kernel(enable_backward=False)
def place_images(
    fluid: wp.int32,
    parent: wp.array(dtype=wp.int32),
    x: wp.array(dtype=wp.vec2d),
):
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
    x: wp.array(dtype=wp.vec2d),
    stress: wp.array(dtype=wp.vec4d),
    mass: wp.float64,
    period: wp.float64,
    h: wp.float64,
    reach: wp.float64,
    sharp: wp.float64,
    numbers: wp.vec3d,
    a: wp.array(dtype=wp.vec2d),
):
    """(F29): the stress by corrected differences, the pressure symmetrised; numbers Cs², F, Re."""
    i = wp.tid()
    push = wp.vec2d()
    B = wp.mat22d()
    gxx = wp.vec2d()
    gxy = wp.vec2d()
    gyy = wp.vec2d()
    here = stress[i]
    ri = wp.float64(1.0) + here[3] / numbers[0]
    own = here[3] / (ri * ri)
    inverse = wp.float64(1.0) / (h * h)
    strength = wp.float64(2.0) * mass * inverse * inverse / wp.float64(3.141592653589793)
    for e in range(row[i], row[i + 1]):
        j = neighbour[e]
        d = between(x[j], x[i], period)
        r2 = wp.dot(d, d)
        if r2 < reach * reach:
            there = stress[j]
            rj = wp.float64(1.0) + there[3] / numbers[0]
            decay = wp.exp(-r2 * inverse)  # of both weights; the exponential is most of the cost
            push -= d * ((own + there[3] / (rj * rj)) * strength * decay)
            w = d * (decay * (wp.float64(1.0) - sharp * r2 * inverse))
            B += wp.outer(d, w)
            gxx += w * (there[0] - here[0])
            gxy += w * (there[1] - here[1])
            gyy += w * (there[2] - here[2])
    C = wp.inverse(B)
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
