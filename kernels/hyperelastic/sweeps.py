"""A hyperelastic solid on a lattice, top to bottom: strains → stresses → forces, and the tangent.

Every kernel gathers: a node reads what its bonds and their far ends hold, and writes its own place.
The derivative in the displacement is the tangent, symmetric, and the force is linear in the
coefficients and in the thickness, so no tape is needed. A state holds six numbers: the nodal
strain, (H3), and the short one, (H4), each as E11, E22, 2 E12; `whole` tells which of them a node
has (1, 2, or both as 3).
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.hyperelastic.energies import energies


@cache
def types(scalar):
    """The types of one precision; Lattice holds the bonds of every node, Terms the energies."""
    vec = wp.types.vector(2, scalar)
    six = wp.types.vector(6, scalar)
    block = wp.types.matrix((6, 6), scalar)

    @wp.struct
    class Lattice:
        neighbour: wp.array2d(dtype=wp.int32)  # −1 where there is none, shape [N, B]
        whole: wp.array(dtype=wp.int32)
        apex: wp.array(dtype=wp.int32)  # 0 where the corners at a node are left out
        xi: wp.array(dtype=vec)
        inverse: wp.array(dtype=scalar)  # 1/|ξ|²
        weight: wp.array(dtype=six)  # w of both strains
        unit: wp.array(dtype=energies(scalar).vec)  # ê with ê·E = ξ·Eξ/|ξ|²
        bond_class: wp.array(dtype=wp.int32)
        deviation: wp.array(dtype=wp.int32)  # number of its deviation energy, or −1
        thickness: wp.array(dtype=scalar)  # of every node; empty for an even sheet

    @wp.struct
    class Terms:
        bond_kind: wp.array(dtype=wp.int32)
        kind: wp.array(dtype=wp.int32)
        seen: wp.array(dtype=wp.int32)  # 0 the strain, 1 the ripple, 2 + p its step, 6 corners
        angle: wp.array(dtype=scalar)
        exponent: wp.array(dtype=scalar)
        c: wp.array(dtype=scalar)  # all coefficients
        first_deviation: wp.int32
        first_term: wp.int32
        local: wp.int32  # whether anything acts on short strains alone

    return SimpleNamespace(vec=vec, six=six, block=block, Lattice=Lattice, Terms=Terms)


@cache
def _bond_strain(scalar):
    of = types(scalar)
    vec, Lattice = of.vec, of.Lattice
    half, one = scalar(0.5), scalar(1.0)

    @wp.func
    def bond_strain(lattice: Lattice, p: wp.int32, Y: vec):
        """s = (|Y|²/|ξ|² − 1)/2, (H2)."""
        return half * (wp.dot(Y, Y) * lattice.inverse[p] - one)

    return bond_strain


@cache
def _share(scalar):
    of = types(scalar)
    Lattice = of.Lattice
    half, one = scalar(0.5), scalar(1.0)

    @wp.func
    def share(lattice: Lattice, i: wp.int32, j: wp.int32):
        """Mean thickness of two nodes, (H18)."""
        if lattice.thickness.shape[0] == 0:
            return one
        return half * (lattice.thickness[i] + lattice.thickness[j])

    return share


@cache
def _first(scalar):
    of = types(scalar)
    energy = energies(scalar)
    six = of.six
    three = energy.vec

    @wp.func
    def first(E: six):
        return three(E[0], E[1], E[2])

    return first


@cache
def _short(scalar):
    of = types(scalar)
    energy = energies(scalar)
    six = of.six
    three = energy.vec

    @wp.func
    def short(E: six):
        return three(E[3], E[4], E[5])

    return short


@cache
def _seen(scalar):
    of = types(scalar)
    six = of.six
    first, short = _first(scalar), _short(scalar)

    @wp.func
    def seen(ripple: wp.int32, E: six):
        """The strain that a term acts on."""
        if ripple == 1:
            return first(E) - short(E)
        return first(E)

    return seen


@cache
def _placed(scalar):
    of = types(scalar)
    energy = energies(scalar)
    six = of.six
    three = energy.vec

    @wp.func
    def placed(ripple: wp.int32, g: three):
        """A derivative by what a term acts on, as one by the state."""
        if ripple == 1:
            return six(g[0], g[1], g[2], -g[0], -g[1], -g[2])
        return six(g[0], g[1], g[2], scalar(0.0), scalar(0.0), scalar(0.0))

    return placed


@cache
def _on_short(scalar):
    of = types(scalar)
    energy = energies(scalar)
    six = of.six
    three = energy.vec

    @wp.func
    def on_short(g: three):
        return six(scalar(0.0), scalar(0.0), scalar(0.0), g[0], g[1], g[2])

    return on_short


@cache
def _known(scalar):
    of = types(scalar)
    six = of.six
    short, on_short = _short(scalar), _on_short(scalar)
    zero = scalar(0.0)

    @wp.func
    def known(whole: wp.int32, E: six):
        """A sum over the bonds there are, zero in the strains whose family is not whole."""
        kept = E
        if whole % 2 == 0:
            kept = on_short(short(kept))
        if whole < 2:
            kept = six(kept[0], kept[1], kept[2], zero, zero, zero)
        return kept

    return known


@cache
def _acts(scalar):

    @wp.func
    def acts(ripple: wp.int32, whole: wp.int32):
        """Whether a node has the strains that its own term needs."""
        return ripple < 2 and (whole == 3 or (ripple == 0 and whole == 1))

    return acts


@cache
def _across(scalar):
    of = types(scalar)
    Lattice = of.Lattice

    @wp.func
    def across(lattice: Lattice, seen: wp.int32, side: wp.int32, i: wp.int32):
        """Far end of the bond that a term acts across, on one side of a node; −1 for none."""
        if seen < 2 or seen > 5:
            return wp.int32(-1)
        j = lattice.neighbour[i, seen - 2 + side * (lattice.xi.shape[0] / 2)]
        if j < 0:
            return wp.int32(-1)
        if lattice.whole[i] < 2 or lattice.whole[j] < 2:
            return wp.int32(-1)
        return j

    return across


@cache
def _deviates(scalar):
    of = types(scalar)
    Lattice = of.Lattice

    @wp.func
    def deviates(lattice: Lattice, p: wp.int32, i: wp.int32, j: wp.int32):
        if j < 0 or lattice.deviation[p] < 0:
            return False
        return lattice.whole[i] >= 2 and lattice.whole[j] >= 2

    return deviates


@cache
def _deviation(scalar):
    of = types(scalar)
    energy = energies(scalar)
    six = of.six
    three = energy.vec
    Lattice = of.Lattice
    half, one, two = scalar(0.5), scalar(1.0), scalar(2.0)
    short = _short(scalar)

    @wp.func
    def deviation(lattice: Lattice, p: wp.int32, s: scalar, Ei: six, Ej: six):
        """d of (H6), 1/(1 + 2 s) and 1/(1 + 2 m), m the short strain of the ends along the bond."""
        own = one + two * s
        mean = one + wp.dot(lattice.unit[p], short(Ei) + short(Ej))
        return three(half * wp.log(own / mean), one / own, one / mean)

    return deviation


@cache
def _by_own(scalar):
    energy = energies(scalar)
    three = energy.vec

    @wp.func
    def by_own(d: three):
        """The derivative of ½ d²/(1 + 2 m) by s."""
        return d[0] * d[1] * d[2]

    return by_own


@cache
def _by_mean(scalar):
    energy = energies(scalar)
    three = energy.vec
    one = scalar(1.0)

    @wp.func
    def by_mean(d: three):
        """The derivative of ½ d²/(1 + 2 m) by m."""
        return -d[0] * (one + d[0]) * d[2] * d[2]

    return by_mean


@cache
def parts(scalar):
    """Functions that the kernels share."""
    return SimpleNamespace(
        deviation=_deviation(scalar),
        by_own=_by_own(scalar),
        by_mean=_by_mean(scalar),
        bond_strain=_bond_strain(scalar),
        share=_share(scalar),
        first=_first(scalar),
        short=_short(scalar),
        seen=_seen(scalar),
        placed=_placed(scalar),
        on_short=_on_short(scalar),
        known=_known(scalar),
        acts=_acts(scalar),
        across=_across(scalar),
        deviates=_deviates(scalar),
    )


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
                    terms.kind[k],
                    terms.angle[k],
                    terms.exponent[k],
                    seen(terms.seen[k], E[s, i]),
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
