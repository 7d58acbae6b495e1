"""Class-wise sweeps of given fields, the features of the reduced regression (theory.md, 14–16)."""

import warp as wp


@wp.kernel
def class_dilatation(
    nodes: wp.array(dtype=wp.int32),
    row: wp.array(dtype=wp.int32),
    neighbour: wp.array(dtype=wp.int32),
    bond: wp.array(dtype=wp.int32),
    bond_class: wp.array(dtype=wp.int32),
    xi: wp.array(dtype=wp.vec2d),
    u: wp.array2d(dtype=wp.vec2d),
    theta: wp.array3d(dtype=wp.float64),
):
    """θ_c,i = 2 Σ_{j in class c} ξ·(u_j − u_i): the dilatation of unit class weights, (14)."""
    s, t = wp.tid()
    i = nodes[t]
    for e in range(row[i], row[i + 1]):
        p = bond[e]
        c = bond_class[p]
        part = wp.float64(2.0) * wp.dot(xi[p], u[s, neighbour[e]] - u[s, i])
        theta[s, i, c] = theta[s, i, c] + part


@wp.kernel
def class_force(
    nodes: wp.array(dtype=wp.int32),
    row: wp.array(dtype=wp.int32),
    neighbour: wp.array(dtype=wp.int32),
    bond: wp.array(dtype=wp.int32),
    bond_class: wp.array(dtype=wp.int32),
    xi: wp.array(dtype=wp.vec2d),
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
    for e in range(row[i], row[i + 1]):
        p = bond[e]
        c = bond_class[p]
        j = neighbour[e]
        stretch = wp.dot(xi[p], u[s, j] - u[s, i]) / wp.dot(xi[p], xi[p])
        features[s, t, c] = features[s, t, c] - wp.float64(16.0) * stretch * xi[p]
        for d in range(theta.shape[2]):
            f = column[c, d]
            both = theta[s, i, d] + theta[s, j, d]
            features[s, t, f] = features[s, t, f] - wp.float64(2.0) * both * xi[p]
