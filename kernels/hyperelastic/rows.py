"""The tangent of a hyperelastic solid, node by node: 2 × 2 blocks on a window of the lattice.

A row gathers what its node shares with all nodes within twice the horizon, (H10). The block of a
node that is reached by some bonds stands at the centre of the window and the sum of their shifts.
"""

from functools import cache

import warp as wp

from warp_peri.kernels.hyperelastic.energies import energies
from warp_peri.kernels.hyperelastic.parts import parts, types


@wp.struct
class Window:
    """Where the nodes around another stand in its row."""

    shift: wp.array(dtype=wp.int32)  # of every bond
    near: wp.array(dtype=wp.int32)  # bonds of the short strain
    linked: wp.array(dtype=wp.int32)  # bonds with a deviation
    centre: wp.int32


@cache
def _add(scalar):
    of = types(scalar)
    vec = of.vec
    block = wp.types.matrix((2, 2), scalar)

    @wp.func
    def add(K: wp.array2d(dtype=block), r: wp.int32, column: wp.int32, f: vec, g: vec):
        """The block f gᵀ of one row."""
        K[r, column] = K[r, column] + wp.outer(f, g)

    return add


@cache
def _gradient(scalar):
    of = types(scalar)
    vec, Lattice = of.vec, of.Lattice
    sided = wp.types.matrix((6, 2), scalar)

    @wp.func
    def gradient(lattice: Lattice, u: wp.array2d(dtype=vec), n: wp.int32, p: wp.int32, a: wp.int32):
        """∂Ē_n/∂u_a, where bond p leads from a to n; p < 0 for n = a, whose family is whole."""
        total = sided()
        if p >= 0:
            total -= wp.outer(lattice.weight[p], lattice.xi[p] + u[0, n] - u[0, a])
        else:
            for q in range(lattice.xi.shape[0]):
                j = lattice.neighbour[n, q]
                total -= wp.outer(lattice.weight[q], lattice.xi[q] + u[0, j] - u[0, n])
        return total

    return gradient


@cache
def _strain_row(scalar):
    of = types(scalar)
    vec, block, Lattice = of.vec, of.block, of.Lattice
    gradient, add = _gradient(scalar), _add(scalar)
    pair = wp.types.matrix((2, 2), scalar)

    @wp.func
    def strain_row(
        lattice: Lattice,
        window: Window,
        u: wp.array2d(dtype=vec),
        H: wp.array2d(dtype=block),
        a: wp.int32,
        r: wp.int32,
        K: wp.array2d(dtype=pair),
    ):
        """Σ_n (∂Ē_n/∂u_a)ᵀ H_n ∂Ē_n/∂u_b."""
        count = lattice.xi.shape[0]
        for p in range(-1, count):
            n, own = a, wp.int32(window.centre)
            if p >= 0:
                n = lattice.neighbour[a, p]
                own = window.centre + window.shift[p]
            T = wp.transpose(gradient(lattice, u, n, p, a)) * H[0, n]
            back = pair()
            for q in range(count):
                b = lattice.neighbour[n, q]
                Y = lattice.xi[q] + u[0, b] - u[0, n]
                f = T * lattice.weight[q]
                add(K, r, own + window.shift[q], f, Y)
                back += wp.outer(f, Y)
            K[r, own] = K[r, own] - back

    return strain_row


@cache
def _mean_row(scalar):
    of = types(scalar)
    vec, Lattice = of.vec, of.Lattice
    add = _add(scalar)
    half = scalar(0.5)
    pair = wp.types.matrix((2, 2), scalar)

    @wp.func
    def mean_row(
        lattice: Lattice,
        window: Window,
        u: wp.array2d(dtype=vec),
        n: wp.int32,
        p: wp.int32,
        f: vec,
        r: wp.int32,
        place: wp.int32,
        K: wp.array2d(dtype=pair),
    ):
        """f (∂m/∂u_b)ᵀ for the half of the mean strain along bond p that node n holds."""
        for t in range(window.near.shape[0]):
            q = window.near[t]
            b = lattice.neighbour[n, q]
            Y = lattice.xi[q] + u[0, b] - u[0, n]
            weight = lattice.weight[q]
            unit = lattice.unit[p]
            w = half * (unit[0] * weight[3] + unit[1] * weight[4] + unit[2] * weight[5])
            add(K, r, place + window.shift[q], w * f, Y)
            add(K, r, place, -w * f, Y)

    return mean_row


