"""The gradient of the force by gathering: each node collects what its own bonds send back.

g is the gradient to L u, zero off the interior; h = g/m and hd = g/md. The bond from j back to i
has the vector −ξ and, on a lattice, the same class; on scattered points it is bond reverse[e].
No two nodes write to one place, so slices of the nodes may run at once. Equations (43–47).
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.bonds import add_to, bonds


@cache
def adjoints(scalar):
    """The kernels in one precision."""
    of = bonds(scalar)
    vec, bond_type, box_type = of.vec, of.bond, of.box
    bond_class_of, bond_of = of.bond_class_of, of.bond_of
    volume_of, int_at, scalar_at = of.volume_of, of.int_at, of.scalar_at
    add_at = add_to(scalar)
    scalars_at, vecs_at = of.scalars_at, of.vecs_at

    @wp.func
    def reverse_class(
        lattice: wp.int32, reverse: wp.array(dtype=wp.int32), e: wp.int32, c: wp.int32
    ):
        if lattice == 1:
            return c
        return int_at(reverse, e)

    @wp.kernel(enable_backward=False)
    def scaled(
        first: wp.int32,
        rows: wp.array(dtype=wp.int32),
        lattice: wp.int32,
        m: wp.array(dtype=scalar),
        g: wp.array2d(dtype=vec),
        h: wp.array2d(dtype=vec),
    ):
        """h = g/m on all nodes."""
        s, t = wp.tid()
        i = rows[first + t]
        h[s, i] = g[s, first + t] / m[volume_of(lattice, i)]

    @wp.kernel(enable_backward=False)
    def dilatation_adjoint(
        first: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        lattice: wp.int32,
        row: wp.array(dtype=wp.int32),
        neighbour: wp.array(dtype=wp.int32),
        bond_class: wp.array(dtype=wp.int32),
        pattern: wp.array(dtype=bond_type),
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
            j = int_at(neighbour, e)
            p = e - lattice * row[i]
            bond = bond_of(lattice, pattern, p, x, i, j, box)
            xi = vec(bond[0], bond[1])
            c = bond_class_of(lattice, bond_class, p)
            back = reverse_class(lattice, reverse, e, c)
            total += wp.dot(xi, scalar_at(kd, c) * own - scalar_at(kd, back) * vecs_at(hd, s, j))
        tau[s, i] = scalar(-4.0) * (lam[0] - mu[0]) / md[volume_of(lattice, i)] * total

    @wp.kernel(enable_backward=False)
    def displacement_adjoint(
        first: wp.int32,
        lattice: wp.int32,
        row: wp.array(dtype=wp.int32),
        neighbour: wp.array(dtype=wp.int32),
        bond_class: wp.array(dtype=wp.int32),
        pattern: wp.array(dtype=bond_type),
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
        own_tau = tau[s, i]
        factor = scalar(16.0) * mu[0]
        total = vec()
        for e in range(row[i], row[i + 1]):
            j = int_at(neighbour, e)
            if j >= 0:
                p = e - lattice * row[i]
                bond = bond_of(lattice, pattern, p, x, i, j, box)
                xi = vec(bond[0], bond[1])
                c = bond_class_of(lattice, bond_class, p)
                back = reverse_class(lattice, reverse, e, c)
                stretch = (
                    wp.dot(xi, scalar_at(kw, c) * own - scalar_at(kw, back) * vecs_at(h, s, j))
                    * bond[2]
                )
                total += (
                    factor * stretch
                    - scalar_at(kd, c) * own_tau
                    - scalar_at(kd, back) * scalars_at(tau, s, j)
                ) * xi
        u_bar[s, i] = total

    @wp.kernel(enable_backward=False)
    def table_adjoint(
        block: wp.int32,
        base: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        begin: wp.int32,
        end: wp.int32,
        lattice: wp.int32,
        row: wp.array(dtype=wp.int32),
        neighbour: wp.array(dtype=wp.int32),
        bond_class: wp.array(dtype=wp.int32),
        pattern: wp.array(dtype=bond_type),
        x: wp.array(dtype=vec),
        box: box_type,
        r: wp.array(dtype=scalar),
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
        kw_bar. parts[block] takes what ∂/∂λ and ∂/∂μ are made of, (47).
        """
        factor = scalar(-16.0) * mu[0]
        dilatational = scalar(-2.0) * (lam[0] - mu[0])
        shears = scalar(0.0)
        bulks = scalar(0.0)
        volumes = scalar(0.0)
        volumes_d = scalar(0.0)
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
                    j = int_at(neighbour, e)
                    p = e - lattice * row[i]
                    bond = bond_of(lattice, pattern, p, x, i, j, box)
                    xi = vec(bond[0], bond[1])
                    c = bond_class_of(lattice, bond_class, p)
                    stretch = wp.dot(xi, vecs_at(u, s, j) - ui)
                    by_shear = wp.dot(xi, hi) * stretch * bond[2]
                    by_bulk = wp.dot(xi, hdi) * (theta_i + scalars_at(theta, s, j))
                    shear += scalar_at(kw, c) * by_shear
                    bulk += scalar_at(kd, c) * by_bulk
                    by_w = factor * by_shear
                    by_d = dilatational * by_bulk + tau_i * stretch
                    if one_table == 1:
                        add_at(kw_bar, p - base, by_w + by_d)
                    else:
                        add_at(kw_bar, p - base, by_w)
                        add_at(kd_bar, p - base, by_d)
                volume += tau_i * theta_i
            shears += shear
            bulks += bulk
            m_bar = -factor * shear / m[volume_of(lattice, i)]
            md_bar = -dilatational * bulk / md[volume_of(lattice, i)] - volume / scalar(2.0)
            if one_table == 1:
                m_bar += md_bar
            if lattice == 1:  # one volume for all: its bonds are done once, below
                volumes += m_bar
                volumes_d += md_bar
            else:
                for e in range(row[i], row[i + 1]):
                    square = scalar_at(r, e) * scalar_at(r, e)
                    add_at(kw_bar, e - base, m_bar * square)
                    if one_table == 0:
                        add_at(kd_bar, e - base, md_bar * square)
        parts[block, 0] = shears
        parts[block, 1] = bulks
        if lattice == 1:
            for p in range(pattern.shape[0]):
                square = scalar(1.0) / pattern[p][2]
                add_at(kw_bar, p, volumes * square)
                if one_table == 0:
                    add_at(kd_bar, p, volumes_d * square)

    return SimpleNamespace(
        scaled=scaled,
        dilatation_adjoint=dilatation_adjoint,
        displacement_adjoint=displacement_adjoint,
        table_adjoint=table_adjoint,
    )
