"""Types of a hyperelastic solid on a lattice, and the functions that its kernels share.

A state holds six numbers: the nodal strain, (H3), and the short one, (H4), each as E11, E22, 2 E12;
`whole` tells which of them a node has (1, 2, or both as 3).
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.hyperelastic.energies import energies

CORNER = 6
"""What a term sees (Terms.seen) that acts on corners."""


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
        seen: wp.array(dtype=wp.int32)  # 0 the strain, 1 the ripple, 2 + p its step, CORNER
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
    corner = wp.constant(CORNER)

    @wp.func
    def across(lattice: Lattice, seen: wp.int32, side: wp.int32, i: wp.int32):
        """Far end of the bond that a term acts across, on one side of a node; −1 for none."""
        if seen < 2 or seen >= corner:
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
