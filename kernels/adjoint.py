"""The gradient of the force by gathering: each node collects what its own bonds send back.

g is the gradient to L u, zero off the interior; h = g/m and hd = g/md. The bond from j back to i
has the vector −ξ and, on a lattice, the same class; on scattered points it is bond reverse[e].
No two nodes write to one place, so slices of the nodes may run at once. Equations (43–47).
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.bonds import bonds


@cache
def adjoints(scalar):
    """The kernels in one precision."""
    of = bonds(scalar)
    vec, box_type = of.vec, of.box
    bond_class_of, bond_vector = of.bond_class_of, of.bond_vector

    @wp.func
    def reverse_class(
        lattice: wp.int32, reverse: wp.array(dtype=wp.int32), e: wp.int32, c: wp.int32
    ):
        if lattice == 1:
            return c
        return reverse[e]

    @wp.kernel(enable_backward=False)
    def scaled(
        first: wp.int32,
        rows: wp.array(dtype=wp.int32),
        m: wp.array(dtype=scalar),
        g: wp.array2d(dtype=vec),
        h: wp.array2d(dtype=vec),
    ):
        """h = g/m on all nodes."""
        s, t = wp.tid()
        i = rows[first + t]
        h[s, i] = g[s, first + t] / m[i]

    @wp.kernel(enable_backward=False)
    def dilatation_adjoint(
        first: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        lattice: wp.int32,
        row: wp.array(dtype=wp.int32),
        neighbour: wp.array(dtype=wp.int32),
        bond_class: wp.array(dtype=wp.int32),
        pattern: wp.array(dtype=vec),
        x: wp.array(dtype=vec),
        box: box_type,
        reverse: wp.array(dtype=wp.int32),
        kd: wp.array(dtype=scalar),
        md: wp.array(dtype=scalar),
        lam: wp.array(dtype=scalar),
        mu: wp.array(dtype=scalar),
        hd: wp.array2d(dtype=vec),
        tau: wp.array2d(dtype=scalar),
    ):
        """τ_i = (2/md_i) ∂/∂θ_i, (43)."""
        s, t = wp.tid()
        i = nodes[first + t]
        own = hd[s, i]
        total = scalar(0.0)
        for e in range(row[i], row[i + 1]):
            j = neighbour[e]
            p = e - lattice * row[i]
            xi = bond_vector(lattice, pattern, p, x, i, j, box)
            c = bond_class_of(lattice, bond_class, p)
            back = reverse_class(lattice, reverse, e, c)
            total += wp.dot(xi, kd[c] * own - kd[back] * hd[s, j])
        tau[s, i] = scalar(-4.0) * (lam[0] - mu[0]) / md[i] * total

    @wp.kernel(enable_backward=False)
    def displacement_adjoint(
        first: wp.int32,
        lattice: wp.int32,
        row: wp.array(dtype=wp.int32),
        neighbour: wp.array(dtype=wp.int32),
        bond_class: wp.array(dtype=wp.int32),
        pattern: wp.array(dtype=vec),
        x: wp.array(dtype=vec),
        box: box_type,
        reverse: wp.array(dtype=wp.int32),
        kw: wp.array(dtype=scalar),
        kd: wp.array(dtype=scalar),
        mu: wp.array(dtype=scalar),
        h: wp.array2d(dtype=vec),
        tau: wp.array2d(dtype=scalar),
        u_bar: wp.array2d(dtype=vec),
    ):
        """∂/∂u of every node, (44)."""
        s, t = wp.tid()
        i = first + t
        own = h[s, i]
        factor = scalar(16.0) * mu[0]
        total = vec()
        for e in range(row[i], row[i + 1]):
            j = neighbour[e]
            if j >= 0:
                p = e - lattice * row[i]
                xi = bond_vector(lattice, pattern, p, x, i, j, box)
                c = bond_class_of(lattice, bond_class, p)
                back = reverse_class(lattice, reverse, e, c)
                stretch = wp.dot(xi, kw[c] * own - kw[back] * h[s, j]) / wp.dot(xi, xi)
                total += (factor * stretch - kd[c] * tau[s, i] - kd[back] * tau[s, j]) * xi
        u_bar[s, i] = total

    @wp.kernel(enable_backward=False)
    def table_adjoint(
        base: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        begin: wp.int32,
        end: wp.int32,
        lattice: wp.int32,
        row: wp.array(dtype=wp.int32),
        neighbour: wp.array(dtype=wp.int32),
        bond_class: wp.array(dtype=wp.int32),
        pattern: wp.array(dtype=vec),
        x: wp.array(dtype=vec),
        box: box_type,
        kw: wp.array(dtype=scalar),
        m: wp.array(dtype=scalar),
        kd: wp.array(dtype=scalar),
        md: wp.array(dtype=scalar),
        lam: wp.array(dtype=scalar),
        mu: wp.array(dtype=scalar),
        u: wp.array2d(dtype=vec),
        theta: wp.array2d(dtype=scalar),
        h: wp.array2d(dtype=vec),
        hd: wp.array2d(dtype=vec),
        tau: wp.array2d(dtype=scalar),
        one_table: wp.int32,
        kw_bar: wp.array(dtype=scalar),
        kd_bar: wp.array(dtype=scalar),
        parts: wp.array2d(dtype=scalar),
    ):
        """∂/∂(K W) of the bonds of nodes begin ≤ t < end, one after another, (45–47).

        kw_bar and kd_bar hold the numbers p − base of the pattern; with one table both sums go to
        kw_bar. parts[i] takes the node's shares of ∂/∂μ and ∂/∂λ at fixed sums, see (47).
        """
        factor = scalar(-16.0) * mu[0]
        dilatational = scalar(-2.0) * (lam[0] - mu[0])
        for t in range(begin, end):
            i = nodes[t]
            shear = scalar(0.0)
            bulk = scalar(0.0)
            volume = scalar(0.0)
            for s in range(u.shape[0]):
                ui = u[s, i]
                hi = h[s, i]
                hdi = hd[s, i]
                theta_i = theta[s, i]
                tau_i = tau[s, i]
                for e in range(row[i], row[i + 1]):
                    j = neighbour[e]
                    p = e - lattice * row[i]
                    xi = bond_vector(lattice, pattern, p, x, i, j, box)
                    c = bond_class_of(lattice, bond_class, p)
                    stretch = wp.dot(xi, u[s, j] - ui)
                    by_shear = wp.dot(xi, hi) * stretch / wp.dot(xi, xi)
                    by_bulk = wp.dot(xi, hdi) * (theta_i + theta[s, j])
                    shear += kw[c] * by_shear
                    bulk += kd[c] * by_bulk
                    by_w = factor * by_shear
                    by_d = dilatational * by_bulk + tau_i * stretch
                    if one_table == 1:
                        kw_bar[p - base] = kw_bar[p - base] + by_w + by_d
                    else:
                        kw_bar[p - base] = kw_bar[p - base] + by_w
                        kd_bar[p - base] = kd_bar[p - base] + by_d
                volume += tau_i * theta_i
            parts[i, 0] = shear
            parts[i, 1] = bulk
            m_bar = -factor * shear / m[i]
            md_bar = -dilatational * bulk / md[i] - volume / scalar(2.0)
            if one_table == 1:
                m_bar += md_bar
            for e in range(row[i], row[i + 1]):
                p = e - lattice * row[i]
                xi = bond_vector(lattice, pattern, p, x, i, neighbour[e], box)
                square = wp.dot(xi, xi)
                kw_bar[p - base] = kw_bar[p - base] + m_bar * square
                if one_table == 0:
                    kd_bar[p - base] = kd_bar[p - base] + md_bar * square

    return SimpleNamespace(
        scaled=scaled,
        dilatation_adjoint=dilatation_adjoint,
        displacement_adjoint=displacement_adjoint,
        table_adjoint=table_adjoint,
    )
