"""Numba's loops for the benchmark, in the best form found for each; needs the extra `bench`.

K of all classes of bonds is computed at every call, as an influence function that is learned asks.
"""

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numba import prange
from scipy.special import comb

from tools.rivals import Tables

parallel = numba.njit(parallel=True, fastmath=True, error_model="numpy")
whole = numba.uint64


def _influence(r, weight, binomial, alpha, D, horizon, kw):
    """K·W of every class of bonds."""
    for c in prange(len(r)):
        x = min(r[c] / horizon, 1.0)
        power, total = 1.0, 0.0
        for k in range(len(D)):
            total = total * (1.0 - x) + D[k] * binomial[k] * power
            power *= x
        kw[c] = weight[c] * r[c] ** -alpha * total


def influence_of(t: Tables) -> tuple[Any, ...]:
    """What K·W of the classes is computed from."""
    binomial = comb(len(t.D) - 1, np.arange(len(t.D)))
    return t.r, t.weight, binomial, float(t.alpha), t.D, float(t.horizon)


@parallel
def _dilatation(row, neighbour, same, r, xi, k, u, m, theta):
    """Weighted volume and dilatation of every node; `same`: 1 where one node's bonds serve all."""
    for i in prange(len(m)):
        volume = total = 0.0
        for e in range(row[i], row[i + 1]):
            p, j = e - same * row[i], neighbour[e]
            volume += k[p] * r[p] * r[p]
            total += k[p] * (xi[p, 0] * (u[j, 0] - u[i, 0]) + xi[p, 1] * (u[j, 1] - u[i, 1]))
        m[i], theta[i] = volume, (total + total) / volume


@parallel
def _force(row, neighbour, same, xi, k, u, m, theta, bulk, shear, out):
    """L u at every node."""
    for i in prange(len(m)):
        a = b = 0.0
        for e in range(row[i], row[i + 1]):
            p, j = e - same * row[i], neighbour[e]
            x, y = xi[p, 0], xi[p, 1]
            stretch = (x * (u[j, 0] - u[i, 0]) + y * (u[j, 1] - u[i, 1])) / (x * x + y * y)
            density = k[p] * (bulk * (theta[i] + theta[j]) + shear * stretch)
            a += density * x
            b += density * y
        out[i, 0], out[i, 1] = a / m[i], b / m[i]


@parallel
def _pressure(row, neighbour, same, back, xi, k, m, h, bulk, tau):
    """2 / m times the gradient to θ, gathered over the bonds back."""
    for i in prange(len(m)):
        total = 0.0
        for e in range(row[i], row[i + 1]):
            p, j = e - same * row[i], neighbour[e]
            mine, far = k[p], k[back[p]]
            total += xi[p, 0] * (mine * h[i, 0] - far * h[j, 0])
            total += xi[p, 1] * (mine * h[i, 1] - far * h[j, 1])
        tau[i] = (bulk + bulk) / m[i] * total


@parallel
def _gradient(
    row, neighbour, same, back, xi, k, u, m, theta, h, tau, bulk, shear, volumes, by_u, by_k
):
    """Gradients to u and, in pieces that no two threads add to, to the K·W of every bond."""
    size = len(m) // len(volumes) + 1
    for piece in prange(len(volumes)):
        for i in range(piece * size, min((piece + 1) * size, len(m))):
            a = b = volume = 0.0
            for e in range(row[i], row[i + 1]):
                p, j = e - same * row[i], neighbour[e]
                mine, far, x, y = k[p], k[back[p]], xi[p, 0], xi[p, 1]
                square = x * x + y * y
                own, other = x * h[i, 0] + y * h[i, 1], x * h[j, 0] + y * h[j, 1]
                push = -shear * (mine * own - far * other) / square
                push -= mine * tau[i] + far * tau[j]
                a += push * x
                b += push * y
                stretch = x * (u[j, 0] - u[i, 0]) + y * (u[j, 1] - u[i, 1])
                density = own * (shear * stretch / square + bulk * (theta[i] + theta[j]))
                volume -= mine * density
                by_k[piece * same, p] += density + tau[i] * stretch
            by_u[i, 0], by_u[i, 1] = a, b
            volume = volume / m[i] - tau[i] * theta[i] / 2
            if same:
                volumes[piece] += volume
            else:
                for e in range(row[i], row[i + 1]):
                    by_k[0, e] += volume * (xi[e, 0] ** 2 + xi[e, 1] ** 2)
        if same:
            for p in range(len(xi)):
                by_k[piece, p] += volumes[piece] * (xi[p, 0] ** 2 + xi[p, 1] ** 2)


