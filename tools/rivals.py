"""Other ways of computing the LPS force, for the benchmark: torch scatter, SciPy CSR, Numba.

All take the tables of a periodic point set and compute (4)–(9) of docs/theory. They
are written as a careful user would write them: K once per bond class, no memory allocated twice.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import torch

from warp_peri.materials.lps import bernstein_basis
from warp_peri.materials.lps_bonds import Bonds


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
        owner = np.repeat(np.arange(len(x)), np.diff(row))
        xi = x[neighbour] - x[owner]
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
    owner = torch.from_numpy(np.repeat(np.arange(size), np.diff(t.row)))
    to, c = torch.from_numpy(t.neighbour.astype(np.int64)), torch.from_numpy(t.bond_class)
    c = c.to(torch.int64)
    xi, r, weight, basis = map(number, (t.xi, t.r, t.weight, t.basis))
    square = (xi * xi).sum(dim=1)
    direction = xi / square[:, None]
    zero, zeros = torch.zeros(size, dtype=dtype), torch.zeros(size, 2, dtype=dtype)
    g = number(t.g)

    def force(u, D, alpha):
        kw = (weight * r**-alpha * (basis @ D))[c]
        m = zero.index_add(0, owner, kw * square)
        stretch = (xi * (u[to] - u[owner])).sum(dim=1)
        theta = 2 / m * zero.index_add(0, owner, kw * stretch)
        bulk = zeros.index_add(0, owner, (kw * (theta[owner] + theta[to]))[:, None] * xi)
        shear = zeros.index_add(0, owner, (kw * stretch)[:, None] * direction)
        return -(2 * (t.lam - t.mu) * bulk + 16 * t.mu * shear) / m[:, None]

    start = [number(value) for value in (t.u, t.D, t.alpha)]

    def forward():
        with torch.no_grad():
            return force(*start).numpy()

    def both():
        leaves = [value.detach().requires_grad_() for value in start]
        return [gradient.numpy() for gradient in torch.autograd.grad(force(*leaves), leaves, g)]

    return forward, both


def scipy_csr(t: Tables) -> Callable:
    """Forward as three products with matrices built beforehand, for one fixed K."""
    size = len(t.u)
    kw = t.kw()[t.bond_class]
    owner = np.repeat(np.arange(size), np.diff(t.row))
    square = (t.xi**2).sum(axis=1)
    m = np.bincount(owner, kw * square)
    links = (t.neighbour, t.row)
    a = 2 / m[owner] * kw
    phi = [sp.csr_array((a * t.xi[:, n], *links), shape=(size, size)) for n in range(2)]
    own = [sp.diags_array(np.asarray(part.sum(axis=1)).ravel()) for part in phi]
    Phi = sp.hstack([part - diagonal for part, diagonal in zip(phi, own)], format="csr")
    Psi = sp.vstack([part + diagonal for part, diagonal in zip(phi, own)], format="csr")
    rows = []
    for p in range(2):
        blocks = []
        for q in range(2):
            value = -16 / m[owner] * kw * t.xi[:, p] * t.xi[:, q] / square
            block = sp.csr_array((value, *links), shape=(size, size))
            blocks.append(block - sp.diags_array(np.asarray(block.sum(axis=1)).ravel()))
        rows.append(sp.hstack(blocks))
    Gamma = sp.vstack(rows, format="csr")
    u = np.ascontiguousarray(t.u.T).ravel()

    def forward():
        Lu = t.mu * (Gamma @ u) - (t.lam - t.mu) * (Psi @ (Phi @ u))
        return Lu.reshape(2, size).T

    return forward
