"""The second derivative of the energy on a displacement, and the derivatives by coefficients."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.hyperelastic.energies import energies
from warp_peri.kernels.hyperelastic.parts import parts, types


@cache
def _curvature(scalar):
    of = types(scalar)
    energy = energies(scalar)
    part = parts(scalar)
    six, block, Lattice, Terms = of.six, of.block, of.Lattice, of.Terms
    seen, acts, share = part.seen, part.acts, part.share
    curve = energy.curve

    @wp.kernel(enable_backward=False)
    def curvature(
        lattice: Lattice, terms: Terms, E: wp.array2d(dtype=six), H: wp.array2d(dtype=block)
    ):
        """H_i = Σ c ∂²Φ/∂Ē² of the strain energies."""
        s, i = wp.tid()
        total = block()
        for k in range(terms.kind.shape[0]):
            if acts(terms.seen[k], lattice.whole[i]):
                ripple = terms.seen[k]
                local = curve(
                    terms.kind[k], terms.angle[k], terms.exponent[k], seen(ripple, E[s, i])
                )
                c = share(lattice, i, i) * terms.c[terms.first_term + k]
                for a in range(3):
                    for b in range(3):
                        entry = c * local[a, b]
                        total[a, b] += entry
                        if ripple == 1:
                            total[a + 3, b] -= entry
                            total[a, b + 3] -= entry
                            total[a + 3, b + 3] += entry
        H[s, i] = total

    return curvature


@cache
def _strain_rate(scalar):
    of = types(scalar)
    part = parts(scalar)
    vec, six, Lattice = of.vec, of.six, of.Lattice
    known = part.known

    @wp.kernel(enable_backward=False)
    def strain_rate(
        lattice: Lattice,
        u: wp.array2d(dtype=vec),
        v: wp.array2d(dtype=vec),
        dE: wp.array2d(dtype=six),
    ):
        """The derivative of the strains along v."""
        s, i = wp.tid()
        total = six()
        for p in range(lattice.xi.shape[0]):
            j = lattice.neighbour[i, p]
            if j >= 0:
                Y = lattice.xi[p] + u[s, j] - u[s, i]
                total += wp.dot(Y, v[s, j] - v[s, i]) * lattice.weight[p]
        dE[s, i] = known(lattice.whole[i], total)

    return strain_rate


@cache
def _stress_rate(scalar):
    of = types(scalar)
    part = parts(scalar)
    vec, six, block, Lattice, Terms = of.vec, of.six, of.block, of.Lattice, of.Terms
    bond_strain, short, deviates = part.bond_strain, part.short, part.deviates
    deviation, on_short, across = part.deviation, part.on_short, part.across
    share = part.share
    curve = energies(scalar).curve
    half, one, two, four = scalar(0.5), scalar(1.0), scalar(2.0), scalar(4.0)
    six_times = scalar(6.0)

    @wp.kernel(enable_backward=False)
    def stress_rate(
        lattice: Lattice,
        terms: Terms,
        u: wp.array2d(dtype=vec),
        v: wp.array2d(dtype=vec),
        H: wp.array2d(dtype=block),
        E: wp.array2d(dtype=six),
        dE: wp.array2d(dtype=six),
        dG: wp.array2d(dtype=six),
    ):
        """The derivative of G along v."""
        s, i = wp.tid()
        total = H[s, i] * dE[s, i]
        for k in range(terms.kind.shape[0]):
            for side in range(2):
                j = across(lattice, terms.seen[k], side, i)
                if j >= 0:
                    here, rate_here = short(E[s, i]), short(dE[s, i])
                    middle = half * (here + short(E[s, j]))
                    bent = curve(terms.kind[k], terms.angle[k], terms.exponent[k], here)
                    rate = two * (bent * rate_here)
                    bent = curve(terms.kind[k], terms.angle[k], terms.exponent[k], middle)
                    rate -= bent * (rate_here + short(dE[s, j]))
                    c = share(lattice, i, j) * terms.c[terms.first_term + k]
                    total += c * on_short(rate)
        for p in range(lattice.xi.shape[0]):
            j = lattice.neighbour[i, p]
            if deviates(lattice, p, i, j):
                Y = lattice.xi[p] + u[s, j] - u[s, i]
                unit = lattice.unit[p]
                d = deviation(lattice, p, bond_strain(lattice, p, Y), E[s, i], E[s, j])
                own = wp.dot(Y, v[s, j] - v[s, i]) * lattice.inverse[p] * d[1]
                mean = half * wp.dot(unit, short(dE[s, i]) + short(dE[s, j])) * d[2]
                bend = (one + (six_times + four * d[0]) * d[0]) * mean - (one + two * d[0]) * own
                c = share(lattice, i, j) * terms.c[terms.first_deviation + lattice.deviation[p]]
                total += half * c * bend * d[2] * d[2] * on_short(unit)
        dG[s, i] = total

    return stress_rate


@cache
def _force_rate(scalar):
    of = types(scalar)
    energy = energies(scalar)
    part = parts(scalar)
    vec, six, Lattice, Terms = of.vec, of.six, of.Lattice, of.Terms
    bond_strain, short, deviates = part.bond_strain, part.short, part.deviates
    deviation, by_own, share = part.deviation, part.by_own, part.share
    bond = energy.bond
    half, one, two = scalar(0.5), scalar(1.0), scalar(2.0)

    @wp.kernel(enable_backward=False)
    def force_rate(
        lattice: Lattice,
        terms: Terms,
        u: wp.array2d(dtype=vec),
        v: wp.array2d(dtype=vec),
        E: wp.array2d(dtype=six),
        dE: wp.array2d(dtype=six),
        G: wp.array2d(dtype=six),
        dG: wp.array2d(dtype=six),
        df: wp.array2d(dtype=vec),
    ):
        """(K v)_i, the derivative of the force along v."""
        s, i = wp.tid()
        total = vec()
        count = terms.bond_kind.shape[0]
        for p in range(lattice.xi.shape[0]):
            j = lattice.neighbour[i, p]
            if j >= 0:
                Y = lattice.xi[p] + u[s, j] - u[s, i]
                y = v[s, j] - v[s, i]
                strained = bond_strain(lattice, p, Y)
                rate = wp.dot(Y, y) * lattice.inverse[p]
                t, dt = scalar(0.0), scalar(0.0)
                for q in range(count):
                    c = terms.c[lattice.bond_class[p] * count + q]
                    local = bond(terms.bond_kind[q], strained)
                    t += c * local[1]
                    dt += c * local[2] * rate
                if deviates(lattice, p, i, j):
                    c = terms.c[terms.first_deviation + lattice.deviation[p]]
                    unit = lattice.unit[p]
                    d = deviation(lattice, p, strained, E[s, i], E[s, j])
                    own = rate * d[1]
                    mean = half * wp.dot(unit, short(dE[s, i]) + short(dE[s, j])) * d[2]
                    t += c * by_own(d)
                    bent = (one - two * d[0]) * own - (one + two * d[0]) * mean
                    dt += c * bent * d[1] * d[2]
                shared = share(lattice, i, j)
                t, dt = shared * t, shared * dt
                along = t * lattice.inverse[p] + wp.dot(lattice.weight[p], G[s, i] + G[s, j])
                turned = dt * lattice.inverse[p] + wp.dot(lattice.weight[p], dG[s, i] + dG[s, j])
                total -= along * y + turned * Y
        df[s, i] = total

    return force_rate


@cache
def tangents(scalar):
    """Kernels of K v, (H10)."""
    return SimpleNamespace(
        curvature=_curvature(scalar),
        strain_rate=_strain_rate(scalar),
        stress_rate=_stress_rate(scalar),
        force_rate=_force_rate(scalar),
    )


@cache
def _stress_of_each(scalar):
    of = types(scalar)
    energy = energies(scalar)
    part = parts(scalar)
    vec, six, Lattice, Terms = of.vec, of.six, of.Lattice, of.Terms
    bond_strain, deviates, deviation = part.bond_strain, part.deviates, part.deviation
    by_mean, seen, placed, on_short = part.by_mean, part.seen, part.placed, part.on_short
    acts, across, short, share = part.acts, part.across, part.short, part.share
    slope_by = energy.slope_by
    half, two = scalar(0.5), scalar(2.0)

    @wp.kernel(enable_backward=False)
    def stress_of_each(
        lattice: Lattice,
        terms: Terms,
        by: wp.int32,
        u: wp.array2d(dtype=vec),
        E: wp.array2d(dtype=six),
        G: wp.array3d(dtype=six),
    ):
        """G of every deviation and strain energy alone, with coefficient one.

        With by = 1 and 2 its derivatives by the angle and the exponent of a fibre.
        """
        s, i, k = wp.tid()
        deviations = terms.first_term - terms.first_deviation
        total = six()
        if k >= deviations:
            t = k - deviations
            kind, angle, exponent = terms.kind[t], terms.angle[t], terms.exponent[t]
            if acts(terms.seen[t], lattice.whole[i]):
                strained = seen(terms.seen[t], E[s, i])
                local = slope_by(by, kind, angle, exponent, strained)
                total = share(lattice, i, i) * placed(terms.seen[t], local)
            for side in range(2):
                j = across(lattice, terms.seen[t], side, i)
                if j >= 0:
                    own = short(E[s, i])
                    middle = half * (own + short(E[s, j]))
                    local = slope_by(by, kind, angle, exponent, own)
                    local -= slope_by(by, kind, angle, exponent, middle)
                    total += two * share(lattice, i, j) * on_short(local)
        else:
            for p in range(lattice.xi.shape[0]):
                j = lattice.neighbour[i, p]
                if lattice.deviation[p] == k and deviates(lattice, p, i, j):
                    strain = bond_strain(lattice, p, lattice.xi[p] + u[s, j] - u[s, i])
                    d = deviation(lattice, p, strain, E[s, i], E[s, j])
                    shared = half * share(lattice, i, j)
                    total += shared * by_mean(d) * on_short(lattice.unit[p])
        G[s, i, k] = total

    return stress_of_each


@cache
def _force_of_each(scalar):
    of = types(scalar)
    energy = energies(scalar)
    part = parts(scalar)
    vec, six, Lattice, Terms = of.vec, of.six, of.Lattice, of.Terms
    bond_strain, deviates, deviation = part.bond_strain, part.deviates, part.deviation
    by_own, share = part.by_own, part.share
    bond = energy.bond

    @wp.kernel(enable_backward=False)
    def force_of_each(
        lattice: Lattice,
        terms: Terms,
        rows: wp.array(dtype=wp.int32),
        u: wp.array2d(dtype=vec),
        E: wp.array2d(dtype=six),
        G: wp.array3d(dtype=six),
        F: wp.array3d(dtype=vec),
    ):
        """The force of every energy alone on the nodes `rows`; its bonds once for all."""
        s, t = wp.tid()
        i = rows[t]
        count = terms.bond_kind.shape[0]
        for p in range(lattice.xi.shape[0]):
            j = lattice.neighbour[i, p]
            if j >= 0:
                Y = lattice.xi[p] + u[s, j] - u[s, i]
                strained = bond_strain(lattice, p, Y)
                inverse = share(lattice, i, j) * lattice.inverse[p]
                for q in range(count):
                    along = bond(terms.bond_kind[q], strained)[1] * inverse
                    F[s, t, lattice.bond_class[p] * count + q] -= along * Y
                if deviates(lattice, p, i, j):
                    d = deviation(lattice, p, strained, E[s, i], E[s, j])
                    k = terms.first_deviation + lattice.deviation[p]
                    F[s, t, k] -= by_own(d) * inverse * Y
                for k in range(G.shape[2]):
                    along = wp.dot(lattice.weight[p], G[s, i, k] + G[s, j, k])
                    F[s, t, terms.first_deviation + k] -= along * Y

    return force_of_each


@cache
def features(scalar):
    """Kernels of the forces of single energies: the derivative of (H8) by every coefficient."""
    return SimpleNamespace(
        stress_of_each=_stress_of_each(scalar), force_of_each=_force_of_each(scalar)
    )
