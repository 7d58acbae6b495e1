"""Other ways of computing what the library computes, for the benchmark, as careful users would.

torch scatter, SciPy CSR, Numba loops and LAMMPS's `peri/lps`. All but the last take the tables of a
periodic point set and compute (4)–(9) of docs/theory: K once per bond class, no memory allocated
twice.
"""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
from scipy.special import comb

from warp_peri.atoms.calculators import LammpsError, lammps_class, lammps_words
from warp_peri.materials.lps_force import Bonds
from warp_peri.materials.lps_parameters import bernstein_basis
from warp_peri.points.families import HORIZON_TOLERANCE


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


# Numba


@dataclass(frozen=True)
class Loops:
    """What the loops are compiled with; Numba takes its numbers for constants.

    `pattern`: whether all nodes are alike, so that tables are kept by the step from node to node;
    `volumes`: how many weighted volumes differ.
    """

    jit: Any
    prange: Any
    dtype: Any
    pattern: bool
    volumes: int
    lam: Any
    mu: Any
    horizon: Any


def numba_parallel(t: Tables, dtype: Any, *, fastmath: bool) -> Callable[[], np.ndarray]:
    """Forward in parallel loops."""
    import numba

    size, degree = len(t.u), len(t.D) - 1
    bonds = t.row[1] - t.row[0]
    pattern = len(t.r) < len(t.neighbour)
    loops = Loops(
        numba.njit(parallel=True, fastmath=fastmath), numba.prange, dtype, pattern,
        1 if pattern else size, dtype(t.lam), dtype(t.mu), dtype(t.horizon),
    )  # fmt: skip
    volume, dilatation, force = _volume(loops), _dilatation(loops), _force(loops)
    influence = _influence(loops)
    xi = np.ascontiguousarray(t.xi[:bonds] if pattern else t.xi, dtype)
    bond_class = t.bond_class[:bonds] if pattern else t.bond_class
    r, weight, D, u = (np.asarray(v, dtype) for v in (t.r, t.weight, t.D, t.u))
    alpha, binomial = dtype(t.alpha), comb(degree, np.arange(degree + 1)).astype(dtype)
    kw, m, theta = np.empty(len(r), dtype), np.empty(size, dtype), np.empty(size, dtype)
    out, links = np.empty_like(u), (t.row, t.neighbour, bond_class)

    def forward() -> np.ndarray:
        influence(r, weight, binomial, alpha, D, kw)
        volume(t.row, bond_class, r, kw, m)
        dilatation(*links, xi, kw, m, u, theta)
        force(*links, xi, kw, m, u, theta, out)
        return out

    return forward


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
    dtype, pattern, prange, lam, mu = (
        loops.dtype, loops.pattern, loops.prange, loops.lam, loops.mu,
    )  # fmt: skip
    two, sixteen = dtype(2), dtype(16)

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


def numba_rows(t: Tables, dtype: Any) -> Callable[[], np.ndarray]:
    """Forward on side × side nodes numbered row by row, K of the classes computed every time.

    Its best form: products and sums contracted, images of rows in a loop of their own, K on one
    thread.
    """
    import numba

    side = round(np.sqrt(len(t.u)))
    family = t.row[1] - t.row[0]
    xi = np.ascontiguousarray(t.xi[:family])
    steps = np.rint(xi / np.abs(xi[xi != 0]).min()).astype(np.int64)
    reach = int(np.abs(steps).max())
    degree = len(t.D) - 1
    one = Loops(numba.njit(), range, dtype, True, 1, dtype(t.lam), dtype(t.mu), dtype(t.horizon))
    influence, kw = _influence(one), np.empty(len(t.r), dtype)
    weight, D = t.weight.astype(dtype), t.D.astype(dtype)
    binomial = comb(degree, np.arange(degree + 1)).astype(dtype)
    bond_class, r = t.bond_class[:family], t.r.astype(dtype)
    ring, width = 2 * reach, side + 4 * reach
    bonds = np.column_stack([xi, 1 / (xi**2).sum(axis=1)]).astype(dtype)
    planes = np.zeros((3, width, width), dtype)
    out = np.empty((side, side, 2), dtype)
    u = t.u.reshape(side, side, 2).astype(dtype)
    lam, mu = dtype(t.lam), dtype(t.mu)
    jit = numba.njit(parallel=True, fastmath=True, error_model="numpy")
    made = (of(numba.prange) for of in (_laid_out, _row_dilatation, _row_force))
    laid_out, dilatation, force = map(jit, made)

    def forward() -> np.ndarray:
        influence(r, weight, binomial, dtype(t.alpha), D, kw)
        k = kw[bond_class]
        m = (k * r[bond_class] ** 2).sum()
        laid_out(u, planes, ring)
        dilatation(steps, bonds, 2 / m * k, planes, reach)
        force(steps, bonds, -2 * (lam - mu) / m * k, -16 * mu / m * k, planes, ring, out)
        return out.reshape(-1, 2)

    return forward


