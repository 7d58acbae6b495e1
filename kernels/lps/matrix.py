"""Bond entries of the matrices Γ, Φ and Ψ (theory.md, 11–13, 41)."""

import warp as wp

from warp_peri.kernels.bonds import bonds

_of = bonds(wp.float64)
BondArrays, vec = _of.BondArrays, _of.vec
bond_class_of, bond_of = _of.bond_class_of, _of.bond_of
volume_of = _of.volume_of


@wp.kernel(enable_backward=False)
def bond_entries(
    nodes: wp.array(dtype=wp.int32),
    bonds: BondArrays,
    kw: wp.array(dtype=wp.float64),
    m: wp.array(dtype=wp.float64),
    kd: wp.array(dtype=wp.float64),
    md: wp.array(dtype=wp.float64),
    gamma: wp.array(dtype=wp.mat22d),
    psi: wp.array(dtype=wp.vec2d),
):
    """(16/m_i) K (ξ⊗ξ/r²) W and, with the dilatation's K and m, (2/m_i) K ξ W of each bond."""
    i = nodes[wp.tid()]
    v = volume_of(bonds, i)
    begin = bonds.row[i]
    skip = bonds.lattice * begin
    for e in range(begin, bonds.row[i + 1]):
        j = bonds.neighbour[e]
        if j >= 0:
            p = e - skip
            bond = bond_of(bonds, p, i, j)
            xi = vec(bond[0], bond[1])
            c = bond_class_of(bonds, p)
            stiffness = wp.float64(16.0) * kw[c] / m[v] * bond[2]
            gamma[e] = stiffness * wp.outer(xi, xi)
            psi[e] = wp.float64(2.0) * kd[c] / md[v] * xi


@wp.kernel(enable_backward=False)
def surface_entries(
    nodes: wp.array(dtype=wp.int32),
    bonds: BondArrays,
    kd: wp.array(dtype=wp.float64),
    shape: wp.array(dtype=wp.mat22d),
    phi: wp.array(dtype=wp.vec2d),
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
            xi = vec(bond[0], bond[1])
            phi[e] = kd[bond_class_of(bonds, p)] * (correction * xi)
