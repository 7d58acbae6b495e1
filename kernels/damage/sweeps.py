"""Forces and energies over unbroken bonds of a lattice body, and the breaking of bonds.

Bond b of node i leads to neighbour[i B + b]; a negative one is broken or was never there. The table
of the ball holds per bond ξ, a = d w, k = 2 d (d + 2) μ w / r² and the limit of its criterion; with
e = ξ·(u_j − u_i) (theory, C1–C4)

    θ_i = Σ a e,   f_i = Σ [(λ−μ) a (θ_i + θ_j) + k e] ξ,   w_i = (λ−μ) θ_i²/2 + Σ k e²/4.

Sums of one node are chains of additions that wait for each other, so the sweeps over all nodes take
two nodes at a time: that is worth a third of their speed. A node's sums are the same additions in
the same order either way, and so are the bits.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.bonds import load

STRETCH, ENERGY = 0, 1
"""Criteria: e beyond its limit; the bond's energy density beyond its limit."""

S = wp.float64
int_at, float_at = load(wp.int32), load(S)


@cache
def _bonds(dimension, tension_only):
    """A bond in d dimensions, and whether it breaks: in tension, or either way."""
    d = dimension
    vec, bond_type = wp.types.vector(d, S), wp.types.vector(d + 3, S)

    @wp.func
    def along(bond: bond_type):
        xi = vec()
        for a in range(d):
            xi[a] = bond[a]
        return xi

    @wp.func
    def breaks(value: S, limit: S, no_fail: wp.array(dtype=wp.uint8), i: wp.int32, j: wp.int32):
        beyond = value > limit
        if wp.static(not tension_only):
            beyond = wp.abs(value) > limit
        if beyond:  # no_fail is read for the few that are
            return no_fail[i] + no_fail[j] == wp.uint8(0)
        return False

    return SimpleNamespace(
        A=wp.constant(d),
        K=wp.constant(d + 1),
        LIMIT=wp.constant(d + 2),
        vec=vec,
        bond=bond_type,
        along=along,
        breaks=breaks,
        bond_at=load(bond_type),
        vec_at=load(vec),
    )


@cache
def _bond_based(dimension, tension_only):
    _ = _bonds(dimension, tension_only)
    K, LIMIT, vec, bond_type = _.K, _.LIMIT, _.vec, _.bond
    along, breaks, bond_at, vec_at = _.along, _.breaks, _.bond_at, _.vec_at

    @wp.kernel(enable_backward=False)
    def bond_based(
        first: wp.int32,
        u: wp.array(dtype=vec),
        bonds: wp.int32,
        table: wp.array(dtype=bond_type),
        no_fail: wp.array(dtype=wp.uint8),
        force: wp.array(dtype=vec),
        energy: wp.array(dtype=S),
        lost: wp.array(dtype=wp.int32),
        neighbour: wp.array(dtype=wp.int32),
    ):
        """f and w of nodes 2t and 2t + 1 over all bonds, those that break now included; λ = μ.

        Bonds beyond their limit are counted in lost. Arrays hold an even number of nodes.
        """
        p = 2 * (first + wp.tid())
        q = p + 1
        at_p, at_q = p * bonds, q * bonds
        up, uq = vec_at(u, p), vec_at(u, q)
        fp, fq, ep, eq = vec(), vec(), S(0.0), S(0.0)
        lost_p, lost_q = wp.int32(0), wp.int32(0)
        for b in range(bonds):
            bond = bond_at(table, b)
            xi = along(bond)
            k, limit = bond[K], bond[LIMIT]
            j = int_at(neighbour, at_p + b)
            if j >= 0:
                e = wp.dot(xi, vec_at(u, j) - up)
                s = k * e
                fp += s * xi
                ep += s * e
                if breaks(e, limit, no_fail, p, j):
                    neighbour[at_p + b] = -1 - j
                    lost_p += 1
            j = int_at(neighbour, at_q + b)
            if j >= 0:
                e = wp.dot(xi, vec_at(u, j) - uq)
                s = k * e
                fq += s * xi
                eq += s * e
                if breaks(e, limit, no_fail, q, j):
                    neighbour[at_q + b] = -1 - j
                    lost_q += 1
        force[p] = fp
        force[q] = fq
        energy[p] = S(0.25) * ep
        energy[q] = S(0.25) * eq
        lost[p] = lost_p
        lost[q] = lost_q

    return bond_based


