"""Forces and energies over unbroken bonds of a lattice body, and the breaking of bonds.

Bond b of node i leads to neighbour[i B + b]; a negative one is broken or was never there. The table
of the ball holds per bond ξ₁, ξ₂, a = 2 w, k = 16 μ w / r² and the limit of its criterion; with
d = ξ·(u_j − u_i) (theory.md, C1–C4)

    θ_i = Σ a d,   f_i = Σ [(λ−μ) a (θ_i + θ_j) + k d] ξ,   e_i = (λ−μ) θ_i²/2 + Σ k d²/4.

Sums of one node are chains of additions that wait for each other, so the bond-based sweep takes two
nodes at a time: that is worth a third of its speed.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.bonds import load

TABLE, SHORT_TABLE = 5, 4
"""Numbers per bond in the table of the ball, and in that of the bond-based sweep, without a."""

STRETCH, ENERGY = 0, 1
"""Criteria: d beyond its limit; the bond's energy density beyond its limit."""

S = wp.float64
int_at, float_at = load(wp.int32), load(S)


@cache
def breaks_where(tension_only):
    """Whether a bond breaks: its value is beyond the limit, in tension or either way."""

    @wp.func
    def breaks(value: S, limit: S, no_fail: wp.array(dtype=wp.uint8), i: wp.int32, j: wp.int32):
        beyond = value > limit
        if wp.static(not tension_only):
            beyond = wp.abs(value) > limit
        if beyond:  # no_fail is read for the few that are
            return no_fail[i] + no_fail[j] == wp.uint8(0)
        return False

    return breaks


@cache
def _bond_based(tension_only):
    breaks = breaks_where(tension_only)

    @wp.kernel(enable_backward=False)
    def bond_based(
        first: wp.int32,
        u: wp.array(dtype=S),
        bonds: wp.int32,
        table: wp.array(dtype=S),
        no_fail: wp.array(dtype=wp.uint8),
        force: wp.array(dtype=wp.vec2d),
        energy: wp.array(dtype=S),
        lost: wp.array(dtype=wp.int32),
        neighbour: wp.array(dtype=wp.int32),
    ):
        """f and e of nodes 2t and 2t + 1 over all bonds, those that break now included; λ = μ.

        Bonds beyond their limit are counted in lost. Arrays hold an even number of nodes.
        """
        p = 2 * (first + wp.tid())
        q = p + 1
        at_p, at_q = p * bonds, q * bonds
        up0, up1 = float_at(u, 2 * p), float_at(u, 2 * p + 1)
        uq0, uq1 = float_at(u, 2 * q), float_at(u, 2 * q + 1)
        fp0, fp1, fq0, fq1, ep, eq = S(0.0), S(0.0), S(0.0), S(0.0), S(0.0), S(0.0)
        lost_p, lost_q = wp.int32(0), wp.int32(0)
        for b in range(bonds):
            x0 = float_at(table, SHORT_TABLE * b)
            x1 = float_at(table, SHORT_TABLE * b + 1)
            k = float_at(table, SHORT_TABLE * b + 2)
            limit = float_at(table, SHORT_TABLE * b + 3)
            j = int_at(neighbour, at_p + b)
            if j >= 0:
                d = x0 * (float_at(u, 2 * j) - up0) + x1 * (float_at(u, 2 * j + 1) - up1)
                s = k * d
                fp0 += s * x0
                fp1 += s * x1
                ep += s * d
                if breaks(d, limit, no_fail, p, j):
                    neighbour[at_p + b] = -1 - j
                    lost_p += 1
            j = int_at(neighbour, at_q + b)
            if j >= 0:
                d = x0 * (float_at(u, 2 * j) - uq0) + x1 * (float_at(u, 2 * j + 1) - uq1)
                s = k * d
                fq0 += s * x0
                fq1 += s * x1
                eq += s * d
                if breaks(d, limit, no_fail, q, j):
                    neighbour[at_q + b] = -1 - j
                    lost_q += 1
        force[p] = wp.vec2d(fp0, fp1)
        force[q] = wp.vec2d(fq0, fq1)
        energy[p] = S(0.25) * ep
        energy[q] = S(0.25) * eq
        lost[p] = lost_p
        lost[q] = lost_q

    return bond_based


@cache
def _dilatation(tension_only):

    @wp.kernel(enable_backward=False)
    def dilatation(
        first: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        u: wp.array(dtype=S),
        bonds: wp.int32,
        table: wp.array(dtype=S),
        neighbour: wp.array(dtype=wp.int32),
        theta: wp.array(dtype=S),
    ):
        """θ_i over the unbroken bonds of the listed nodes."""
        i = nodes[first + wp.tid()]
        u0 = float_at(u, 2 * i)
        u1 = float_at(u, 2 * i + 1)
        total = S(0.0)
        for b in range(bonds):
            j = int_at(neighbour, i * bonds + b)
            if j >= 0:
                d = float_at(table, TABLE * b) * (float_at(u, 2 * j) - u0)
                d += float_at(table, TABLE * b + 1) * (float_at(u, 2 * j + 1) - u1)
                total += float_at(table, TABLE * b + 2) * d
        theta[i] = total

    return dilatation


@cache
def _state_based(tension_only):
    breaks = breaks_where(tension_only)

    @wp.kernel(enable_backward=False)
    def state_based(
        first: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        u: wp.array(dtype=S),
        table: wp.array(dtype=S),
        excess: S,
        criterion: wp.int32,
        no_fail: wp.array(dtype=wp.uint8),
        theta: wp.array(dtype=S),
        force: wp.array(dtype=wp.vec2d),
        energy: wp.array(dtype=S),
        lost: wp.array(dtype=wp.int32),
        neighbour: wp.array(dtype=wp.int32),
    ):
        """f and e of the listed nodes, θ given; excess is λ − μ. Breaks as the bond-based sweep.

        A criterion below zero breaks nothing.
        """
        bonds = table.shape[0] // TABLE
        i = nodes[first + wp.tid()]
        u0 = float_at(u, 2 * i)
        u1 = float_at(u, 2 * i + 1)
        own = float_at(theta, i)
        f0 = S(0.0)
        f1 = S(0.0)
        e = S(0.0)
        count = wp.int32(0)
        for b in range(bonds):
            j = int_at(neighbour, i * bonds + b)
            if j >= 0:
                x0 = float_at(table, TABLE * b)
                x1 = float_at(table, TABLE * b + 1)
                d = x0 * (float_at(u, 2 * j) - u0) + x1 * (float_at(u, 2 * j + 1) - u1)
                s = float_at(table, TABLE * b + 3) * d
                e += S(0.25) * s * d
                pull = s + excess * float_at(table, TABLE * b + 2) * (own + float_at(theta, j))
                f0 += pull * x0
                f1 += pull * x1
                value = d
                if criterion == 1:  # energy, counted as negative in compression
                    value = S(0.5) * pull * d
                    if d < S(0.0):
                        value = -wp.abs(value)
                if criterion >= 0:  # noqa: SIM102 (Warp's `and` would work both out)
                    if breaks(value, float_at(table, TABLE * b + 4), no_fail, i, j):
                        neighbour[i * bonds + b] = -1 - j
                        count += 1
        force[i] = wp.vec2d(f0, f1)
        energy[i] = e + S(0.5) * excess * own * own
        lost[i] = count

    return state_based


@cache
def sweeps(tension_only: bool):
    """The kernels of one criterion's sign; bonds in compression break where tension_only is off."""
    return SimpleNamespace(
        bond_based=_bond_based(tension_only),
        dilatation=_dilatation(tension_only),
        state_based=_state_based(tension_only),
    )
