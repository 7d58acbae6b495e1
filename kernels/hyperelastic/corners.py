"""Energies of the corners of lattice cells: strains of a node with two neighbours.

A corner has an apex n and bonds Y₁, Y₂ along the axes, (H19). Its strain is E11 = (|Y₁|²/h² − 1)/2,
E22 likewise and 2 E12 = ± Y₁·Y₂/h². A node gathers over the twelve corners it belongs to: four as
their apex, and as the end of their first and of their second bond four each.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.hyperelastic.energies import energies
from warp_peri.kernels.hyperelastic.parts import CORNER, parts, types

ROLES = 12
"""Of a node in corners."""


@cache
def place_of(scalar):
    Lattice = types(scalar).Lattice

    @wp.func
    def place(lattice: Lattice, role: wp.int32, axis: wp.int32):
        """Number of a corner's bond along an axis; (0, 1) is bond 0 and (1, 0) bond 1."""
        side = role % 2
        if axis == 0:
            side = (role / 2) % 2
        return 1 - axis + side * (lattice.xi.shape[0] / 2)

    return place


@cache
def back_of(scalar):
    Lattice = types(scalar).Lattice
    place = place_of(scalar)

    @wp.func
    def back(lattice: Lattice, role: wp.int32):
        """Number of the bond from a node to the apex of its corner; −1 where it is the apex."""
        if role < 4:
            return wp.int32(-1)
        half = lattice.xi.shape[0] / 2
        return (place(lattice, role, role / 4 - 1) + half) % (2 * half)

    return back


@cache
def apex_of(scalar):
    Lattice = types(scalar).Lattice
    place, back = place_of(scalar), back_of(scalar)

    @wp.func
    def apex(lattice: Lattice, role: wp.int32, a: wp.int32):
        """The apex of a node's corner; −1 where a node is missing or the corner is left out."""
        p = back(lattice, role)
        n = a
        if p >= 0:
            n = lattice.neighbour[a, p]
        if n < 0:
            return wp.int32(-1)
        if lattice.apex[n] == 0:
            return wp.int32(-1)
        for axis in range(2):
            if lattice.neighbour[n, place(lattice, role, axis)] < 0:
                return wp.int32(-1)
        return n

    return apex


@cache
def _arm(scalar):
    of = types(scalar)
    vec, Lattice = of.vec, of.Lattice

    @wp.func
    def arm(lattice: Lattice, u: wp.array2d(dtype=vec), s: wp.int32, n: wp.int32, p: wp.int32):
        return lattice.xi[p] + u[s, lattice.neighbour[n, p]] - u[s, n]

    return arm


@cache
def sign_of(scalar):
    one = scalar(1.0)

    @wp.func
    def sign(role: wp.int32):
        """Of 2 E12: whether both bonds lead along their axes, or none."""
        if (role / 2) % 2 == role % 2:
            return one
        return -one

    return sign


@cache
def _strain(scalar):
    vec, three = types(scalar).vec, energies(scalar).vec
    half, one = scalar(0.5), scalar(1.0)

    @wp.func
    def strain(Y1: vec, Y2: vec, inverse: scalar, sign: scalar):
        return three(
            half * (inverse * wp.dot(Y1, Y1) - one),
            half * (inverse * wp.dot(Y2, Y2) - one),
            sign * inverse * wp.dot(Y1, Y2),
        )

    return strain


@cache
def corner_of(scalar):
    of = types(scalar)
    vec, Lattice = of.vec, of.Lattice
    place, arm, sign, strain = place_of(scalar), _arm(scalar), sign_of(scalar), _strain(scalar)

    @wp.func
    def corner(
        lattice: Lattice, u: wp.array2d(dtype=vec), s: wp.int32, n: wp.int32, role: wp.int32
    ):
        """A corner's two bonds as they are now, and its strain; n is its apex."""
        Y1 = arm(lattice, u, s, n, place(lattice, role, 0))
        Y2 = arm(lattice, u, s, n, place(lattice, role, 1))
        return Y1, Y2, strain(Y1, Y2, lattice.inverse[0], sign(role))

    return corner


@cache
def share_of(scalar):
    zero, one = scalar(0.0), scalar(1.0)
    vec = types(scalar).vec

    @wp.func
    def share(role: wp.int32):
        """What the bonds gain when the node moves."""
        if role < 4:
            return vec(-one, -one)
        if role < 8:
            return vec(one, zero)
        return vec(zero, one)

    return share


@cache
def _pull(scalar):
    of = types(scalar)
    vec, three = of.vec, energies(scalar).vec
    share = share_of(scalar)
    quarter = scalar(0.25)

    @wp.func
    def pull(role: wp.int32, Y1: vec, Y2: vec, inverse: scalar, sign: scalar, g: three):
        """The derivative of a quarter of Φ by the node, g = ∂Φ/∂E."""
        own = share(role)
        along = own[0] * (g[0] * Y1 + sign * g[2] * Y2) + own[1] * (g[1] * Y2 + sign * g[2] * Y1)
        return quarter * inverse * along

    return pull


