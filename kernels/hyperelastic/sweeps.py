"""A hyperelastic solid on a lattice, top to bottom: strains → stresses → forces, and the energy.

Every kernel gathers: a node reads what its bonds and their far ends hold, and writes its own place.
The derivative in the displacement is the tangent, symmetric, and the force is linear in the
coefficients and in the thickness, so no tape is needed.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.hyperelastic.energies import energies
from warp_peri.kernels.hyperelastic.parts import parts, types


@cache
def _strain(scalar):
    of = types(scalar)
    part = parts(scalar)
    vec, six, Lattice = of.vec, of.six, of.Lattice
    bond_strain, known = part.bond_strain, part.known

    @wp.kernel(enable_backward=False)
    def strain(lattice: Lattice, u: wp.array2d(dtype=vec), E: wp.array2d(dtype=six)):
        """Ē_i = Σ w |ξ|² s over the family, (H3) and (H4); zero where the family is not whole."""
        s, i = wp.tid()
        total = six()
        for p in range(lattice.xi.shape[0]):
            j = lattice.neighbour[i, p]
            if j >= 0:
                strained = bond_strain(lattice, p, lattice.xi[p] + u[s, j] - u[s, i])
                total += (strained / lattice.inverse[p]) * lattice.weight[p]
        E[s, i] = known(lattice.whole[i], total)

    return strain


@cache
def _stress(scalar):
    of = types(scalar)
    energy = energies(scalar)
    part = parts(scalar)
    vec, six, Lattice, Terms = of.vec, of.six, of.Lattice, of.Terms
    bond_strain, deviates, deviation = part.bond_strain, part.deviates, part.deviation
    by_mean, seen, placed, on_short = part.by_mean, part.seen, part.placed, part.on_short
    acts, across, short, share = part.acts, part.across, part.short, part.share
    slope = energy.slope
    half, two = scalar(0.5), scalar(2.0)

    @wp.kernel(enable_backward=False)
    def stress(
        lattice: Lattice,
        terms: Terms,
        u: wp.array2d(dtype=vec),
        E: wp.array2d(dtype=six),
        G: wp.array2d(dtype=six),
    ):
        """G_i = ∂U/∂Ē_i of the strain energies and the deviations, (H7)."""
        s, i = wp.tid()
        state, own_share = E[s, i], share(lattice, i, i)
        total = six()
        for k in range(terms.kind.shape[0]):
            if acts(terms.seen[k], lattice.whole[i]):
                local = slope(
                    terms.kind[k], terms.angle[k], terms.exponent[k], seen(terms.seen[k], state)
                )
                c = own_share * terms.c[terms.first_term + k]
                total += c * placed(terms.seen[k], local)
            for side in range(2):
                j = across(lattice, terms.seen[k], side, i)
                if j >= 0:
                    own = short(state)
                    middle = half * (own + short(E[s, j]))
                    local = slope(terms.kind[k], terms.angle[k], terms.exponent[k], own)
                    local -= slope(terms.kind[k], terms.angle[k], terms.exponent[k], middle)
                    c = share(lattice, i, j) * terms.c[terms.first_term + k]
                    total += two * c * on_short(local)
        for p in range(lattice.xi.shape[0]):
            j = lattice.neighbour[i, p]
            if deviates(lattice, p, i, j):
                strained = bond_strain(lattice, p, lattice.xi[p] + u[s, j] - u[s, i])
                d = deviation(lattice, p, strained, state, E[s, j])
                c = share(lattice, i, j) * terms.c[terms.first_deviation + lattice.deviation[p]]
                total += half * c * by_mean(d) * on_short(lattice.unit[p])
        G[s, i] = total

    return stress


@cache
def _tension(scalar):
    of = types(scalar)
    energy = energies(scalar)
    part = parts(scalar)
    six, Lattice, Terms = of.six, of.Lattice, of.Terms
    deviates, deviation, by_own = part.deviates, part.deviation, part.by_own
    bond, share = energy.bond, part.share

    @wp.func
    def tension(
        lattice: Lattice,
        terms: Terms,
        p: wp.int32,
        i: wp.int32,
        j: wp.int32,
        s: scalar,
        Ei: six,
        Ej: six,
    ):
        """t = ψ′ of a bond and of its deviation, times its thickness."""
        slopes = scalar(0.0)
        count = terms.bond_kind.shape[0]
        for q in range(count):
            c = terms.c[lattice.bond_class[p] * count + q]
            slopes += c * bond(terms.bond_kind[q], s)[1]
        if deviates(lattice, p, i, j):
            d = deviation(lattice, p, s, Ei, Ej)
            slopes += terms.c[terms.first_deviation + lattice.deviation[p]] * by_own(d)
        return share(lattice, i, j) * slopes

    return tension


@cache
def _force(scalar):
    of = types(scalar)
    part = parts(scalar)
    vec, six, Lattice, Terms = of.vec, of.six, of.Lattice, of.Terms
    bond_strain = part.bond_strain
    tension = _tension(scalar)

    @wp.kernel(enable_backward=False)
    def force(
        lattice: Lattice,
        terms: Terms,
        u: wp.array2d(dtype=vec),
        E: wp.array2d(dtype=six),
        G: wp.array2d(dtype=six),
        f: wp.array2d(dtype=vec),
    ):
        """f_i = −Σ [t/|ξ|² + w·(G_i + G_j)] Y, the derivative of the energy by u_i, (H8)."""
        s, i = wp.tid()
        total = vec()
        for p in range(lattice.xi.shape[0]):
            j = lattice.neighbour[i, p]
            if j >= 0:
                Y = lattice.xi[p] + u[s, j] - u[s, i]
                strained = bond_strain(lattice, p, Y)
                t = tension(lattice, terms, p, i, j, strained, E[s, i], E[s, j])
                along = t * lattice.inverse[p]
                along += wp.dot(lattice.weight[p], G[s, i] + G[s, j])
                total -= along * Y
        f[s, i] = total

    return force


@cache
def _energy_of_nodes(scalar):
    of = types(scalar)
    energy = energies(scalar)
    part = parts(scalar)
    vec, six, Lattice, Terms = of.vec, of.six, of.Lattice, of.Terms
    bond_strain, deviates, deviation = part.bond_strain, part.deviates, part.deviation
    seen, acts, across, short = part.seen, part.acts, part.across, part.short
    value, bond, share = energy.value, energy.bond, part.share
    half, two = scalar(0.5), scalar(2.0)

    @wp.kernel(enable_backward=False)
    def energy_of_nodes(
        lattice: Lattice,
        terms: Terms,
        u: wp.array2d(dtype=vec),
        E: wp.array2d(dtype=six),
        U: wp.array2d(dtype=scalar),
    ):
        """Σ c Φ(Ē_i) and half the energy of every bond, (H1), over h²."""
        s, i = wp.tid()
        total = scalar(0.0)
        for k in range(terms.kind.shape[0]):
            if acts(terms.seen[k], lattice.whole[i]):
                local = value(
                    terms.kind[k], terms.angle[k], terms.exponent[k], seen(terms.seen[k], E[s, i])
                )
                total += share(lattice, i, i) * terms.c[terms.first_term + k] * local
            for side in range(2):
                j = across(lattice, terms.seen[k], side, i)
                if j >= 0:
                    own = short(E[s, i])
                    middle = half * (own + short(E[s, j]))
                    local = value(terms.kind[k], terms.angle[k], terms.exponent[k], own)
                    local -= value(terms.kind[k], terms.angle[k], terms.exponent[k], middle)
                    c = share(lattice, i, j) * terms.c[terms.first_term + k]
                    total += two * c * local
        count = terms.bond_kind.shape[0]
        for p in range(lattice.xi.shape[0]):
            j = lattice.neighbour[i, p]
            if j >= 0:
                strained = bond_strain(lattice, p, lattice.xi[p] + u[s, j] - u[s, i])
                part_of = half * share(lattice, i, j)
                for q in range(count):
                    c = terms.c[lattice.bond_class[p] * count + q]
                    total += part_of * c * bond(terms.bond_kind[q], strained)[0]
                if deviates(lattice, p, i, j):
                    d = deviation(lattice, p, strained, E[s, i], E[s, j])
                    c = terms.c[terms.first_deviation + lattice.deviation[p]]
                    total += part_of * half * c * d[0] * d[0] * d[2]
        U[s, i] = total

    return energy_of_nodes


@cache
def sweeps(scalar):
    """Strains, stresses, forces and energies."""
    return SimpleNamespace(
        strain=_strain(scalar),
        stress=_stress(scalar),
        force=_force(scalar),
        energy=_energy_of_nodes(scalar),
    )
