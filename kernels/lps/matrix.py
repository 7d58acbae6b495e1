"""Bond entries of the matrices Γ, Φ and Ψ (theory, 11–13, 41)."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.bonds import bonds


@cache
def entries(dimension):
    """The kernels in one dimension, and their types of vectors and matrices."""
    of = bonds(wp.float64, dimension)
    BondArrays, vec, mat, last = of.BondArrays, of.vec, of.mat, of.dimension
    bond_class_of, bond_of, xi_of = of.bond_class_of, of.bond_of, of.xi_of
    volume_of, c1, c2 = of.volume_of, of.c1, of.c2

    @wp.kernel(enable_backward=False)
    def bond_entries(
        nodes: wp.array(dtype=wp.int32),
        bonds: BondArrays,
        kw: wp.array(dtype=wp.float64),
        m: wp.array(dtype=wp.float64),
        gamma: wp.array(dtype=mat),
        psi: wp.array(dtype=vec),
    ):
        """(c2/m_i) K (ξ⊗ξ/r²) W and (c1/m_i) K ξ W of each bond."""
        i = nodes[wp.tid()]
        v = volume_of(bonds, i)
        begin = bonds.row[i]
        skip = bonds.lattice * begin
        for e in range(begin, bonds.row[i + 1]):
            j = bonds.neighbour[e]
            if j >= 0:
                p = e - skip
                bond = bond_of(bonds, p, i, j)
                xi = xi_of(bond)
                c = bond_class_of(bonds, p)
                stiffness = c2 * kw[c] / m[v] * bond[last]
                gamma[e] = stiffness * wp.outer(xi, xi)
                psi[e] = c1 * kw[c] / m[v] * xi

    @wp.kernel(enable_backward=False)
    def surface_entries(
        nodes: wp.array(dtype=wp.int32),
        bonds: BondArrays,
        kw: wp.array(dtype=wp.float64),
        shape: wp.array(dtype=mat),
        phi: wp.array(dtype=vec),
    ):
        """K S_i⁻¹ ξ W of each unbroken bond of a node on a surface."""
        i = nodes[wp.tid()]
        correction = wp.inverse(shape[i])
        begin = bonds.row[i]
        skip = bonds.lattice * begin
        for e in range(begin, bonds.row[i + 1]):
            j = bonds.neighbour[e]
            if j >= 0:
                p = e - skip
                bond = bond_of(bonds, p, i, j)
                xi = xi_of(bond)
                phi[e] = kw[bond_class_of(bonds, p)] * (correction * xi)

    return SimpleNamespace(
        bond_entries=bond_entries, surface_entries=surface_entries, vec=vec, mat=mat
    )