@cache
def _step_row(scalar):
    of = types(scalar)
    part = parts(scalar)
    vec, six, Lattice, Terms = of.vec, of.six, of.Lattice, of.Terms
    across, short, add, curve = part.across, part.short, _add(scalar), energies(scalar).curve
    share = part.share
    pair, wide = wp.types.matrix((2, 2), scalar), wp.types.matrix((2, 3), scalar)
    half, two = scalar(0.5), scalar(2.0)

    @wp.func
    def step_row(
        lattice: Lattice,
        terms: Terms,
        window: Window,
        u: wp.array2d(dtype=vec),
        E: wp.array2d(dtype=six),
        n: wp.int32,
        g: wp.types.matrix((2, 6), scalar),
        r: wp.int32,
        own: wp.int32,
        K: wp.array2d(dtype=pair),
    ):
        """gᵀ Σ c ∂(2 Φ′(E_n) − 2 Φ′(mean))/∂u_b of the terms that act across bonds of node n."""
        for k in range(terms.kind.shape[0]):
            for side in range(2):
                m = across(lattice, terms.seen[k], side, n)
                if m >= 0:
                    middle = half * (short(E[0, n]) + short(E[0, m]))
                    B = curve(terms.kind[k], terms.angle[k], terms.exponent[k], middle)
                    A = curve(terms.kind[k], terms.angle[k], terms.exponent[k], short(E[0, n]))
                    held = (
                        share(lattice, n, m)
                        * terms.c[terms.first_term + k]
                        * wide(g[0, 3], g[0, 4], g[0, 5], g[1, 3], g[1, 4], g[1, 5])
                    )
                    T, far = held * (two * A - B), held * B
                    away = own + window.shift[terms.seen[k] - 2 + side * (lattice.xi.shape[0] / 2)]
                    for t in range(window.near.shape[0]):
                        q = window.near[t]
                        f = T * short(lattice.weight[q])
                        Y = lattice.xi[q] + u[0, lattice.neighbour[n, q]] - u[0, n]
                        add(K, r, own + window.shift[q], f, Y)
                        add(K, r, own, -f, Y)
                        f = far * short(lattice.weight[q])
                        Z = lattice.xi[q] + u[0, lattice.neighbour[m, q]] - u[0, m]
                        add(K, r, away + window.shift[q], -f, Z)
                        add(K, r, away, f, Z)

    return step_row


@cache
def _curved(scalar):
    of = types(scalar)
    part = parts(scalar)
    vec, six, Lattice, Terms = of.vec, of.six, of.Lattice, of.Terms
    one, two, four, six_times = scalar(1.0), scalar(2.0), scalar(4.0), scalar(6.0)
    three = energies(scalar).vec
    deviation, bond_strain = part.deviation, part.bond_strain

    @wp.func
    def curved(lattice: Lattice, terms: Terms, p: wp.int32, Y: vec, Ei: six, Ej: six):
        """Second derivatives of a deviation's energy by s twice, s and m, m twice."""
        d = deviation(lattice, p, bond_strain(lattice, p, Y), Ei, Ej)
        c = terms.c[terms.first_deviation + lattice.deviation[p]]
        scaled = c * d[2]
        return three(
            scaled * (one - two * d[0]) * d[1] * d[1],
            -scaled * (one + two * d[0]) * d[1] * d[2],
            scaled * (one + (six_times + four * d[0]) * d[0]) * d[2] * d[2],
        )

    return curved


