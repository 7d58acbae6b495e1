"""The state-based sweeps of sweeps.py over all nodes, two at a time, with the stretch criterion.

A node's sums are the same additions in the same order, so the bits are those of the single sweeps.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.damage.sweeps import TABLE, S, breaks_where, float_at, int_at


@wp.kernel(enable_backward=False)
def dilatation(
    first: wp.int32,
    u: wp.array(dtype=S),
    bonds: wp.int32,
    table: wp.array(dtype=S),
    neighbour: wp.array(dtype=wp.int32),
    theta: wp.array(dtype=S),
):
    """θ over the unbroken bonds of nodes 2t and 2t + 1."""
    p = 2 * (first + wp.tid())
    q = p + 1
    at_p = p * bonds
    at_q = q * bonds
    up0 = float_at(u, 2 * p)
    up1 = float_at(u, 2 * p + 1)
    uq0 = float_at(u, 2 * q)
    uq1 = float_at(u, 2 * q + 1)
    sum_p = S(0.0)
    sum_q = S(0.0)
    for b in range(bonds):
        x0 = float_at(table, TABLE * b)
        x1 = float_at(table, TABLE * b + 1)
        a = float_at(table, TABLE * b + 2)
        j = int_at(neighbour, at_p + b)
        if j >= 0:
            d = x0 * (float_at(u, 2 * j) - up0) + x1 * (float_at(u, 2 * j + 1) - up1)
            sum_p += a * d
        j = int_at(neighbour, at_q + b)
        if j >= 0:
            d = x0 * (float_at(u, 2 * j) - uq0) + x1 * (float_at(u, 2 * j + 1) - uq1)
            sum_q += a * d
    theta[p] = sum_p
    theta[q] = sum_q


@cache
def _state_based(tension_only):
    breaks = breaks_where(tension_only)

    @wp.kernel(enable_backward=False)
    def state_based(
        first: wp.int32,
        u: wp.array(dtype=S),
        bonds: wp.int32,
        table: wp.array(dtype=S),
        excess: S,
        no_fail: wp.array(dtype=wp.uint8),
        theta: wp.array(dtype=S),
        force: wp.array(dtype=wp.vec2d),
        energy: wp.array(dtype=S),
        lost: wp.array(dtype=wp.int32),
        neighbour: wp.array(dtype=wp.int32),
    ):
        """f and e of nodes 2t and 2t + 1, θ given; breaks bonds beyond their stretch."""
        p = 2 * (first + wp.tid())
        q = p + 1
        at_p, at_q = p * bonds, q * bonds
        up0, up1 = float_at(u, 2 * p), float_at(u, 2 * p + 1)
        uq0, uq1 = float_at(u, 2 * q), float_at(u, 2 * q + 1)
        own_p, own_q = float_at(theta, p), float_at(theta, q)
        fp0, fp1, fq0, fq1, ep, eq = S(0.0), S(0.0), S(0.0), S(0.0), S(0.0), S(0.0)
        lost_p, lost_q = wp.int32(0), wp.int32(0)
        for b in range(bonds):
            x0, x1 = float_at(table, TABLE * b), float_at(table, TABLE * b + 1)
            a = excess * float_at(table, TABLE * b + 2)
            k, limit = float_at(table, TABLE * b + 3), float_at(table, TABLE * b + 4)
            j = int_at(neighbour, at_p + b)
            if j >= 0:
                d = x0 * (float_at(u, 2 * j) - up0) + x1 * (float_at(u, 2 * j + 1) - up1)
                s = k * d
                ep += S(0.25) * s * d
                pull = s + a * (own_p + float_at(theta, j))
                fp0 += pull * x0
                fp1 += pull * x1
                if breaks(d, limit, no_fail, p, j):
                    neighbour[at_p + b] = -1 - j
                    lost_p += 1
            j = int_at(neighbour, at_q + b)
            if j >= 0:
                d = x0 * (float_at(u, 2 * j) - uq0) + x1 * (float_at(u, 2 * j + 1) - uq1)
                s = k * d
                eq += S(0.25) * s * d
                pull = s + a * (own_q + float_at(theta, j))
                fq0 += pull * x0
                fq1 += pull * x1
                if breaks(d, limit, no_fail, q, j):
                    neighbour[at_q + b] = -1 - j
                    lost_q += 1
        force[p] = wp.vec2d(fp0, fp1)
        force[q] = wp.vec2d(fq0, fq1)
        energy[p] = ep + S(0.5) * excess * own_p * own_p
        energy[q] = eq + S(0.5) * excess * own_q * own_q
        lost[p] = lost_p
        lost[q] = lost_q

    return state_based


@cache
def pairs(tension_only: bool):
    """The force sweep; bonds in compression break where tension_only is off."""
    return SimpleNamespace(dilatation=dilatation, state_based=_state_based(tension_only))
