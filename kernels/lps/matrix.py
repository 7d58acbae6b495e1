"""Bond entries of the matrices Γ, Φ and Ψ (theory.md, 11–13, 41)."""

import warp as wp

from warp_peri.kernels.bonds import bonds

_of = bonds(wp.float64)
bond_class_of, bond_of, box_type = _of.bond_class_of, _of.bond_of, _of.box
vec, bond_type = _of.vec, _of.bond
volume_of = _of.volume_of


@wp.kernel(enable_backward=False)
def bond_entries(
    nodes: wp.array(dtype=wp.int32),
    lattice: wp.int32,
    row: wp.array(dtype=wp.int32),
    neighbour: wp.array(dtype=wp.int32),
    bond_class: wp.array(dtype=wp.int32),
    pattern: wp.array(dtype=bond_type),
    x: wp.array(dtype=wp.vec2d),
    box: box_type,
    kw: wp.array(dtype=wp.float64),
    m: wp.array(dtype=wp.float64),
    kd: wp.array(dtype=wp.float64),
    md: wp.array(dtype=wp.float64),
    gamma: wp.array(dtype=wp.mat22d),
    psi: wp.array(dtype=wp.vec2d),
):
    """(16/m_i) K (ξ⊗ξ/r²) W and, with the dilatation's K and m, (2/m_i) K ξ W of each bond."""
    i = nodes[wp.tid()]
    v = volume_of(lattice, i)
    for e in range(row[i], row[i + 1]):
        j = neighbour[e]
        if j >= 0:
            p = e - lattice * row[i]
            bond = bond_of(lattice, pattern, p, x, i, j, box)
            xi = vec(bond[0], bond[1])
            c = bond_class_of(lattice, bond_class, p)
            stiffness = wp.float64(16.0) * kw[c] / m[v] * bond[2]
            gamma[e] = stiffness * wp.outer(xi, xi)
            psi[e] = wp.float64(2.0) * kd[c] / md[v] * xi


@wp.kernel(enable_backward=False)
def surface_entries(
    nodes: wp.array(dtype=wp.int32),
    lattice: wp.int32,
    row: wp.array(dtype=wp.int32),
    neighbour: wp.array(dtype=wp.int32),
    bond_class: wp.array(dtype=wp.int32),
    pattern: wp.array(dtype=bond_type),
    x: wp.array(dtype=wp.vec2d),
    box: box_type,
    kd: wp.array(dtype=wp.float64),
    shape: wp.array(dtype=wp.mat22d),
    phi: wp.array(dtype=wp.vec2d),
):
    """K S_i⁻¹ ξ W of each unbroken bond of a node on a surface."""
    i = nodes[wp.tid()]
    correction = wp.inverse(shape[i])
    for e in range(row[i], row[i + 1]):
        j = neighbour[e]
        if j >= 0:
            p = e - lattice * row[i]
            bond = bond_of(lattice, pattern, p, x, i, j, box)
            xi = vec(bond[0], bond[1])
            phi[e] = kd[bond_class_of(lattice, bond_class, p)] * (correction * xi)