def _laid_out(prange: Any) -> Callable[..., None]:
    def laid_out(u, planes, ring):
        side, rows = len(u), planes.shape[1]
        for i in prange(rows):
            own = u[(i - ring) % side]
            for c in range(side):
                planes[0, i, ring + c] = own[c, 0]
                planes[1, i, ring + c] = own[c, 1]
            for a in range(2):
                planes[a, i, :ring] = planes[a, i, side : side + ring]
                planes[a, i, ring + side :] = planes[a, i, ring : 2 * ring]

    return laid_out


def _row_dilatation(prange: Any) -> Callable[..., None]:
    def dilatation(steps, bonds, factor, planes, margin):
        rows = planes.shape[1] - 2 * margin
        for n in prange(rows):
            i = n + margin
            total = np.zeros(rows, planes.dtype)
            x, y = (planes[0, i, margin : margin + rows], planes[1, i, margin : margin + rows])
            for p in range(len(steps)):
                j, shift = i + steps[p, 0], margin + steps[p, 1]
                vx, vy = planes[0, j, shift : shift + rows], planes[1, j, shift : shift + rows]
                a, b, k = bonds[p, 0], bonds[p, 1], factor[p]
                for c in range(rows):
                    total[c] += k * (a * (vx[c] - x[c]) + b * (vy[c] - y[c]))
            planes[2, i, margin : margin + rows] = total

    return dilatation


def _row_force(prange: Any) -> Callable[..., None]:
    def force(steps, bonds, bulk, shear, planes, margin, out):
        side = len(out)
        for n in prange(side):
            i = n + margin
            fx, fy = np.zeros(side, planes.dtype), np.zeros(side, planes.dtype)
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
            out[n, :, 0] = fx
            out[n, :, 1] = fy

    return force


def numba_breaking() -> Callable[..., None]:
    """A state-based body whose bonds break, two nodes at a time: a fifth faster."""
    import numba

    jit = numba.njit(parallel=True, fastmath=True, error_model="numpy")
    whole = numba.uint64

    @jit
    def dilatation(u, xi, a, neighbour, theta):
        for t in numba.prange((len(u) + 1) // 2):
            p = whole(2 * t)
            q = whole(min(2 * t + 1, len(u) - 1))
            px, py, qx, qy = u[p, 0], u[p, 1], u[q, 0], u[q, 1]
            first = second = 0.0
            for b in range(len(a)):
                x, y = xi[b, 0], xi[b, 1]
                j = neighbour[p, b]
                if j >= 0:
                    far = whole(j)
                    first += a[b] * (x * (u[far, 0] - px) + y * (u[far, 1] - py))
                j = neighbour[q, b]
                if j >= 0:
                    far = whole(j)
                    second += a[b] * (x * (u[far, 0] - qx) + y * (u[far, 1] - qy))
            theta[p], theta[q] = first, second

    @jit
    def pull(u, xi, k, limit, no_fail, neighbour, force, energy, lost, a, excess, theta):
        for t in numba.prange((len(u) + 1) // 2):
            p = whole(2 * t)
            q = whole(min(2 * t + 1, len(u) - 1))
            px, py, qx, qy = u[p, 0], u[p, 1], u[q, 0], u[q, 1]
            fx = fy = e = gx = gy = w = 0.0
            lost_p = lost_q = 0
            for b in range(len(limit)):
                x, y, bulk = xi[b, 0], xi[b, 1], excess * a[b]
                j = neighbour[p, b]
                if j >= 0:
                    far = whole(j)
                    d = x * (u[far, 0] - px) + y * (u[far, 1] - py)
                    s = k[b] * d
                    e += 0.25 * s * d
                    s += bulk * (theta[p] + theta[far])
                    fx += s * x
                    fy += s * y
                    if d > limit[b] and no_fail[p] + no_fail[far] == 0:
                        neighbour[p, b] = -1 - j
                        lost_p += 1
                j = neighbour[q, b]
                if j >= 0:
                    far = whole(j)
                    d = x * (u[far, 0] - qx) + y * (u[far, 1] - qy)
                    s = k[b] * d
                    w += 0.25 * s * d
                    s += bulk * (theta[q] + theta[far])
                    gx += s * x
                    gy += s * y
                    if d > limit[b] and no_fail[q] + no_fail[far] == 0:
                        neighbour[q, b] = -1 - j
                        lost_q += 1
            force[p, 0], force[p, 1], lost[p] = fx, fy, lost_p
            energy[p] = e + 0.5 * excess * theta[p] ** 2
            force[q, 0], force[q, 1], lost[q] = gx, gy, lost_q
            energy[q] = w + 0.5 * excess * theta[q] ** 2

    def state_based(u, xi, k, limit, no_fail, neighbour, force, energy, lost, a, excess, theta):
        dilatation(u, xi, a, neighbour, theta)
        pull(u, xi, k, limit, no_fail, neighbour, force, energy, lost, a, excess, theta)

    return state_based


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
