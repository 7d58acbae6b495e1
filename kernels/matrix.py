"""Bond entries of the matrices Γ and Φ (theory.md, 11–13)."""

import warp as wp


@wp.kernel
def bond_entries(
    nodes: wp.array(dtype=wp.int32),
    row: wp.array(dtype=wp.int32),
    bond: wp.array(dtype=wp.int32),
    bond_class: wp.array(dtype=wp.int32),
    xi: wp.array(dtype=wp.vec2d),
    kw: wp.array(dtype=wp.float64),
    m: wp.array(dtype=wp.float64),
    kd: wp.array(dtype=wp.float64),
    md: wp.array(dtype=wp.float64),
    gamma: wp.array(dtype=wp.mat22d),
    phi: wp.array(dtype=wp.vec2d),
):
    """(16/m_i) K (ξ⊗ξ/r²) W and, with the dilatation's K and m, (2/m_i) K ξ W of each bond."""
    i = nodes[wp.tid()]
    for e in range(row[i], row[i + 1]):
        p = bond[e]
        c = bond_class[p]
        stiffness = wp.float64(16.0) * kw[c] / m[i] / wp.dot(xi[p], xi[p])
        gamma[e] = stiffness * wp.outer(xi[p], xi[p])
        phi[e] = wp.float64(2.0) * kd[c] / md[i] * xi[p]
