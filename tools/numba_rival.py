"""The operator and its adjoint in parallel Numba loops, to measure the library against."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import comb

from tools.rivals import Tables


@dataclass(frozen=True)
class Loops:
    """What the loops are compiled with; Numba takes its numbers for constants.

    `jit`: numba.njit with its options; `prange`: numba.prange; `dtype`: of all numbers; `pattern`:
    whether all nodes are alike, so that tables are kept by the step from node to node; `volumes`:
    how many weighted volumes differ; `lam`, `mu`, `horizon`: of the model; `parts`: pieces that
    sums are split into, so that no two threads add to one.
    """

    jit: Any
    prange: Any
    dtype: Any
    pattern: bool
    volumes: int
    lam: Any
    mu: Any
    horizon: Any
    parts: int

    @property
    def constants(self) -> tuple[Any, ...]:
        """What forces and their adjoints take: dtype, pattern, prange, λ, μ, 2 and 16."""
        numbers = self.dtype(2), self.dtype(16)
        return self.dtype, self.pattern, self.prange, self.lam, self.mu, *numbers


def numba_parallel(t: Tables, dtype: Any, *, fastmath: bool) -> tuple[Callable, Callable]:
    """Forward, and forward and hand-written adjoint to (u, D, α), in parallel Numba loops."""
    import numba

    size, degree = len(t.u), len(t.D) - 1
    bonds = t.row[1] - t.row[0]
    pattern = len(t.r) < len(t.neighbour)
    parts = 2 * numba.get_num_threads()
    loops = Loops(
        numba.njit(parallel=True, fastmath=fastmath),
        numba.prange,
        dtype,
        pattern,
        1 if pattern else size,
        dtype(t.lam),
        dtype(t.mu),
        dtype(t.horizon),
        parts,
    )
    volume, dilatation, force = _volume(loops), _dilatation(loops), _force(loops)
    theta_adjoint, adjoint = _theta_adjoint(loops), _adjoint(loops)
    influence, influence_adjoint = _influence(loops), _influence_adjoint(loops)
    xi = np.ascontiguousarray(t.xi[:bonds] if pattern else t.xi, dtype)
    bond_class = t.bond_class[:bonds] if pattern else t.bond_class
    r, weight, D, u, g = (np.asarray(v, dtype) for v in (t.r, t.weight, t.D, t.u, t.g))
    alpha, binomial = dtype(t.alpha), comb(degree, np.arange(degree + 1)).astype(dtype)
    kw, m = np.empty(len(r), dtype), np.empty(size, dtype)
    theta, tau = np.empty_like(m), np.empty_like(m)
    out, u_bar = np.empty_like(u), np.empty_like(u)
    links = (t.row, t.neighbour, bond_class)

    def forward():
        influence(r, weight, binomial, alpha, D, kw)
        volume(t.row, bond_class, r, kw, m)
        dilatation(*links, xi, kw, m, u, theta)
        force(*links, xi, kw, m, u, theta, out)
        return out

    def both():
        forward()
        h = g / m[:, None]
        theta_adjoint(*links, t.reverse, xi, kw, m, h, tau)
        bar = np.zeros((parts, bonds) if pattern else (1, len(r)), dtype)
        adjoint(*links, t.reverse, xi, kw, m, u, theta, h, tau, u_bar, bar)
        kw_bar = bar[0]
        if pattern:
            kw_bar = np.bincount(bond_class, bar.sum(axis=0)).astype(dtype)
        sums = np.zeros((parts, degree + 2), dtype)
        influence_adjoint(r, weight, binomial, alpha, D, kw_bar, sums)
        total = sums.sum(axis=0)
        return u_bar, total[:-1], total[-1]

    return forward, both


def influence_loop(t: Tables, dtype: Any) -> Callable[[], np.ndarray]:
    """K·W of every class, computed at every call."""
    import numba

    degree = len(t.D) - 1
    lam, mu, horizon = dtype(t.lam), dtype(t.mu), dtype(t.horizon)
    loops = Loops(numba.njit(), range, dtype, True, 1, lam, mu, horizon, 1)
    influence = _influence(loops)
    r, weight, D = (np.asarray(v, dtype) for v in (t.r, t.weight, t.D))
    binomial, kw = comb(degree, np.arange(degree + 1)).astype(dtype), np.empty(len(r), dtype)

    def call() -> np.ndarray:
        influence(r, weight, binomial, dtype(t.alpha), D, kw)
        return kw

    return call


def _volume(loops):
    """Weighted volume of every node, or of one where all are alike."""
    dtype, pattern, prange, volumes = loops.dtype, loops.pattern, loops.prange, loops.volumes

    @loops.jit
    def volume(row, bond_class, r, kw, m):
        for i in prange(volumes):
            total = dtype(0)
            for e in range(row[i], row[i + 1]):
                c = bond_class[e - row[i]] if pattern else e
                total += kw[c] * r[c] * r[c]
            m[i] = total
        if pattern:
            m[1:] = m[0]

    return volume


def _dilatation(loops):
    """θ at every node."""
    dtype, pattern, prange, two = loops.dtype, loops.pattern, loops.prange, loops.dtype(2)

    @loops.jit
    def dilatation(row, neighbour, bond_class, xi, kw, m, u, theta):
        for i in prange(len(m)):
            total = dtype(0)
            for e in range(row[i], row[i + 1]):
                p = e - row[i] if pattern else e
                k = kw[bond_class[p]] if pattern else kw[p]
                j = neighbour[e]
                stretch = xi[p, 0] * (u[j, 0] - u[i, 0]) + xi[p, 1] * (u[j, 1] - u[i, 1])
                total += k * stretch
            theta[i] = two / m[i] * total

    return dilatation


def _force(loops):
    """L u at every node."""
    dtype, pattern, prange, lam, mu, two, sixteen = loops.constants

    @loops.jit
    def force(row, neighbour, bond_class, xi, kw, m, u, theta, out):
        for i in prange(len(m)):
            a, b = dtype(0), dtype(0)
            bulk, shear = -two * (lam - mu) / m[i], -sixteen * mu / m[i]
            for e in range(row[i], row[i + 1]):
                p = e - row[i] if pattern else e
                k = kw[bond_class[p]] if pattern else kw[p]
                j = neighbour[e]
                x, y = xi[p, 0], xi[p, 1]
                stretch = (x * (u[j, 0] - u[i, 0]) + y * (u[j, 1] - u[i, 1])) / (x * x + y * y)
                density = k * (bulk * (theta[i] + theta[j]) + shear * stretch)
                a += density * x
                b += density * y
            out[i, 0] = a
            out[i, 1] = b

    return force


def _theta_adjoint(loops):
    """What the force makes of θ, gathered."""
    dtype, pattern, prange, lam, mu, two, _ = loops.constants

    @loops.jit
    def theta_adjoint(row, neighbour, bond_class, reverse, xi, kw, m, h, tau):
        for i in prange(len(m)):
            total = dtype(0)
            for e in range(row[i], row[i + 1]):
                p = e - row[i] if pattern else e
                k = kw[bond_class[p]] if pattern else kw[p]
                back = k if pattern else kw[reverse[e]]
                j = neighbour[e]
                total += xi[p, 0] * (k * h[i, 0] - back * h[j, 0])
                total += xi[p, 1] * (k * h[i, 1] - back * h[j, 1])
            tau[i] = -two * two * (lam - mu) / m[i] * total

    return theta_adjoint


def _adjoint(loops):
    """Gradients to u and to K·W of every bond, or of every step where all nodes are alike."""
    dtype, pattern, prange, lam, mu, two, sixteen = loops.constants
    parts = loops.parts

    @loops.jit
    def adjoint(row, neighbour, bond_class, reverse, xi, kw, m, u, theta, h, tau, u_bar, kw_bar):
        size = len(m)
        volume_bars = np.zeros(parts, dtype)
        for part in prange(parts):
            for i in range(size * part // parts, size * (part + 1) // parts):
                a, b = dtype(0), dtype(0)
                shear, bulk = dtype(0), dtype(0)
                for e in range(row[i], row[i + 1]):
                    p = e - row[i] if pattern else e
                    k = kw[bond_class[p]] if pattern else kw[p]
                    back = k if pattern else kw[reverse[e]]
                    j = neighbour[e]
                    x, y = xi[p, 0], xi[p, 1]
                    square = x * x + y * y
                    own = x * h[i, 0] + y * h[i, 1]
                    far = x * h[j, 0] + y * h[j, 1]
                    push = sixteen * mu * (k * own - back * far) / square
                    push -= k * tau[i] + back * tau[j]
                    a += push * x
                    b += push * y
                    stretch = x * (u[j, 0] - u[i, 0]) + y * (u[j, 1] - u[i, 1])
                    by_shear = own * stretch / square
                    by_bulk = own * (theta[i] + theta[j])
                    shear += k * by_shear
                    bulk += k * by_bulk
                    by_k = -sixteen * mu * by_shear - two * (lam - mu) * by_bulk
                    kw_bar[part if pattern else 0, p] += by_k + tau[i] * stretch
                u_bar[i, 0] = a
                u_bar[i, 1] = b
                volume_bar = sixteen * mu * shear / m[i] + two * (lam - mu) * bulk / m[i]
                volume_bar -= tau[i] * theta[i] / two
                if pattern:
                    volume_bars[part] += volume_bar
                else:
                    for e in range(row[i], row[i + 1]):
                        kw_bar[0, e] += volume_bar * (xi[e, 0] * xi[e, 0] + xi[e, 1] * xi[e, 1])
            if pattern:
                for p in range(len(xi)):
                    square = xi[p, 0] * xi[p, 0] + xi[p, 1] * xi[p, 1]
                    kw_bar[part, p] += volume_bars[part] * square

    return adjoint


def _influence(loops):
    """K·W of every class of bonds."""
    dtype, prange, horizon = loops.dtype, loops.prange, loops.horizon

    @loops.jit
    def influence(r, weight, binomial, alpha, D, kw):
        degree = len(D) - 1
        for c in prange(len(r)):
            x = min(r[c] / horizon, dtype(1))
            power, total = dtype(1), dtype(0)
            for k in range(degree + 1):
                total = total * (dtype(1) - x) + D[k] * binomial[k] * power
                power *= x
            kw[c] = weight[c] * r[c] ** -alpha * total

    return influence


def _influence_adjoint(loops):
    """Gradients to D and α, by part."""
    dtype, prange, horizon, parts = loops.dtype, loops.prange, loops.horizon, loops.parts

    @loops.jit
    def influence_adjoint(r, weight, binomial, alpha, D, kw_bar, out):
        degree = len(D) - 1
        size = len(r)
        for part in prange(parts):
            basis = np.empty(degree + 1, dtype)
            for c in range(size * part // parts, size * (part + 1) // parts):
                x = min(r[c] / horizon, dtype(1))
                power = kw_bar[c] * weight[c] * r[c] ** -alpha
                for k in range(degree + 1):
                    basis[k] = binomial[k] * power
                    power *= x
                power, total = dtype(1), dtype(0)
                for k in range(degree, -1, -1):
                    basis[k] *= power
                    power *= dtype(1) - x
                    total += D[k] * basis[k]
                    out[part, k] += basis[k]
                out[part, degree + 1] -= np.log(r[c]) * total

    return influence_adjoint