@parallel
def _by_influence(r, weight, binomial, alpha, D, horizon, by_kw, by_D, by_alpha):
    """Gradients to D and α, in pieces that no two threads add to."""
    size = len(r) // len(by_D) + 1
    for piece in prange(len(by_D)):
        basis = np.empty(len(D))
        for c in range(piece * size, min((piece + 1) * size, len(r))):
            x = min(r[c] / horizon, 1.0)
            power, total = by_kw[c] * weight[c] * r[c] ** -alpha, 0.0
            for k in range(len(D)):
                basis[k] = binomial[k] * power
                power *= x
            power = 1.0
            for k in range(len(D) - 1, -1, -1):
                by_D[piece, k] += basis[k] * power
                total += D[k] * basis[k] * power
                power *= 1.0 - x
            by_alpha[piece] -= np.log(r[c]) * total


def lists(t: Tables) -> tuple[Callable[[], np.ndarray], Callable[[], list]]:
    """Forward, and forward and gradients to u, D and α, in parallel loops over lists of bonds."""
    fill, shape, kw = parallel(_influence), influence_of(t), np.empty(len(t.r))
    same, pieces = int(len(t.r) < len(t.neighbour)), 2 * numba.get_num_threads()
    bonds = slice(t.row[1] if same else None)
    of = t.bond_class[bonds]
    back = np.arange(len(of)) if same else t.reverse
    xi, u, g = map(np.ascontiguousarray, (t.xi[bonds], t.u, t.g))
    r, k, (m, theta, tau), out = t.r[of], np.empty(len(of)), np.empty((3, len(u))), np.empty_like(u)
    bulk, shear = -2 * (t.lam - t.mu), -16 * t.mu
    links, by_u = (t.row, t.neighbour, same), np.empty_like(u)

    def forward() -> np.ndarray:
        fill(*shape, kw)
        np.take(kw, of, out=k)
        _dilatation(*links, r, xi, k, u, m, theta)
        _force(*links, xi, k, u, m, theta, bulk, shear, out)
        return out

    def both() -> list[np.ndarray]:
        forward()
        h, by_k = g / m[:, None], np.zeros((pieces if same else 1, len(of)))
        _pressure(*links, back, xi, k, m, h, bulk, tau)
        state, volumes = (u, m, theta, h, tau), np.zeros(pieces)
        _gradient(*links, back, xi, k, *state, bulk, shear, volumes, by_u, by_k)
        by_kw = np.bincount(of, by_k.sum(axis=0)) if same else by_k[0]
        by_D, by_alpha = np.zeros((pieces, len(t.D))), np.zeros(pieces)
        _by_influence(*shape, by_kw, by_D, by_alpha)
        return [by_u, by_D.sum(axis=0), by_alpha.sum()]

    return forward, both


@parallel
def _laid_out(u, planes, ring):
    """u by component, with images of rows and columns around it."""
    side, rows = len(u), planes.shape[1]
    for i in prange(rows):
        own = u[(i - ring) % side]
        for c in range(side):
            planes[0, i, ring + c] = own[c, 0]
            planes[1, i, ring + c] = own[c, 1]
        for a in range(2):
            planes[a, i, :ring] = planes[a, i, side : side + ring]
            planes[a, i, ring + side :] = planes[a, i, ring : 2 * ring]


@parallel
def _row_dilatation(steps, bonds, factor, planes, margin):
    rows = planes.shape[1] - 2 * margin
    for n in prange(rows):
        i = n + margin
        total = np.zeros(rows)
        x, y = (planes[0, i, margin : margin + rows], planes[1, i, margin : margin + rows])
        for p in range(len(steps)):
            j, shift = i + steps[p, 0], margin + steps[p, 1]
            vx, vy = planes[0, j, shift : shift + rows], planes[1, j, shift : shift + rows]
            a, b, k = bonds[p, 0], bonds[p, 1], factor[p]
            for c in range(rows):
                total[c] += k * (a * (vx[c] - x[c]) + b * (vy[c] - y[c]))
        planes[2, i, margin : margin + rows] = total


