"""The two gather sweeps of the force on a lattice, and the three of its gradient, (N1–N9).

Every node has the same family in one order: bond p of node i leads to neighbour[i B + p], B bonds
a family. bonds[p] holds ξ, then 16 μ w/r², 2 p, 2 p_in and 2 p_out. Where a node's neighbours are
all there, Σ p ξ = 0, so that what a node adds of its own to sums of p (P_i + P_j) ξ is left out.
No two threads write to one place.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.bonds import add_to, load, load_row
from warp_peri.kernels.nonlinear.law import law


@cache
def _state(scalar):
    of = law(scalar)
    vec, mat, numbers, stress, clipped = of.vec, of.mat, of.numbers, of.stress, of.clipped
    bond_type = wp.types.vector(6, scalar)
    int_at, bond_at = load(wp.int32), load(bond_type)
    vecs_at = load_row(vec)

    @wp.kernel(enable_backward=False)
    def state(
        first: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        neighbour: wp.array(dtype=wp.int32),
        bonds: wp.array(dtype=bond_type),
        m: numbers,
        radius: scalar,
        u: wp.array2d(dtype=vec),
        theta: wp.array2d(dtype=scalar),
        H: wp.array2d(dtype=mat),
        P: wp.array2d(dtype=mat),
    ):
        """θ, H and P = Ψ′(H), (N1) and (N4); H is clipped for P where a radius is given."""
        s, t = wp.tid()
        i = nodes[first + t]
        ui = u[s, i]
        count = bonds.shape[0]
        total = scalar(0.0)
        by_x = vec()
        by_y = vec()
        for p in range(count):
            b = bond_at(bonds, p)
            eta = vecs_at(u, s, int_at(neighbour, i * count + p)) - ui
            total += b[3] * (b[0] * eta[0] + b[1] * eta[1])
            by_x += (b[4] * b[0]) * eta
            by_y += (b[4] * b[1]) * eta
        gradient = mat(by_x[0], by_y[0], by_x[1], by_y[1])
        theta[s, i] = total
        H[s, i] = gradient
        P[s, i] = stress(clipped(gradient, radius), m)

    return state


@cache
def _force(scalar):
    of = law(scalar)
    vec, mat = of.vec, of.mat
    bond_type = wp.types.vector(6, scalar)
    int_at, bond_at = load(wp.int32), load(bond_type)
    vecs_at, scalars_at, mats_at = load_row(vec), load_row(scalar), load_row(mat)

    @wp.kernel(enable_backward=False)
    def force(
        first: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        neighbour: wp.array(dtype=wp.int32),
        bonds: wp.array(dtype=bond_type),
        bulk: scalar,
        u: wp.array2d(dtype=vec),
        theta: wp.array2d(dtype=scalar),
        P: wp.array2d(dtype=mat),
        Lu: wp.array2d(dtype=vec),
    ):
        """L u = L_LPS u − Σ 2 p_out P_j ξ, (N2)."""
        s, t = wp.tid()
        i = nodes[first + t]
        ui = u[s, i]
        count = bonds.shape[0]
        own = theta[s, i]
        total = vec()
        for p in range(count):
            b = bond_at(bonds, p)
            j = int_at(neighbour, i * count + p)
            eta = vecs_at(u, s, j) - ui
            density = b[2] * (b[0] * eta[0] + b[1] * eta[1])
            density += bulk * b[3] * (own + scalars_at(theta, s, j))
            xi = vec(b[0], b[1])
            total -= density * xi + mats_at(P, s, j) * (b[5] * xi)
        Lu[s, first + t] = total

    return force


@cache
def _state_adjoint(scalar):
    of = law(scalar)
    vec, mat, numbers, curved, clipped = of.vec, of.mat, of.numbers, of.curved, of.clipped
    clipped_back = of.clipped_back
    bond_type = wp.types.vector(6, scalar)
    int_at, bond_at = load(wp.int32), load(bond_type)
    vecs_at = load_row(vec)

    @wp.kernel(enable_backward=False)
    def state_adjoint(
        first: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        neighbour: wp.array(dtype=wp.int32),
        bonds: wp.array(dtype=bond_type),
        bulk: scalar,
        m: numbers,
        radius: scalar,
        g: wp.array2d(dtype=vec),
        H: wp.array2d(dtype=mat),
        theta_bar: wp.array2d(dtype=scalar),
        P_bar: wp.array2d(dtype=mat),
        H_bar: wp.array2d(dtype=mat),
    ):
        """∂/∂θ, ∂/∂P and ∂/∂H, (N7); g is zero off the interior."""
        s, t = wp.tid()
        i = nodes[first + t]
        count = bonds.shape[0]
        total = scalar(0.0)
        by_x = vec()
        by_y = vec()
        for p in range(count):
            b = bond_at(bonds, p)
            gj = vecs_at(g, s, int_at(neighbour, i * count + p))
            total += b[3] * (b[0] * gj[0] + b[1] * gj[1])
            by_x += (b[5] * b[0]) * gj
            by_y += (b[5] * b[1]) * gj
        back = mat(by_x[0], by_y[0], by_x[1], by_y[1])
        theta_bar[s, i] = bulk * total
        P_bar[s, i] = back
        gradient = H[s, i]
        H_bar[s, i] = clipped_back(gradient, radius, curved(clipped(gradient, radius), m, back))

    return state_adjoint


@cache
def _displacement_adjoint(scalar):
    of = law(scalar)
    vec, mat = of.vec, of.mat
    bond_type = wp.types.vector(6, scalar)
    int_at, bond_at = load(wp.int32), load(bond_type)
    vecs_at, scalars_at, mats_at = load_row(vec), load_row(scalar), load_row(mat)

    @wp.kernel(enable_backward=False)
    def displacement_adjoint(
        first: wp.int32,
        neighbour: wp.array(dtype=wp.int32),
        bonds: wp.array(dtype=bond_type),
        g: wp.array2d(dtype=vec),
        theta_bar: wp.array2d(dtype=scalar),
        H_bar: wp.array2d(dtype=mat),
        u_bar: wp.array2d(dtype=vec),
    ):
        """∂/∂u of every node, (N8)."""
        s, t = wp.tid()
        i = first + t
        count = bonds.shape[0]
        gi = g[s, i]
        own = theta_bar[s, i]
        total = vec()
        for p in range(count):
            j = int_at(neighbour, i * count + p)
            if j >= 0:
                b = bond_at(bonds, p)
                difference = gi - vecs_at(g, s, j)
                density = b[2] * (b[0] * difference[0] + b[1] * difference[1])
                density -= b[3] * (own + scalars_at(theta_bar, s, j))
                xi = vec(b[0], b[1])
                total += density * xi - mats_at(H_bar, s, j) * (b[4] * xi)
        u_bar[s, i] = total

    return displacement_adjoint


@cache
def _Fields(scalar):
    of = law(scalar)
    vec, mat = of.vec, of.mat

    @wp.struct
    class Fields:
        u: wp.array2d(dtype=vec)
        theta: wp.array2d(dtype=scalar)
        H: wp.array2d(dtype=mat)
        P: wp.array2d(dtype=mat)
        g: wp.array2d(dtype=vec)
        theta_bar: wp.array2d(dtype=scalar)
        P_bar: wp.array2d(dtype=mat)
        H_bar: wp.array2d(dtype=mat)

    return Fields


@cache
def _table_adjoint(scalar):
    of = law(scalar)
    vec, mat, numbers, slopes, clipped = of.vec, of.mat, of.numbers, of.slopes, of.clipped
    bond_type, four = wp.types.vector(6, scalar), wp.types.vector(4, scalar)
    int_at, bond_at = load(wp.int32), load(bond_type)
    vecs_at, scalars_at, mats_at = load_row(vec), load_row(scalar), load_row(mat)
    add_four = add_to(four)
    Fields = _Fields(scalar)

    @wp.kernel(enable_backward=False)
    def table_adjoint(
        block: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        begin: wp.int32,
        end: wp.int32,
        neighbour: wp.array(dtype=wp.int32),
        bonds: wp.array(dtype=bond_type),
        bulk: scalar,
        radius: scalar,
        fields: Fields,
        bars: wp.array(dtype=four),
        by_numbers: wp.array(dtype=numbers),
        by_bulk: wp.array(dtype=scalar),
    ):
        """Sums over the nodes begin ≤ t < end, (N9): to the entries of every bond in `bars`, to
        the numbers of the material and to λ − μ in entry `block`."""
        count = bonds.shape[0]
        material = numbers()
        bulks = scalar(0.0)
        for s in range(fields.u.shape[0]):
            for t in range(begin, end):
                i = nodes[t]
                ui = fields.u[s, i]
                gi = fields.g[s, i]
                own, back = fields.theta[s, i], fields.theta_bar[s, i]
                into = fields.H_bar[s, i]
                for p in range(count):
                    b = bond_at(bonds, p)
                    j = int_at(neighbour, i * count + p)
                    xi = vec(b[0], b[1])
                    eta = vecs_at(fields.u, s, j) - ui
                    along = wp.dot(gi, xi)
                    stretch = wp.dot(xi, eta)
                    both = along * (own + scalars_at(fields.theta, s, j))
                    bulks -= b[3] * both
                    add_four(
                        bars,
                        p,
                        four(
                            -along * stretch,
                            back * stretch - bulk * both,
                            wp.dot(into * xi, eta),
                            -wp.dot(gi, mats_at(fields.P, s, j) * xi),
                        ),
                    )
                material += slopes(clipped(fields.H[s, i], radius), fields.P_bar[s, i])
        by_numbers[block] = material
        by_bulk[block] = bulks

    return table_adjoint


@cache
def _tangents(scalar):
    of = law(scalar)
    mat, numbers, curved = of.mat, of.numbers, of.curved

    @wp.kernel(enable_backward=False)
    def tangents(
        first: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        m: numbers,
        H: wp.array2d(dtype=mat),
        out: wp.array2d(dtype=mat),
    ):
        """Ψ″(H) times the matrices with one entry 1, in the order 11, 12, 21, 22."""
        k, t = wp.tid()
        i = nodes[first + t]
        unit = mat()
        unit[k // 2, k % 2] = scalar(1.0)
        out[k, first + t] = curved(H[0, i], m, unit)

    return tangents


@cache
def sweeps(scalar):
    """The kernels in one precision."""
    of = law(scalar)
    vec, mat, numbers = of.vec, of.mat, of.numbers
    bond_type, four = wp.types.vector(6, scalar), wp.types.vector(4, scalar)
    return SimpleNamespace(
        bond=bond_type,
        vec=vec,
        mat=mat,
        numbers=numbers,
        four=four,
        Fields=_Fields(scalar),
        state=_state(scalar),
        force=_force(scalar),
        state_adjoint=_state_adjoint(scalar),
        displacement_adjoint=_displacement_adjoint(scalar),
        table_adjoint=_table_adjoint(scalar),
        tangents=_tangents(scalar),
    )