@cache
def _dilatation(dimension, tension_only):
    _ = _bonds(dimension, tension_only)
    A, vec, bond_type, along, bond_at, vec_at = _.A, _.vec, _.bond, _.along, _.bond_at, _.vec_at

    @wp.kernel(enable_backward=False)
    def dilatation(
        first: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        u: wp.array(dtype=vec),
        bonds: wp.int32,
        table: wp.array(dtype=bond_type),
        neighbour: wp.array(dtype=wp.int32),
        theta: wp.array(dtype=S),
    ):
        """θ_i over the unbroken bonds of the listed nodes."""
        i = nodes[first + wp.tid()]
        own = vec_at(u, i)
        total = S(0.0)
        for b in range(bonds):
            j = int_at(neighbour, i * bonds + b)
            if j >= 0:
                bond = bond_at(table, b)
                total += bond[A] * wp.dot(along(bond), vec_at(u, j) - own)
        theta[i] = total

    return dilatation


@cache
def _paired_dilatation(dimension, tension_only):
    _ = _bonds(dimension, tension_only)
    A, vec, bond_type, along, bond_at, vec_at = _.A, _.vec, _.bond, _.along, _.bond_at, _.vec_at

    @wp.kernel(enable_backward=False)
    def paired_dilatation(
        first: wp.int32,
        u: wp.array(dtype=vec),
        bonds: wp.int32,
        table: wp.array(dtype=bond_type),
        neighbour: wp.array(dtype=wp.int32),
        theta: wp.array(dtype=S),
    ):
        """θ over the unbroken bonds of nodes 2t and 2t + 1."""
        p = 2 * (first + wp.tid())
        q = p + 1
        at_p, at_q = p * bonds, q * bonds
        up, uq = vec_at(u, p), vec_at(u, q)
        sum_p, sum_q = S(0.0), S(0.0)
        for b in range(bonds):
            bond = bond_at(table, b)
            xi = along(bond)
            a = bond[A]
            j = int_at(neighbour, at_p + b)
            if j >= 0:
                sum_p += a * wp.dot(xi, vec_at(u, j) - up)
            j = int_at(neighbour, at_q + b)
            if j >= 0:
                sum_q += a * wp.dot(xi, vec_at(u, j) - uq)
        theta[p] = sum_p
        theta[q] = sum_q

    return paired_dilatation


@cache
def _state_based(dimension, tension_only):
    _ = _bonds(dimension, tension_only)
    A, K, LIMIT, vec, bond_type = _.A, _.K, _.LIMIT, _.vec, _.bond
    along, breaks, bond_at, vec_at = _.along, _.breaks, _.bond_at, _.vec_at

    @wp.kernel(enable_backward=False)
    def state_based(
        first: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        u: wp.array(dtype=vec),
        table: wp.array(dtype=bond_type),
        excess: S,
        criterion: wp.int32,
        no_fail: wp.array(dtype=wp.uint8),
        theta: wp.array(dtype=S),
        force: wp.array(dtype=vec),
        energy: wp.array(dtype=S),
        lost: wp.array(dtype=wp.int32),
        neighbour: wp.array(dtype=wp.int32),
    ):
        """f and w of the listed nodes, θ given; excess is λ − μ. Breaks as the bond-based sweep.

        A criterion below zero breaks nothing.
        """
        bonds = table.shape[0]
        i = nodes[first + wp.tid()]
        at, ui, own = i * bonds, vec_at(u, i), float_at(theta, i)
        f, w = vec(), S(0.0)
        count = wp.int32(0)
        for b in range(bonds):
            j = int_at(neighbour, at + b)
            if j >= 0:
                bond = bond_at(table, b)
                xi = along(bond)
                e = wp.dot(xi, vec_at(u, j) - ui)
                s = bond[K] * e
                w += S(0.25) * s * e
                pull = s + excess * bond[A] * (own + float_at(theta, j))
                f += pull * xi
                value = e
                if criterion == 1:  # energy, counted as negative in compression
                    value = S(0.5) * pull * e
                    if e < S(0.0):
                        value = -wp.abs(value)
                if criterion >= 0:  # noqa: SIM102 (Warp's `and` would work both out)
                    if breaks(value, bond[LIMIT], no_fail, i, j):
                        neighbour[at + b] = -1 - j
                        count += 1
        force[i] = f
        energy[i] = w + S(0.5) * excess * own * own
        lost[i] = count

    return state_based