@parallel
def _row_force(steps, bonds, bulk, shear, planes, margin, out):
    side = len(out)
    for n in prange(side):
        i = n + margin
        fx, fy = np.zeros(side), np.zeros(side)
        x, y = planes[0, i, margin : margin + side], planes[1, i, margin : margin + side]
        theta = planes[2, i, margin : margin + side]
        for p in range(len(steps)):
            j, shift = i + steps[p, 0], margin + steps[p, 1]
            vx, vy = planes[0, j, shift : shift + side], planes[1, j, shift : shift + side]
            far = planes[2, j, shift : shift + side]
            a, b = bonds[p, 0], bonds[p, 1]
            push, pull = bulk[p], shear[p] * bonds[p, 2]
            for c in range(side):
                stretch = a * (vx[c] - x[c]) + b * (vy[c] - y[c])
                density = push * (theta[c] + far[c]) + pull * stretch
                fx[c] += density * a
                fy[c] += density * b
        out[n, :, 0], out[n, :, 1] = fx, fy


def rows(t: Tables) -> Callable[[], np.ndarray]:
    """Forward on side × side nodes numbered row by row, the loops along rows without gathers."""
    side, family = round(np.sqrt(len(t.u))), t.row[1] - t.row[0]
    xi, bond_class = t.xi[:family], t.bond_class[:family]
    steps = np.rint(xi / np.abs(xi[xi != 0]).min()).astype(np.int64)
    reach = int(np.abs(steps).max())
    fill, shape, kw = numba.njit()(_influence), influence_of(t), np.empty(len(t.r))
    bonds = np.column_stack([xi, 1 / (xi**2).sum(axis=1)])
    planes = np.zeros((3, side + 4 * reach, side + 4 * reach))
    u, out = t.u.reshape(side, side, 2), np.empty((side, side, 2))
    r, lam, mu = t.r[bond_class], t.lam, t.mu

    def forward() -> np.ndarray:
        fill(*shape, kw)
        k = kw[bond_class]
        m = (k * r**2).sum()
        _laid_out(u, planes, 2 * reach)
        _row_dilatation(steps, bonds, 2 / m * k, planes, reach)
        _row_force(steps, bonds, -2 * (lam - mu) / m * k, -16 * mu / m * k, planes, 2 * reach, out)
        return out.reshape(-1, 2)

    return forward


@parallel
def _broken_dilatation(u, xi, a, neighbour, theta):
    for i in prange(len(u)):
        total = 0.0
        for b in range(len(a)):
            j = neighbour[i, b]
            if j >= 0:
                far = whole(j)
                total += a[b] * (
                    xi[b, 0] * (u[far, 0] - u[i, 0]) + xi[b, 1] * (u[far, 1] - u[i, 1])
                )
        theta[i] = total


@parallel
def _broken_force(u, xi, k, limit, no_fail, neighbour, force, energy, lost, a, excess, theta):
    for i in prange(len(u)):
        fx = fy = e = 0.0
        gone = 0
        for b in range(len(limit)):
            j = neighbour[i, b]
            if j >= 0:
                x, y, far = xi[b, 0], xi[b, 1], whole(j)
                d = x * (u[far, 0] - u[i, 0]) + y * (u[far, 1] - u[i, 1])
                s = k[b] * d
                e += 0.25 * s * d
                s += excess * a[b] * (theta[i] + theta[far])
                fx += s * x
                fy += s * y
                if d > limit[b] and no_fail[i] + no_fail[far] == 0:
                    neighbour[i, b] = -1 - j
                    gone += 1
        force[i, 0], force[i, 1], lost[i] = fx, fy, gone
        energy[i] = e + 0.5 * excess * theta[i] ** 2


def breaking(u, xi, k, limit, no_fail, neighbour, force, energy, lost, a, excess, theta) -> None:
    """A sweep over a state-based body whose bonds break; two nodes at a time are a fifth faster."""
    _broken_dilatation(u, xi, a, neighbour, theta)
    _broken_force(u, xi, k, limit, no_fail, neighbour, force, energy, lost, a, excess, theta)
