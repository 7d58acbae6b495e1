"""Other ways of computing the LPS force, for the benchmark: torch scatter, SciPy CSR, Numba.

All take the tables of a periodic point set and compute (4)–(9) of docs/theory.md. They
are written as a careful user would write them: K once per bond class, no memory allocated twice.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
from scipy.special import comb

from warp_peri.models.influence import bernstein_basis
from warp_peri.operator.bonds import Bonds


@dataclass(frozen=True)
class Tables:
    """One problem: N nodes, E bonds, C bond classes (C = E on scattered points).

    Attributes:
        row [N + 1], neighbour [E], bond_class [E], reverse [E]: the bonds, int32.
        xi: bond vectors, shape [E, 2].
        r, weight: of the classes, shape [C].
        horizon, alpha, D, lam, mu: the model, one influence function.
        u: displacement, shape [N, 2].
        g: the gradient to L u, shape [N, 2].
    """

    row: np.ndarray
    neighbour: np.ndarray
    bond_class: np.ndarray
    reverse: np.ndarray
    xi: np.ndarray
    r: np.ndarray
    weight: np.ndarray
    horizon: float
    alpha: float
    D: np.ndarray
    lam: float
    mu: float
    u: np.ndarray
    g: np.ndarray

    @property
    def basis(self) -> np.ndarray:
        """Bernstein polynomials of the classes, shape [C, M + 1]."""
        return bernstein_basis(self.r, self.horizon, len(self.D) - 1)

    def kw(self) -> np.ndarray:
        """K W of the classes, shape [C]."""
        return self.weight * self.r**-self.alpha * (self.basis @ self.D)


def tables(
    bonds: Bonds, x: np.ndarray, box: np.ndarray, u: np.ndarray, g: np.ndarray, **model
) -> Tables:
    """The tables of a periodic point set, bond by bond."""
    families = bonds.families
    row, neighbour = families.row, families.neighbour
    if families.lattice is None:
        at = np.repeat(np.arange(len(x)), np.diff(row))
        xi = x[neighbour] - x[at]
        xi -= np.round(xi / box) * box
        bond_class, reverse = np.arange(len(neighbour), dtype=np.int32), families.reverse
    else:
        xi = np.tile(families.pattern, (len(x), 1))
        bond_class = np.tile(families.lattice.bond_class, len(x)).astype(np.int32)
        reverse = (row[neighbour].reshape(len(x), -1) + families.reverse).astype(np.int32).ravel()
    return Tables(
        row=row,
        neighbour=neighbour,
        bond_class=bond_class,
        reverse=reverse,
        xi=np.ascontiguousarray(xi),
        r=families.r,
        weight=families.weight,
        horizon=bonds.horizon,
        u=u,
        g=g,
        **model,
    )


def torch_scatter(t: Tables, dtype: torch.dtype) -> tuple[Callable, Callable]:
    """Forward, and forward and backward to (u, D, α), by gather and index_add in torch."""

    def number(values):
        return torch.as_tensor(values, dtype=dtype)

    size = len(t.u)
    at = torch.from_numpy(np.repeat(np.arange(size), np.diff(t.row)))
    to, c = torch.from_numpy(t.neighbour.astype(np.int64)), torch.from_numpy(t.bond_class)
    c = c.to(torch.int64)
    xi, r, weight, basis = map(number, (t.xi, t.r, t.weight, t.basis))
    square = (xi * xi).sum(dim=1)
    direction = xi / square[:, None]
    zero, zeros = torch.zeros(size, dtype=dtype), torch.zeros(size, 2, dtype=dtype)
    g = number(t.g)

    def force(u, D, alpha):
        kw = (weight * r**-alpha * (basis @ D))[c]
        m = zero.index_add(0, at, kw * square)
        stretch = (xi * (u[to] - u[at])).sum(dim=1)
        theta = 2 / m * zero.index_add(0, at, kw * stretch)
        bulk = zeros.index_add(0, at, (kw * (theta[at] + theta[to]))[:, None] * xi)
        shear = zeros.index_add(0, at, (kw * stretch)[:, None] * direction)
        return -(2 * (t.lam - t.mu) * bulk + 16 * t.mu * shear) / m[:, None]

    start = [number(value) for value in (t.u, t.D, t.alpha)]

    def forward():
        with torch.no_grad():
            return force(*start).numpy()

    def both():
        leaves = [value.detach().requires_grad_() for value in start]
        return [found.numpy() for found in torch.autograd.grad(force(*leaves), leaves, g)]

    return forward, both


def scipy_csr(t: Tables) -> Callable:
    """Forward as three products with matrices built beforehand, for one fixed K."""
    size = len(t.u)
    kw = t.kw()[t.bond_class]
    at = np.repeat(np.arange(size), np.diff(t.row))
    square = (t.xi**2).sum(axis=1)
    m = np.bincount(at, kw * square)
    links = (t.neighbour, t.row)
    a = 2 / m[at] * kw
    phi = [sp.csr_array((a * t.xi[:, n], *links), shape=(size, size)) for n in range(2)]
    own = [sp.diags_array(np.asarray(one.sum(axis=1)).ravel()) for one in phi]
    Phi = sp.hstack([one - diagonal for one, diagonal in zip(phi, own)], format="csr")
    Psi = sp.vstack([one + diagonal for one, diagonal in zip(phi, own)], format="csr")
    rows = []
    for p in range(2):
        blocks = []
        for q in range(2):
            value = -16 / m[at] * kw * t.xi[:, p] * t.xi[:, q] / square
            one = sp.csr_array((value, *links), shape=(size, size))
            blocks.append(one - sp.diags_array(np.asarray(one.sum(axis=1)).ravel()))
        rows.append(sp.hstack(blocks))
    Gamma = sp.vstack(rows, format="csr")
    u = np.ascontiguousarray(t.u.T).ravel()

    def forward():
        Lu = t.mu * (Gamma @ u) - (t.lam - t.mu) * (Psi @ (Phi @ u))
        return Lu.reshape(2, size).T

    return forward


def numba_parallel(t: Tables, dtype: Any, *, fastmath: bool) -> tuple[Callable, Callable]:
    """Forward, and forward and hand-written adjoint to (u, D, α), in parallel Numba loops."""
    import numba

    jit = numba.njit(parallel=True, fastmath=fastmath)
    prange = numba.prange
    lam, mu = dtype(t.lam), dtype(t.mu)
    two, sixteen, horizon = dtype(2), dtype(16), dtype(t.horizon)
    parts = 2 * numba.get_num_threads()

    @jit
    def volume(row, bond_class, r, kw, m):
        for i in prange(volumes):
            total = dtype(0)
            for e in range(row[i], row[i + 1]):
                c = bond_class[e - row[i]] if pattern else e
                total += kw[c] * r[c] * r[c]
            m[i] = total
        if pattern:
            m[1:] = m[0]

    @jit
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

    @jit
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

    @jit
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

    @jit
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

    @jit
    def influence(r, weight, binomial, alpha, D, kw):
        degree = len(D) - 1
        for c in prange(len(r)):
            x = min(r[c] / horizon, dtype(1))
            power, total = dtype(1), dtype(0)
            for k in range(degree + 1):
                total = total * (dtype(1) - x) + D[k] * binomial[k] * power
                power *= x
            kw[c] = weight[c] * r[c] ** -alpha * total

    @jit
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

    size, degree = len(t.u), len(t.D) - 1
    bonds = t.row[1] - t.row[0]
    pattern = len(t.r) < len(t.neighbour)
    xi = np.ascontiguousarray(t.xi[:bonds] if pattern else t.xi, dtype)
    bond_class = t.bond_class[:bonds] if pattern else t.bond_class
    volumes = 1 if pattern else size
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
