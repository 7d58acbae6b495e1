"""The sweeps of sweeps.py over lists in Warp's own words, bond by bond: what its tests compare."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.lps.sweeps import struct


@cache
def plain(scalar, dimension):
    """The kernels in one precision and dimension."""
    Law, d = struct(scalar, dimension), dimension
    table, array = wp.array2d(dtype=scalar), wp.array(dtype=scalar)
    pieces = wp.array(dtype=wp.vec3i)
    c1, c2 = wp.constant(scalar(d)), wp.constant(scalar(d * (d + 2)))

    @wp.func
    def at(field: array, i: wp.int32):
        return field[wp.min(i, field.shape[0] - 1)]

    @wp.func
    def along(of: Law, e: wp.int32, i: wp.int32, s: wp.int32, u: table, k: scalar, back: scalar):
        """ξ·(back u(ξ) − k u)."""
        total = scalar(0.0)
        for a in range(d):
            far = u[s, (i + of.end[e]) * d + a]
            total += of.bond[e][a] * (back * far - k * u[s, i * d + a])
        return total

    @wp.func
    def back_of(of: Law, e: wp.int32):
        return of.own[e] if of.far.shape[0] == 0 else of.far[e]

    @wp.kernel(enable_backward=False, module="unique")
    def dilatation(nodes: pieces, of: Law, u: table, theta: table):
        s, t = wp.tid()
        i = nodes[t][0]
        total = scalar(0.0)
        for e in range(of.row[i], of.row[i + 1]):
            if of.far.shape[0] == 0 and of.bent.shape[0] > 0:
                for a in range(d):
                    j = i + of.end[e]
                    total += of.bent[e][a] * (u[s, j * d + a] - u[s, i * d + a])
            else:
                total += c1 * along(of, e, i, s, u, of.own[e], back_of(of, e))
        theta[s, i] = total

    @wp.kernel(enable_backward=False, module="unique")
    def force(nodes: pieces, of: Law, u: table, theta: table, vectors: table):
        s, t = wp.tid()
        i = nodes[t][0]
        for a in range(d):
            vectors[s, nodes[t][1] * d + a] = scalar(0.0)
        for e in range(of.row[i], of.row[i + 1]):
            j = i + of.end[e]
            mine, far = at(of.bulk, i) * theta[s, i], at(of.bulk, j) * theta[s, j]
            shear = c2 * of.bond[e][d] * (at(of.mu, i) + at(of.mu, j))
            density = shear * along(of, e, i, s, u, of.own[e], back_of(of, e))
            for a in range(d):
                pull = c1 * of.bond[e][a] * (of.own[e] * mine + back_of(of, e) * far)
                if of.far.shape[0] > 0 and of.bent.shape[0] > 0:
                    pull = of.bent[e][a] * mine + of.bent_back[e][a] * far
                vectors[s, nodes[t][1] * d + a] -= density * of.bond[e][a] + pull

    @wp.kernel(enable_backward=False, module="unique")
    def slopes(nodes: pieces, of: Law, u: table, theta: table, g: table, tau: table,
               by_own: table, by_mu: array, by_bulk: array):  # fmt: skip
        i = nodes[wp.tid()][0]
        for e in range(of.row[i], of.row[i + 1]):
            j = i + of.end[e]
            shear = c2 * of.bond[e][d]
            for s in range(u.shape[0]):
                push = scalar(0.0)
                for a in range(d):
                    push -= of.bond[e][a] * g[s, i * d + a]
                ahead = along(of, e, i, s, u, scalar(1.0), scalar(1.0))
                q = at(of.bulk, i) * theta[s, i] + at(of.bulk, j) * theta[s, j]
                bent = shear * (at(of.mu, i) + at(of.mu, j)) * ahead
                by_own[0, e] += push * (c1 * q + bent) + c1 * at(of.bulk, i) * tau[s, i] * ahead
                by_mu[i] += shear * ahead * along(of, e, i, s, g, of.own[e], back_of(of, e))
        for s in range(u.shape[0]):
            by_bulk[i] += theta[s, i] * tau[s, i]

    return SimpleNamespace(dilatation=dilatation, force=force, slopes=slopes)