@cache
def _short_row(scalar):
    of = types(scalar)
    part = parts(scalar)
    vec, six, Lattice, Terms = of.vec, of.six, of.Lattice, of.Terms
    gradient, mean_row, step_row, add, curved = (
        _gradient(scalar), _mean_row(scalar), _step_row(scalar), _add(scalar), _curved(scalar),
    )  # fmt: skip
    deviates, on_short, share = part.deviates, part.on_short, part.share
    half = scalar(0.5)
    pair = wp.types.matrix((2, 2), scalar)

    @wp.func
    def short_row(
        lattice: Lattice,
        terms: Terms,
        window: Window,
        u: wp.array2d(dtype=vec),
        E: wp.array2d(dtype=six),
        a: wp.int32,
        r: wp.int32,
        K: wp.array2d(dtype=pair),
    ):
        """What acts on short strains that a moves; deviating bonds of a move by their own s too."""
        for t in range(-1, window.near.shape[0]):
            n, p, own = a, -1, wp.int32(window.centre)
            if t >= 0:
                p = window.near[t]
                n = lattice.neighbour[a, p]
                own = window.centre + window.shift[p]
            g = wp.transpose(gradient(lattice, u, n, p, a))
            step_row(lattice, terms, window, u, E, n, g, r, own, K)
            for k in range(window.linked.shape[0]):
                q = window.linked[k]
                m = lattice.neighbour[n, q]
                if deviates(lattice, q, n, m):
                    Y = lattice.xi[q] + u[0, m] - u[0, n]
                    twice = curved(lattice, terms, q, Y, E[0, n], E[0, m])
                    twice = share(lattice, n, m) * twice
                    rate = lattice.inverse[q] * Y
                    mean = half * (g * on_short(lattice.unit[q]))
                    by_s, by_m = twice[1] * mean, twice[2] * mean
                    if t < 0:
                        by_s -= twice[0] * rate
                        by_m -= twice[1] * rate
                    add(K, r, own + window.shift[q], by_s, rate)
                    add(K, r, own, -by_s, rate)
                    mean_row(lattice, window, u, n, q, by_m, r, own, K)
                    mean_row(lattice, window, u, m, q, by_m, r, own + window.shift[q], K)

    return short_row


@cache
def _bond_row(scalar):
    of = types(scalar)
    part = parts(scalar)
    vec, six, Lattice, Terms = of.vec, of.six, of.Lattice, of.Terms
    bond_strain, deviates, deviation = part.bond_strain, part.deviates, part.deviation
    by_own, share, bond = part.by_own, part.share, energies(scalar).bond

    @wp.func
    def bond_row(
        lattice: Lattice,
        terms: Terms,
        p: wp.int32,
        a: wp.int32,
        j: wp.int32,
        Y: vec,
        E: wp.array2d(dtype=six),
        G: wp.array2d(dtype=six),
    ):
        """The block that a bond adds between its node and itself, and takes off its far end's."""
        count = terms.bond_kind.shape[0]
        strained = bond_strain(lattice, p, Y)
        t, curve = scalar(0.0), scalar(0.0)
        for q in range(count):
            c = terms.c[lattice.bond_class[p] * count + q]
            local = bond(terms.bond_kind[q], strained)
            t += c * local[1]
            curve += c * local[2]
        if deviates(lattice, p, a, j):
            d = deviation(lattice, p, strained, E[0, a], E[0, j])
            t += terms.c[terms.first_deviation + lattice.deviation[p]] * by_own(d)
        inverse, shared = lattice.inverse[p], share(lattice, a, j)
        t, curve = shared * t, shared * curve
        along = t * inverse + wp.dot(lattice.weight[p], G[0, a] + G[0, j])
        return curve * inverse * inverse * wp.outer(Y, Y) + wp.diag(vec(along, along))

    return bond_row


@cache
def tangent_rows(scalar):
    """The kernel in one precision."""
    of = types(scalar)
    vec, six, block, Lattice, Terms = of.vec, of.six, of.block, of.Lattice, of.Terms
    strain_row, short_row, bond_row = (
        _strain_row(scalar), _short_row(scalar), _bond_row(scalar),
    )  # fmt: skip
    pair = wp.types.matrix((2, 2), scalar)

    @wp.kernel(enable_backward=False)
    def rows_of_tangent(
        lattice: Lattice,
        terms: Terms,
        rows: wp.array(dtype=wp.int32),
        window: Window,
        u: wp.array2d(dtype=vec),
        E: wp.array2d(dtype=six),
        G: wp.array2d(dtype=six),
        H: wp.array2d(dtype=block),
        K: wp.array2d(dtype=pair),
    ):
        """∂²U/∂u_a∂u_b over h² for every interior node a, K zero before, (H10)."""
        r = wp.tid()
        a = rows[r]
        if terms.kind.shape[0] > 0:
            strain_row(lattice, window, u, H, a, r, K)
        if terms.local > 0:
            short_row(lattice, terms, window, u, E, a, r, K)
        for p in range(lattice.xi.shape[0]):
            j = lattice.neighbour[a, p]
            Y = lattice.xi[p] + u[0, j] - u[0, a]
            local = bond_row(lattice, terms, p, a, j, Y, E, G)
            K[r, window.centre] = K[r, window.centre] + local
            K[r, window.centre + window.shift[p]] = K[r, window.centre + window.shift[p]] - local

    return rows_of_tangent
