"""(L φ)_i = −Σ_j v_ij κ_ij (φ_j − φ_i) over the bonds of listed nodes, and its adjoint (Di1)."""

import warp as wp


@wp.kernel(enable_backward=False)
def flux(
    first: wp.int32,
    nodes: wp.array(dtype=wp.int32),
    row: wp.array(dtype=wp.int32),
    neighbour: wp.array(dtype=wp.int32),
    v: wp.array(dtype=wp.float64),
    kappa: wp.array(dtype=wp.float64),
    phi: wp.array(dtype=wp.float64),
    out: wp.array(dtype=wp.float64),
):
    """L φ of the listed nodes; bonds are numbered by the list, row[t] … row[t + 1]."""
    t = first + wp.tid()
    i = nodes[t]
    own = phi[i]
    total = wp.float64(0.0)
    for e in range(row[t], row[t + 1]):
        total -= v[e] * kappa[e] * (phi[neighbour[e]] - own)
    out[t] = total


@wp.kernel(enable_backward=False)
def flux_adjoint(
    first: wp.int32,
    nodes: wp.array(dtype=wp.int32),
    row: wp.array(dtype=wp.int32),
    neighbour: wp.array(dtype=wp.int32),
    v: wp.array(dtype=wp.float64),
    kappa: wp.array(dtype=wp.float64),
    phi: wp.array(dtype=wp.float64),
    seed: wp.array(dtype=wp.float64),
    own_phi: wp.array(dtype=wp.float64),
    far_phi: wp.array(dtype=wp.float64),
    by_kappa: wp.array(dtype=wp.float64),
    by_v: wp.array(dtype=wp.float64),
):
    """Derivatives to φ at the node and at the far end of each bond, and to κ and v of each bond."""
    t = first + wp.tid()
    s = seed[t]
    own = phi[nodes[t]]
    total = wp.float64(0.0)
    for e in range(row[t], row[t + 1]):
        step = phi[neighbour[e]] - own
        total += v[e] * kappa[e] * s
        far_phi[e] = -v[e] * kappa[e] * s
        by_kappa[e] = -v[e] * step * s
        by_v[e] = -kappa[e] * step * s
    own_phi[t] = total
