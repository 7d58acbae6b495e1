"""The linear peridynamic solid, top to bottom: weighted volume → dilatation → force.

Equation numbers are those of docs/theory; bonds.py says what a bond is. Kernels read the table kw
of K W by class and its weighted volume m.

Warp's adjoint loses derivatives to factors applied to a sum after a dynamic loop, so factors are
hoisted into the loop.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.bonds import bonds


@cache
def sweeps(scalar, dimension):
    """The kernels in one precision and dimension."""
    of = bonds(scalar, dimension)
    return SimpleNamespace(
        weighted_volume=_weighted_volume(of),
        dilatation=_dilatation(of),
        surface_shape=_surface_shape(of),
        surface_dilatation=_surface_dilatation(of),
        force=_force(of),
    )


def _weighted_volume(of):
    BondArrays, scalar, bond_class_of = of.BondArrays, of.scalar, of.bond_class_of
    volume_of, scalar_at = of.volume_of, of.scalar_at

    @wp.kernel
    def weighted_volume(
        first: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        bonds: BondArrays,
        r: wp.array(dtype=scalar),
        kw: wp.array(dtype=scalar),
        m: wp.array(dtype=scalar),
    ):
        """m_i = Σ_j K r² W over the whole ball, broken bonds included, (5)."""
        i = nodes[first + wp.tid()]
        total = scalar(0.0)
        begin = bonds.row[i]
        skip = bonds.lattice * begin
        for e in range(begin, bonds.row[i + 1]):
            c = bond_class_of(bonds, e - skip)
            total += scalar_at(kw, c) * scalar_at(r, c) * scalar_at(r, c)
        m[volume_of(bonds, i)] = total

    return weighted_volume


def _dilatation(of):
    c1, xi_of = of.c1, of.xi_of
    BondArrays, scalar, vec, bond_of = of.BondArrays, of.scalar, of.vec, of.bond_of
    bond_class_of, volume_of, int_at = of.bond_class_of, of.volume_of, of.int_at
    scalar_at, vecs_at = of.scalar_at, of.vecs_at

    @wp.kernel
    def dilatation(
        first: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        bonds: BondArrays,
        kw: wp.array(dtype=scalar),
        m: wp.array(dtype=scalar),
        u: wp.array2d(dtype=vec),
        theta: wp.array2d(dtype=scalar),
    ):
        """θ_i = (d/m_i) Σ_j K ξ·(u_j − u_i) W, (6), where no bond is broken."""
        s, t = wp.tid()
        i = nodes[first + t]
        factor = c1 / m[volume_of(bonds, i)]
        total = scalar(0.0)
        begin = bonds.row[i]
        skip = bonds.lattice * begin
        for e in range(begin, bonds.row[i + 1]):
            j = int_at(bonds.neighbour, e)
            p = e - skip
            bond = bond_of(bonds, p, i, j)
            xi = xi_of(bond)
            k = scalar_at(kw, bond_class_of(bonds, p))
            total += factor * k * wp.dot(xi, vecs_at(u, s, j) - u[s, i])
        theta[s, i] = total

    return dilatation


def _surface_shape(of):
    xi_of = of.xi_of
    BondArrays, scalar, mat, bond_of = of.BondArrays, of.scalar, of.mat, of.bond_of
    bond_class_of, int_at, scalar_at = of.bond_class_of, of.int_at, of.scalar_at

    @wp.kernel
    def surface_shape(
        first: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        bonds: BondArrays,
        kw: wp.array(dtype=scalar),
        shape: wp.array(dtype=mat),
    ):
        """S_i = Σ_j K ξ⊗ξ W over the unbroken bonds, (40)."""
        i = nodes[first + wp.tid()]
        total = mat()
        begin = bonds.row[i]
        skip = bonds.lattice * begin
        for e in range(begin, bonds.row[i + 1]):
            j = int_at(bonds.neighbour, e)
            if j >= 0:
                p = e - skip
                bond = bond_of(bonds, p, i, j)
                xi = xi_of(bond)
                k = scalar_at(kw, bond_class_of(bonds, p))
                total += k * wp.outer(xi, xi)
        shape[i] = total

    return surface_shape


def _surface_dilatation(of):
    xi_of = of.xi_of
    BondArrays, scalar, vec, mat, bond_of = of.BondArrays, of.scalar, of.vec, of.mat, of.bond_of
    bond_class_of, int_at, scalar_at = of.bond_class_of, of.int_at, of.scalar_at
    vecs_at = of.vecs_at

    @wp.kernel
    def surface_dilatation(
        first: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        bonds: BondArrays,
        kw: wp.array(dtype=scalar),
        shape: wp.array(dtype=mat),
        u: wp.array2d(dtype=vec),
        theta: wp.array2d(dtype=scalar),
    ):
        """θ_i = Σ_j K ξ·S_i⁻¹ (u_j − u_i) W over the unbroken bonds, (41)."""
        s, t = wp.tid()
        i = nodes[first + t]
        correction = wp.inverse(shape[i])
        total = scalar(0.0)
        begin = bonds.row[i]
        skip = bonds.lattice * begin
        for e in range(begin, bonds.row[i + 1]):
            j = int_at(bonds.neighbour, e)
            if j >= 0:
                p = e - skip
                bond = bond_of(bonds, p, i, j)
                xi = xi_of(bond)
                k = scalar_at(kw, bond_class_of(bonds, p))
                total += k * wp.dot(xi, correction * (vecs_at(u, s, j) - u[s, i]))
        theta[s, i] = total

    return surface_dilatation


def _force(of):
    c1, c2, xi_of, last = of.c1, of.c2, of.xi_of, of.dimension
    BondArrays, scalar, vec, bond_of = of.BondArrays, of.scalar, of.vec, of.bond_of
    bond_class_of, volume_of, int_at = of.bond_class_of, of.volume_of, of.int_at
    scalar_at, scalars_at, vecs_at = of.scalar_at, of.scalars_at, of.vecs_at

    @wp.kernel
    def force(
        first: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        bonds: BondArrays,
        kw: wp.array(dtype=scalar),
        m: wp.array(dtype=scalar),
        lam: wp.array(dtype=scalar),
        mu: wp.array(dtype=scalar),
        u: wp.array2d(dtype=vec),
        theta: wp.array2d(dtype=scalar),
        Lu: wp.array2d(dtype=vec),
    ):
        """(L u)_i = −(c1/m)(λ−μ) Σ K ξ (θ_i+θ_j) W − (c2 μ/m) Σ K (ξ⊗ξ/r²)(u_j−u_i) W, (9)."""
        s, t = wp.tid()
        i = nodes[first + t]
        dilatational = -c1 * (lam[0] - mu[0]) / m[volume_of(bonds, i)]
        deviatoric = -c2 * mu[0] / m[volume_of(bonds, i)]
        total = vec()
        begin = bonds.row[i]
        skip = bonds.lattice * begin
        for e in range(begin, bonds.row[i + 1]):
            j = int_at(bonds.neighbour, e)
            if j >= 0:
                p = e - skip
                bond = bond_of(bonds, p, i, j)
                xi = xi_of(bond)
                k = scalar_at(kw, bond_class_of(bonds, p))
                stretch = wp.dot(xi, vecs_at(u, s, j) - u[s, i]) * bond[last]
                density = k * dilatational * (theta[s, i] + scalars_at(theta, s, j))
                density += k * deviatoric * stretch
                total += density * xi
        Lu[s, first + t] = total

    return force
