"""The linear peridynamic solid, top to bottom: influence → weighted volume → dilatation → force.

Equation numbers are those of docs/theory.md. The deviatoric part reads the table kw and its
weighted volume m, the dilatation kd and md; with one influence function they are the same arrays.
Bond e of
node i runs from row[i] to row[i + 1]; bond[e] is its number in the family pattern, which gives its
vector ξ and its class.

Warp's adjoint loses derivatives to factors applied to a sum after a dynamic loop, so factors are
hoisted into the loop.
"""

import warp as wp


@wp.kernel
def influence(
    r: wp.array(dtype=wp.float64),
    weight: wp.array(dtype=wp.float64),
    bernstein: wp.array2d(dtype=wp.float64),
    alpha: wp.array(dtype=wp.float64),
    D: wp.array(dtype=wp.float64),
    kw: wp.array(dtype=wp.float64),
):
    """K(r) W of each bond class, (4): K = r^(−α) Σ_k D_k B_k,M(r/δ)."""
    c = wp.tid()
    scale = weight[c] * wp.pow(r[c], -alpha[0])
    total = wp.float64(0.0)
    for k in range(D.shape[0]):
        total += scale * D[k] * bernstein[c, k]
    kw[c] = total


@wp.kernel
def weighted_volume(
    nodes: wp.array(dtype=wp.int32),
    row: wp.array(dtype=wp.int32),
    bond: wp.array(dtype=wp.int32),
    bond_class: wp.array(dtype=wp.int32),
    r: wp.array(dtype=wp.float64),
    kw: wp.array(dtype=wp.float64),
    m: wp.array(dtype=wp.float64),
):
    """m_i = Σ_j K r² W, (5)."""
    i = nodes[wp.tid()]
    total = wp.float64(0.0)
    for e in range(row[i], row[i + 1]):
        c = bond_class[bond[e]]
        total += kw[c] * r[c] * r[c]
    m[i] = total


@wp.kernel
def dilatation(
    nodes: wp.array(dtype=wp.int32),
    row: wp.array(dtype=wp.int32),
    neighbour: wp.array(dtype=wp.int32),
    bond: wp.array(dtype=wp.int32),
    bond_class: wp.array(dtype=wp.int32),
    xi: wp.array(dtype=wp.vec2d),
    kd: wp.array(dtype=wp.float64),
    md: wp.array(dtype=wp.float64),
    u: wp.array2d(dtype=wp.vec2d),
    theta: wp.array2d(dtype=wp.float64),
):
    """θ_i = (2/m_i) Σ_j K ξ·(u_j − u_i) W, (6)."""
    s, t = wp.tid()
    i = nodes[t]
    factor = wp.float64(2.0) / md[i]
    total = wp.float64(0.0)
    for e in range(row[i], row[i + 1]):
        p = bond[e]
        total += factor * kd[bond_class[p]] * wp.dot(xi[p], u[s, neighbour[e]] - u[s, i])
    theta[s, i] = total


@wp.kernel
def force(
    nodes: wp.array(dtype=wp.int32),
    row: wp.array(dtype=wp.int32),
    neighbour: wp.array(dtype=wp.int32),
    bond: wp.array(dtype=wp.int32),
    bond_class: wp.array(dtype=wp.int32),
    xi: wp.array(dtype=wp.vec2d),
    kw: wp.array(dtype=wp.float64),
    m: wp.array(dtype=wp.float64),
    kd: wp.array(dtype=wp.float64),
    md: wp.array(dtype=wp.float64),
    lam: wp.array(dtype=wp.float64),
    mu: wp.array(dtype=wp.float64),
    u: wp.array2d(dtype=wp.vec2d),
    theta: wp.array2d(dtype=wp.float64),
    Lu: wp.array2d(dtype=wp.vec2d),
):
    """(L u)_i = −(2/m)(λ−μ) Σ K ξ (θ_i+θ_j) W − (16 μ/m) Σ K (ξ⊗ξ/r²)(u_j−u_i) W, (9)."""
    s, t = wp.tid()
    i = nodes[t]
    dilatational = wp.float64(-2.0) * (lam[0] - mu[0]) / md[i]
    deviatoric = wp.float64(-16.0) * mu[0] / m[i]
    total = wp.vec2d(wp.float64(0.0), wp.float64(0.0))
    for e in range(row[i], row[i + 1]):
        p = bond[e]
        j = neighbour[e]
        stretch = wp.dot(xi[p], u[s, j] - u[s, i]) / wp.dot(xi[p], xi[p])
        c = bond_class[p]
        density = kd[c] * dilatational * (theta[s, i] + theta[s, j]) + kw[c] * deviatoric * stretch
        total += density * xi[p]
    Lu[s, t] = total
