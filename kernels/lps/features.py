"""Class-wise sweeps of given fields, the features of the reduced regression (theory, 14–16)."""

import warp as wp

from warp_peri.kernels.bonds import bonds

_of = bonds(wp.float64, 2)
BondArrays, vec = _of.BondArrays, _of.vec
bond_class_of, bond_of = _of.bond_class_of, _of.bond_of


@wp.kernel
def class_dilatation(
    nodes: wp.array(dtype=wp.int32),
    bonds: BondArrays,
    u: wp.array2d(dtype=wp.vec2d),
    theta: wp.array3d(dtype=wp.float64),
):
    """θ_c,i = 2 Σ_{j in class c} ξ·(u_j − u_i): the dilatation of unit class weights, (14)."""
    s, t = wp.tid()
    i = nodes[t]
    begin = bonds.row[i]
    skip = bonds.lattice * begin
    for e in range(begin, bonds.row[i + 1]):
        j = bonds.neighbour[e]
        p = e - skip
        c = bond_class_of(bonds, p)
        bond = bond_of(bonds, p, i, j)
        xi = vec(bond[0], bond[1])
        part = wp.float64(2.0) * wp.dot(xi, u[s, j] - u[s, i])
        theta[s, i, c] = theta[s, i, c] + part


@wp.kernel
def class_force(
    nodes: wp.array(dtype=wp.int32),
    bonds: BondArrays,
    column: wp.array2d(dtype=wp.int32),
    u: wp.array2d(dtype=wp.vec2d),
    theta: wp.array3d(dtype=wp.float64),
    features: wp.array3d(dtype=wp.vec2d),
):
    """A_c = −16 Σ_c (ξ⊗ξ/r²)(u_j−u_i) in column c and B_cd = −2 Σ_c ξ (θ_d,i + θ_d,j), (15).

    B_cd and B_dc share column[c, d], which sums them.
    """
    s, t = wp.tid()
    i = nodes[t]
    begin = bonds.row[i]
    skip = bonds.lattice * begin
    for e in range(begin, bonds.row[i + 1]):
        j = bonds.neighbour[e]
        p = e - skip
        c = bond_class_of(bonds, p)
        bond = bond_of(bonds, p, i, j)
        xi = vec(bond[0], bond[1])
        stretch = wp.dot(xi, u[s, j] - u[s, i]) * bond[2]
        features[s, t, c] = features[s, t, c] - wp.float64(16.0) * stretch * xi
        for d in range(theta.shape[2]):
            f = column[c, d]
            both = theta[s, i, d] + theta[s, j, d]
            features[s, t, f] = features[s, t, f] - wp.float64(2.0) * both * xi
