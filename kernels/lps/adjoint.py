"""The gradient of the force by gathering: each node collects what its own bonds send back.

g is the gradient to L u, zero off the interior; h = g/m. The bond from j back to i
has the vector −ξ and, on a lattice, the same class; on scattered points it is bond reverse[e].
No two nodes write to one place, so slices of the nodes may run at once. Equations (43–47).
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.bonds import add_to, bonds


@cache
def adjoints(scalar, dimension):
    """The kernels in one precision and dimension."""
    of = bonds(scalar, dimension)
    int_at = of.int_at
    BondArrays = of.BondArrays

    @wp.func
    def reverse_class(
        bonds: BondArrays, reverse: wp.array(dtype=wp.int32), e: wp.int32, c: wp.int32
    ):
        if bonds.lattice == 1:
            return c
        return int_at(reverse, e)

    types = structs(scalar, dimension)
    return SimpleNamespace(
        scaled=_scaled(of),
        dilatation_adjoint=_dilatation_adjoint(of, reverse_class),
        displacement_adjoint=_displacement_adjoint(of, reverse_class),
        table_adjoint=_table_adjoint(of, types),
        **vars(types),
    )


@cache
def structs(scalar, dimension):
    """What table_adjoint reads: the law as tables and numbers, and the fields it was applied to."""
    vec = bonds(scalar, dimension).vec

    @wp.struct
    class Law:
        kw: wp.array(dtype=scalar)
        m: wp.array(dtype=scalar)
        lam: wp.array(dtype=scalar)
        mu: wp.array(dtype=scalar)

    @wp.struct
    class Fields:
        u: wp.array2d(dtype=vec)
        theta: wp.array2d(dtype=scalar)
        h: wp.array2d(dtype=vec)
        tau: wp.array2d(dtype=scalar)

    return SimpleNamespace(Law=Law, Fields=Fields)


def _scaled(of):
    BondArrays, scalar, vec, volume_of = of.BondArrays, of.scalar, of.vec, of.volume_of

    @wp.kernel(enable_backward=False)
    def scaled(
        first: wp.int32,
        rows: wp.array(dtype=wp.int32),
        bonds: BondArrays,
        m: wp.array(dtype=scalar),
        g: wp.array2d(dtype=vec),
        h: wp.array2d(dtype=vec),
    ):
        """h = g/m on all nodes."""
        s, t = wp.tid()
        i = rows[first + t]
        h[s, i] = g[s, first + t] / m[volume_of(bonds, i)]

    return scaled


def _dilatation_adjoint(of, reverse_class):
    c1, xi_of = of.c1, of.xi_of
    BondArrays, scalar, vec = of.BondArrays, of.scalar, of.vec
    bond_of, bond_class_of, volume_of = of.bond_of, of.bond_class_of, of.volume_of
    int_at, scalar_at, vecs_at = of.int_at, of.scalar_at, of.vecs_at

    @wp.kernel(enable_backward=False)
    def dilatation_adjoint(
        first: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        bonds: BondArrays,
        reverse: wp.array(dtype=wp.int32),
        kw: wp.array(dtype=scalar),
        m: wp.array(dtype=scalar),
        lam: wp.array(dtype=scalar),
        mu: wp.array(dtype=scalar),
        h: wp.array2d(dtype=vec),
        tau: wp.array2d(dtype=scalar),
    ):
        """τ_i = (d/m_i) ∂/∂θ_i, (43)."""
        s, t = wp.tid()
        i = nodes[first + t]
        own = h[s, i]
        total = scalar(0.0)
        begin = bonds.row[i]
        skip = bonds.lattice * begin
        for e in range(begin, bonds.row[i + 1]):
            j = int_at(bonds.neighbour, e)
            p = e - skip
            bond = bond_of(bonds, p, i, j)
            xi = xi_of(bond)
            c = bond_class_of(bonds, p)
            back = reverse_class(bonds, reverse, e, c)
            total += wp.dot(xi, scalar_at(kw, c) * own - scalar_at(kw, back) * vecs_at(h, s, j))
        tau[s, i] = -c1 * c1 * (lam[0] - mu[0]) / m[volume_of(bonds, i)] * total

    return dilatation_adjoint


def _displacement_adjoint(of, reverse_class):
    c2, xi_of, last = of.c2, of.xi_of, of.dimension
    BondArrays, scalar, vec = of.BondArrays, of.scalar, of.vec
    bond_of, bond_class_of, int_at = of.bond_of, of.bond_class_of, of.int_at
    scalar_at, scalars_at, vecs_at = of.scalar_at, of.scalars_at, of.vecs_at

    @wp.kernel(enable_backward=False)
    def displacement_adjoint(
        first: wp.int32,
        bonds: BondArrays,
        reverse: wp.array(dtype=wp.int32),
        kw: wp.array(dtype=scalar),
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
        factor = c2 * mu[0]
        total = vec()
        begin = bonds.row[i]
        skip = bonds.lattice * begin
        for e in range(begin, bonds.row[i + 1]):
            j = int_at(bonds.neighbour, e)
            if j >= 0:
                p = e - skip
                bond = bond_of(bonds, p, i, j)
                xi = xi_of(bond)
                c = bond_class_of(bonds, p)
                back = reverse_class(bonds, reverse, e, c)
                stretch = (
                    wp.dot(xi, scalar_at(kw, c) * own - scalar_at(kw, back) * vecs_at(h, s, j))
                    * bond[last]
                )
                total += (
                    factor * stretch
                    - scalar_at(kw, c) * own_tau
                    - scalar_at(kw, back) * scalars_at(tau, s, j)
                ) * xi
        u_bar[s, i] = total

    return displacement_adjoint


def _by_bond(of, structs):
    """What the bonds of one node add to ∂/∂(K W), its share of ∂/∂λ and ∂/∂μ, and ∂/∂m."""
    c1, c2, xi_of, last = of.c1, of.c2, of.xi_of, of.dimension
    BondArrays, scalar, int_at = of.BondArrays, of.scalar, of.int_at
    bond_of, bond_class_of, volume_of = of.bond_of, of.bond_class_of, of.volume_of
    scalar_at, scalars_at, vecs_at = of.scalar_at, of.scalars_at, of.vecs_at
    add_at = add_to(scalar)
    Law, Fields = structs.Law, structs.Fields

    @wp.func
    def by_bond(
        bonds: BondArrays,
        law: Law,
        fields: Fields,
        i: wp.int32,
        base: wp.int32,
        kw_bar: wp.array(dtype=scalar),
    ):
        factor = -c2 * law.mu[0]
        dilatational = -c1 * (law.lam[0] - law.mu[0])
        shear = scalar(0.0)
        bulk = scalar(0.0)
        volume = scalar(0.0)
        begin = bonds.row[i]
        skip = bonds.lattice * begin
        for s in range(fields.u.shape[0]):
            ui = fields.u[s, i]
            hi = fields.h[s, i]
            theta_i = fields.theta[s, i]
            tau_i = fields.tau[s, i]
            for e in range(begin, bonds.row[i + 1]):
                j = int_at(bonds.neighbour, e)
                p = e - skip
                bond = bond_of(bonds, p, i, j)
                xi = xi_of(bond)
                c = bond_class_of(bonds, p)
                stretch = wp.dot(xi, vecs_at(fields.u, s, j) - ui)
                by_shear = wp.dot(xi, hi) * stretch * bond[last]
                by_bulk = wp.dot(xi, hi) * (theta_i + scalars_at(fields.theta, s, j))
                shear += scalar_at(law.kw, c) * by_shear
                bulk += scalar_at(law.kw, c) * by_bulk
                by_d = dilatational * by_bulk + tau_i * stretch
                add_at(kw_bar, p - base, factor * by_shear + by_d)
            volume += tau_i * theta_i
        v = volume_of(bonds, i)
        m_bar = -factor * shear / law.m[v]
        return shear, bulk, m_bar + (-dilatational * bulk / law.m[v] - volume / c1)

    return by_bond


def _table_adjoint(of, structs):
    last = of.dimension
    BondArrays, scalar, scalar_at = of.BondArrays, of.scalar, of.scalar_at
    add_at, by_bond = add_to(scalar), _by_bond(of, structs)
    Law, Fields = structs.Law, structs.Fields

    @wp.kernel(enable_backward=False)
    def table_adjoint(
        first: wp.int32,
        spans: wp.array(dtype=wp.vec3i),
        nodes: wp.array(dtype=wp.int32),
        bonds: BondArrays,
        r: wp.array(dtype=scalar),
        law: Law,
        fields: Fields,
        kw_bar: wp.array(dtype=scalar),
        parts: wp.array2d(dtype=scalar),
    ):
        """∂/∂(K W) of the bonds of a block's nodes begin ≤ t < end, one after another, (45–47).

        A span is (base, begin, end). kw_bar holds the bonds p of the pattern at p − base.
        parts[block] takes what ∂/∂λ and ∂/∂μ are made of, (47).
        """
        block = first + wp.tid()
        span = spans[block]
        base = span[0]
        shears, bulks = scalar(0.0), scalar(0.0)
        volumes = scalar(0.0)
        for t in range(span[1], span[2]):
            i = nodes[t]
            shear, bulk, m_bar = by_bond(bonds, law, fields, i, base, kw_bar)
            shears += shear
            bulks += bulk
            if bonds.lattice == 1:  # one volume for all: its bonds are done once, below
                volumes += m_bar
            else:
                for e in range(bonds.row[i], bonds.row[i + 1]):
                    square = scalar_at(r, e) * scalar_at(r, e)
                    add_at(kw_bar, e - base, m_bar * square)
        parts[block, 0] = shears
        parts[block, 1] = bulks
        if bonds.lattice == 1:
            for p in range(bonds.pattern.shape[0]):
                square = scalar(1.0) / bonds.pattern[p][last]
                add_at(kw_bar, p - base, volumes * square)

    return table_adjoint
