"""The sweeps of sweeps.py in Warp's own words, bond by bond: the reference of its tests, and what
other devices than the processor run. Bonds lie in lists, `far` is always given."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.lps.sweeps import struct


@cache
def plain(scalar, dimension):
    """The kernels in one precision and dimension."""
    Law, d = struct(scalar, dimension), dimension
    table, array, pieces = (
        wp.array2d(dtype=scalar),
        wp.array(dtype=scalar),
        wp.array(dtype=wp.vec3i),
    )
    c1, c2 = wp.constant(scalar(d)), wp.constant(scalar(d * (d + 2)))

    @wp.func
    def at(field: array, i: wp.int32):
        return field[wp.min(i, field.shape[0] - 1)]

    @wp.func
    def along(of: Law, e: wp.int32, i: wp.int32, s: wp.int32, u: table, k: scalar, back: scalar):
        """ξ·(back u(ξ) − k u), exactly zero of a translation where both are equal."""
        total = scalar(0.0)
        for a in range(d):
            far = u[s, (i + of.end[e]) * d + a]
            total += of.bond[e][a] * (k * (far - u[s, i * d + a]) + (back - k) * far)
        return total

    @wp.kernel(enable_backward=False, module="unique")
    def dilatation(nodes: pieces, of: Law, u: table, theta: table):
        s, t = wp.tid()
        i = nodes[t][0]
        total = scalar(0.0)
        for e in range(of.row[i], of.row[i + 1]):
            total += c1 * along(of, e, i, s, u, of.own[e], of.far[e])
        theta[s, i] = total

    @wp.kernel(enable_backward=False, module="unique")
    def force(nodes: pieces, of: Law, u: table, theta: table, vectors: table):
        s, t = wp.tid()
        i = nodes[t][0]
        for a in range(d):
            vectors[s, nodes[t][1] * d + a] = scalar(0.0)
        for e in range(of.row[i], of.row[i + 1]):
            j = i + of.end[e]
            q = of.own[e] * at(of.bulk, i) * theta[s, i] + of.far[e] * at(of.bulk, j) * theta[s, j]
            shear = c2 * of.bond[e][d] * (at(of.mu, i) + at(of.mu, j))
            density = c1 * q + shear * along(of, e, i, s, u, of.own[e], of.far[e])
            for a in range(d):
                vectors[s, nodes[t][1] * d + a] -= density * of.bond[e][a]

    @wp.kernel(enable_backward=False, module="unique")
    def slopes(nodes: pieces, of: Law, u: table, theta: table, g: table, tau: table,
               by_own: table, by_mu: array, by_bulk: array):  # fmt: skip
        i = nodes[wp.tid()][0]
        total = scalar(0.0)
        for e in range(of.row[i], of.row[i + 1]):
            j = i + of.end[e]
            if j != i:
                shear = c2 * of.bond[e][d]
                for s in range(u.shape[0]):
                    push = scalar(0.0)
                    for a in range(d):
                        push -= of.bond[e][a] * g[s, i * d + a]
                    ahead = along(of, e, i, s, u, scalar(1.0), scalar(1.0))
                    q = at(of.bulk, i) * theta[s, i] + at(of.bulk, j) * theta[s, j]
                    bent = shear * (at(of.mu, i) + at(of.mu, j)) * ahead
                    pulled = c1 * at(of.bulk, i) * tau[s, i] * ahead
                    by_own[0, e] += push * (c1 * q + bent) + pulled
                    by_mu[i] += shear * ahead * along(of, e, i, s, g, of.own[e], of.far[e])
                total += by_own[0, e] * of.own[e]
        for e in range(of.row[i], of.row[i + 1]):
            by_own[0, e] = (by_own[0, e] - total / of.bond[e][d]) / of.m[i]
        for s in range(u.shape[0]):
            by_bulk[i] += theta[s, i] * tau[s, i]

    return SimpleNamespace(Law=Law, dilatation=dilatation, force=force, slopes=slopes)