@cache
def _energy(scalar):
    of = types(scalar)
    vec, Lattice, Terms = of.vec, of.Lattice, of.Terms
    apex, corner, value = apex_of(scalar), corner_of(scalar), energies(scalar).value
    thick = parts(scalar).share
    quarter = scalar(0.25)

    @wp.kernel(enable_backward=False)
    def energy_of_corners(
        lattice: Lattice, terms: Terms, u: wp.array2d(dtype=vec), U: wp.array2d(dtype=scalar)
    ):
        """Adds ¼ Σ c Φ of the corners a node is apex of, over h², (H19)."""
        s, i = wp.tid()
        total = U[s, i]
        for role in range(4):
            if apex(lattice, role, i) >= 0:
                _Y1, _Y2, E = corner(lattice, u, s, i, role)
                for k in range(terms.kind.shape[0]):
                    if terms.seen[k] == CORNER:
                        local = value(terms.kind[k], terms.angle[k], terms.exponent[k], E)
                        c = thick(lattice, i, i) * terms.c[terms.first_term + k]
                        total += quarter * c * local
        U[s, i] = total

    return energy_of_corners


@cache
def _held(scalar):
    of, energy = types(scalar), energies(scalar)
    Lattice, Terms, three, slope = of.Lattice, of.Terms, energy.vec, energy.slope
    thick = parts(scalar).share

    @wp.func
    def held(lattice: Lattice, terms: Terms, n: wp.int32, E: three):
        """The derivative of a corner's energy by its strain, n its apex."""
        g = three()
        for k in range(terms.kind.shape[0]):
            if terms.seen[k] == CORNER:
                local = slope(terms.kind[k], terms.angle[k], terms.exponent[k], E)
                g += thick(lattice, n, n) * terms.c[terms.first_term + k] * local
        return g

    return held


@cache
def _force(scalar):
    of = types(scalar)
    vec, Lattice, Terms = of.vec, of.Lattice, of.Terms
    apex, corner, sign = apex_of(scalar), corner_of(scalar), sign_of(scalar)
    pull, held = _pull(scalar), _held(scalar)

    @wp.kernel(enable_backward=False)
    def force_of_corners(
        lattice: Lattice, terms: Terms, u: wp.array2d(dtype=vec), f: wp.array2d(dtype=vec)
    ):
        """Adds what the corners of a node pull, the derivative of their energy by u_i."""
        s, i = wp.tid()
        total = f[s, i]
        inverse = lattice.inverse[0]
        for role in range(ROLES):
            n = apex(lattice, role, i)
            if n >= 0:
                Y1, Y2, E = corner(lattice, u, s, n, role)
                g = held(lattice, terms, n, E)
                total += pull(role, Y1, Y2, inverse, sign(role), g)
        f[s, i] = total

    return force_of_corners


@cache
def _force_of_each(scalar):
    of = types(scalar)
    vec, Lattice, Terms = of.vec, of.Lattice, of.Terms
    apex, corner, sign = apex_of(scalar), corner_of(scalar), sign_of(scalar)
    pull, slope_by = _pull(scalar), energies(scalar).slope_by
    thick = parts(scalar).share

    @wp.kernel(enable_backward=False)
    def force_of_each_corner(
        lattice: Lattice,
        terms: Terms,
        by: wp.int32,
        rows: wp.array(dtype=wp.int32),
        u: wp.array2d(dtype=vec),
        F: wp.array3d(dtype=vec),
    ):
        """The force of every term on corners alone on the nodes `rows`, or its derivative."""
        s, t = wp.tid()
        i = rows[t]
        inverse = lattice.inverse[0]
        for role in range(ROLES):
            n = apex(lattice, role, i)
            if n >= 0:
                Y1, Y2, E = corner(lattice, u, s, n, role)
                for k in range(terms.kind.shape[0]):
                    if terms.seen[k] == CORNER:
                        g = slope_by(by, terms.kind[k], terms.angle[k], terms.exponent[k], E)
                        pulled = thick(lattice, n, n) * pull(role, Y1, Y2, inverse, sign(role), g)
                        F[s, t, terms.first_term + k] += pulled

    return force_of_each_corner


@cache
def _stress(scalar):
    of = types(scalar)
    vec, Lattice, Terms = of.vec, of.Lattice, of.Terms
    pair = wp.types.matrix((2, 2), scalar)
    place, apex = place_of(scalar), apex_of(scalar)
    corner, sign = corner_of(scalar), sign_of(scalar)
    pull, held = _pull(scalar), _held(scalar)

    @wp.kernel(enable_backward=False)
    def stress_of_corners(
        lattice: Lattice, terms: Terms, u: wp.array2d(dtype=vec), P: wp.array2d(dtype=pair)
    ):
        """Adds Σ ∂U/∂Y ⊗ ξ over the bonds of the corners a node is apex of, (H16)."""
        s, i = wp.tid()
        total = P[s, i]
        inverse = lattice.inverse[0]
        for role in range(4):
            if apex(lattice, role, i) >= 0:
                p, q = place(lattice, role, 0), place(lattice, role, 1)
                Y1, Y2, E = corner(lattice, u, s, i, role)
                g = held(lattice, terms, i, E)
                first = pull(4, Y1, Y2, inverse, sign(role), g)
                second = pull(8, Y1, Y2, inverse, sign(role), g)
                total += wp.outer(first, lattice.xi[p]) + wp.outer(second, lattice.xi[q])
        P[s, i] = total

    return stress_of_corners


@cache
def corners(scalar):
    """Kernels that add what corners hold to what the other energies left."""
    return SimpleNamespace(
        energy=_energy(scalar),
        force=_force(scalar),
        force_of_each=_force_of_each(scalar),
        stress=_stress(scalar),
    )