@cache
def _paired_state_based(dimension, tension_only):
    _ = _bonds(dimension, tension_only)
    A, K, LIMIT, vec, bond_type = _.A, _.K, _.LIMIT, _.vec, _.bond
    along, breaks, bond_at, vec_at = _.along, _.breaks, _.bond_at, _.vec_at

    @wp.kernel(enable_backward=False)
    def paired_state_based(
        first: wp.int32,
        u: wp.array(dtype=vec),
        bonds: wp.int32,
        table: wp.array(dtype=bond_type),
        excess: S,
        no_fail: wp.array(dtype=wp.uint8),
        theta: wp.array(dtype=S),
        force: wp.array(dtype=vec),
        energy: wp.array(dtype=S),
        lost: wp.array(dtype=wp.int32),
        neighbour: wp.array(dtype=wp.int32),
    ):
        """f and w of nodes 2t and 2t + 1, θ given; breaks bonds beyond their stretch."""
        p = 2 * (first + wp.tid())
        q = p + 1
        at_p, at_q = p * bonds, q * bonds
        up, uq = vec_at(u, p), vec_at(u, q)
        own_p, own_q = float_at(theta, p), float_at(theta, q)
        fp, fq, ep, eq = vec(), vec(), S(0.0), S(0.0)
        lost_p, lost_q = wp.int32(0), wp.int32(0)
        for b in range(bonds):
            bond = bond_at(table, b)
            xi = along(bond)
            a, k, limit = excess * bond[A], bond[K], bond[LIMIT]
            j = int_at(neighbour, at_p + b)
            if j >= 0:
                e = wp.dot(xi, vec_at(u, j) - up)
                s = k * e
                ep += S(0.25) * s * e
                pull = s + a * (own_p + float_at(theta, j))
                fp += pull * xi
                if breaks(e, limit, no_fail, p, j):
                    neighbour[at_p + b] = -1 - j
                    lost_p += 1
            j = int_at(neighbour, at_q + b)
            if j >= 0:
                e = wp.dot(xi, vec_at(u, j) - uq)
                s = k * e
                eq += S(0.25) * s * e
                pull = s + a * (own_q + float_at(theta, j))
                fq += pull * xi
                if breaks(e, limit, no_fail, q, j):
                    neighbour[at_q + b] = -1 - j
                    lost_q += 1
        force[p] = fp
        force[q] = fq
        energy[p] = ep + S(0.5) * excess * own_p * own_p
        energy[q] = eq + S(0.5) * excess * own_q * own_q
        lost[p] = lost_p
        lost[q] = lost_q

    return paired_state_based


@cache
def sweeps(dimension: int, tension_only: bool):
    """The kernels of one dimension and sign; bonds in compression break without tension_only."""
    makers = (_bond_based, _dilatation, _paired_dilatation, _state_based, _paired_state_based)
    return SimpleNamespace(
        vec=_bonds(dimension, tension_only).vec,
        bond=_bonds(dimension, tension_only).bond,
        **{maker.__name__[1:]: maker(dimension, tension_only) for maker in makers},
    )
