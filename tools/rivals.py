"""Other ways of computing what the library computes, for the benchmark, as careful users would.

torch scatter, SciPy CSR and LAMMPS's `peri/lps`; Numba's loops are in rivals_numba. All but LAMMPS
take the tables of a periodic point set and compute (4)–(9) of docs/theory: K once per bond class,
no memory allocated twice.
"""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import torch

from warp_peri.atoms.calculators import LammpsError, lammps_class, lammps_words
from warp_peri.materials.lps import bernstein_basis
from warp_peri.materials.lps_force import Bonds
from warp_peri.points.families import HORIZON_TOLERANCE
from warp_peri.points.points import nearest


@dataclass(frozen=True)
class Tables:
    """One problem: N nodes, E bonds, C bond classes (C = E on scattered points).

    Attributes:
        row [N + 1], neighbour [E], bond_class [E]: the bonds, int32.
        reverse: number of the bond back, shape [E] on scattered points.
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
    bonds: Bonds, x: np.ndarray, box: tuple[float, float], u: np.ndarray, g: np.ndarray, **model
) -> Tables:
    """The tables of a periodic point set, bond by bond."""
    families = bonds.families
    row, neighbour = families.row, families.neighbour
    if families.lattice is None:
        xi = nearest(x[neighbour] - x[np.repeat(np.arange(len(x)), np.diff(row))], box)
        bond_class = np.arange(len(neighbour), dtype=np.int32)
    else:
        xi = np.tile(families.pattern, (len(x), 1))
        bond_class = np.tile(families.lattice.bond_class, len(x)).astype(np.int32)
    classes = families.r, families.weight, bonds.horizon
    links = row, neighbour, bond_class, families.reverse
    return Tables(*links, np.ascontiguousarray(xi), *classes, **model, u=u, g=g)


def torch_scatter(t: Tables) -> tuple[Callable, Callable]:
    """Forward, and forward and backward to (u, D, α), by gather and index_add in torch."""
    size, owners = len(t.u), np.repeat(np.arange(len(t.u)), np.diff(t.row))
    owner, to, c = (torch.tensor(n, dtype=torch.int64) for n in (owners, t.neighbour, t.bond_class))
    xi, r, weight, basis = map(torch.tensor, (t.xi, t.r, t.weight, t.basis))
    square = (xi * xi).sum(dim=1)
    direction = xi / square[:, None]
    zero, zeros, g = xi.new_zeros(size), xi.new_zeros(size, 2), torch.tensor(t.g)

    def force(u, D, alpha):
        kw = (weight * r**-alpha * (basis @ D))[c]
        m = zero.index_add(0, owner, kw * square)
        stretch = (xi * (u[to] - u[owner])).sum(dim=1)
        theta = 2 / m * zero.index_add(0, owner, kw * stretch)
        bulk = zeros.index_add(0, owner, (kw * (theta[owner] + theta[to]))[:, None] * xi)
        shear = zeros.index_add(0, owner, (kw * stretch)[:, None] * direction)
        return -(2 * (t.lam - t.mu) * bulk + 16 * t.mu * shear) / m[:, None]

    start = [torch.tensor(value, dtype=xi.dtype) for value in (t.u, t.D, t.alpha)]

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


# LAMMPS

INPUT = """
units si
boundary {faces}
atom_style peri
atom_modify map array sort 0 0
neighbor 0.3 bin
lattice sc 1.0
region box block -0.5 {end} -0.5 {end} -0.5 {end}
create_box 1 box
create_atoms 1 box
pair_style peri/lps
pair_coeff * * {bulk} {shear} {horizon} 1e9 0.25
set group all density 1.0
set group all volume 1.0
fix 1 all nve
run 0
compute damage all damage/atom
compute worst all reduce max c_damage
"""
WHOLE = 1e20
"""A critical stretch that nothing reaches."""
BULK, SHEAR = 1.4, 0.5
"""Moduli asked for; their unit is that of stress, as the spacing is that of length."""
SIZE = 1e-6
"""Of displacements, where what is quadratic in them is lost beside rounding of a spacing."""


class PeriLps:
    """nodes³ atoms of spacing and volume 1, free or periodic. Raises LammpsError without LAMMPS."""

    def __init__(self, nodes: int, horizon: float, *, periodic: bool = False) -> None:
        with lammps_words():
            self._lammps = lammps_class()(cmdargs=["-log", "none", "-screen", "none", "-nocite"])
            settings = {"end": nodes - 0.5, "bulk": BULK, "shear": SHEAR}
            settings["horizon"] = horizon * (1 + HORIZON_TOLERANCE)
            faces = "p p p" if periodic else "f f f"
            self._lammps.commands_string(INPUT.format(faces=faces, **settings))
            self._lammps.numpy.extract_atom("s0")[:] = WHOLE
            self.x = self._gathered("x")

    def _gathered(self, name: str) -> np.ndarray:
        return np.array(self._lammps.gather_atoms(name, 1, 3)).reshape(-1, 3)

    def march(self, steps: int) -> None:
        """So many short steps of motion from where it is."""
        with lammps_words():
            self._lammps.command(f"run {steps} pre no post no")

    def force(self, u: np.ndarray) -> np.ndarray:
        """Of the atoms, shape [N, 3], at a displacement of the same shape."""
        moved = np.ascontiguousarray(self.x + u)
        pointer = moved.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
        with lammps_words():
            self._lammps.scatter_atoms("x", 1, 3, pointer)
            self._lammps.command("run 0")
            return self._gathered("f")

    def close(self) -> None:
        """Free LAMMPS. Raises LammpsError if a bond has broken, for the forces are wrong then."""
        worst = self._lammps.extract_compute("worst", 0, 0)
        self._lammps.close()
        if worst != 0:
            raise LammpsError(f"peri/lps: expected whole bonds, got a damage of {worst:g}")
