"""Energies of the corners of lattice cells: strains of a node with two neighbours.

A corner has an apex n and bonds Y₁, Y₂ along the axes, (H19). Its strain is E11 = (|Y₁|²/h² − 1)/2,
E22 likewise and 2 E12 = ± Y₁·Y₂/h². A node gathers over the twelve corners it belongs to: four as
their apex, and as the end of their first and of their second bond four each.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.hyperelastic.energies import energies
from warp_peri.kernels.hyperelastic.rows import Window
from warp_peri.kernels.hyperelastic.sweeps import parts, types

CORNER = 6
"""What a term sees (Terms.seen) that acts on corners."""
ROLES = 12
"""Of a node in corners."""


@cache
def _place(scalar):
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
def _back(scalar):
    Lattice = types(scalar).Lattice
    place = _place(scalar)

    @wp.func
    def back(lattice: Lattice, role: wp.int32):
        """Number of the bond from a node to the apex of its corner; −1 where it is the apex."""
        if role < 4:
            return wp.int32(-1)
        half = lattice.xi.shape[0] / 2
        return (place(lattice, role, role / 4 - 1) + half) % (2 * half)

    return back


@cache
def _apex(scalar):
    Lattice = types(scalar).Lattice
    place, back = _place(scalar), _back(scalar)

    @wp.func
    def apex(lattice: Lattice, role: wp.int32, a: wp.int32):
        """The apex of a node's corner; −1 where a node of the corner is missing."""
        p = back(lattice, role)
        n = a
        if p >= 0:
            n = lattice.neighbour[a, p]
        if n < 0:
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
def _sign(scalar):
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
def _share(scalar):
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
    share = _share(scalar)
    quarter = scalar(0.25)

    @wp.func
    def pull(role: wp.int32, Y1: vec, Y2: vec, inverse: scalar, sign: scalar, g: three):
        """The derivative of a quarter of Φ by the node, g = ∂Φ/∂E."""
        own = share(role)
        along = own[0] * (g[0] * Y1 + sign * g[2] * Y2) + own[1] * (g[1] * Y2 + sign * g[2] * Y1)
        return quarter * inverse * along

    return pull


@cache
def _bent(scalar):
    of = types(scalar)
    energy, vec = energies(scalar), of.vec
    three, mat = energy.vec, energy.mat
    wide = wp.types.matrix((3, 4), scalar)
    quarter, zero = scalar(0.25), scalar(0.0)

    @wp.func
    def bent(Y1: vec, Y2: vec, inverse: scalar, sign: scalar, g: three, H: mat):
        """The second derivative of a quarter of Φ by (Y₁, Y₂)."""
        t = sign * inverse
        B = wide(
            inverse * Y1[0], inverse * Y1[1], zero, zero,
            zero, zero, inverse * Y2[0], inverse * Y2[1],
            t * Y2[0], t * Y2[1], t * Y1[0], t * Y1[1],
        )  # fmt: skip
        M = wp.transpose(B) * H * B
        for d in range(2):
            M[d, d] += inverse * g[0]
            M[d + 2, d + 2] += inverse * g[1]
            M[d, d + 2] += t * g[2]
            M[d + 2, d] += t * g[2]
        return quarter * M

    return bent


@cache
def _energy(scalar):
    of = types(scalar)
    vec, Lattice, Terms = of.vec, of.Lattice, of.Terms
    place, apex, arm, sign = _place(scalar), _apex(scalar), _arm(scalar), _sign(scalar)
    strain, value = _strain(scalar), energies(scalar).value
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
                Y1 = arm(lattice, u, s, i, place(lattice, role, 0))
                Y2 = arm(lattice, u, s, i, place(lattice, role, 1))
                E = strain(Y1, Y2, lattice.inverse[0], sign(role))
                for k in range(terms.kind.shape[0]):
                    if terms.seen[k] == CORNER:
                        local = value(terms.kind[k], terms.angle[k], terms.exponent[k], E)
                        c = thick(lattice, i, i) * terms.c[terms.first_term + k]
                        total += quarter * c * local
        U[s, i] = total

    return energy_of_corners


@cache
def _force(scalar):
    of = types(scalar)
    vec, Lattice, Terms, three = of.vec, of.Lattice, of.Terms, energies(scalar).vec
    place, apex, arm, sign = _place(scalar), _apex(scalar), _arm(scalar), _sign(scalar)
    strain, pull, slope = _strain(scalar), _pull(scalar), energies(scalar).slope
    thick = parts(scalar).share

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
                Y1 = arm(lattice, u, s, n, place(lattice, role, 0))
                Y2 = arm(lattice, u, s, n, place(lattice, role, 1))
                E = strain(Y1, Y2, inverse, sign(role))
                g = three()
                for k in range(terms.kind.shape[0]):
                    if terms.seen[k] == CORNER:
                        local = slope(terms.kind[k], terms.angle[k], terms.exponent[k], E)
                        g += thick(lattice, n, n) * terms.c[terms.first_term + k] * local
                total += pull(role, Y1, Y2, inverse, sign(role), g)
        f[s, i] = total

    return force_of_corners


@cache
def _force_of_each(scalar):
    of = types(scalar)
    vec, Lattice, Terms = of.vec, of.Lattice, of.Terms
    place, apex, arm, sign = _place(scalar), _apex(scalar), _arm(scalar), _sign(scalar)
    strain, pull, slope_by = _strain(scalar), _pull(scalar), energies(scalar).slope_by
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
                Y1 = arm(lattice, u, s, n, place(lattice, role, 0))
                Y2 = arm(lattice, u, s, n, place(lattice, role, 1))
                E = strain(Y1, Y2, inverse, sign(role))
                for k in range(terms.kind.shape[0]):
                    if terms.seen[k] == CORNER:
                        g = slope_by(by, terms.kind[k], terms.angle[k], terms.exponent[k], E)
                        pulled = thick(lattice, n, n) * pull(role, Y1, Y2, inverse, sign(role), g)
                        F[s, t, terms.first_term + k] += pulled

    return force_of_each_corner


@cache
def _curved(scalar):
    of = types(scalar)
    energy = energies(scalar)
    vec, Lattice, Terms = of.vec, of.Lattice, of.Terms
    place, arm, sign = _place(scalar), _arm(scalar), _sign(scalar)
    strain, bent, slope, curve = _strain(scalar), _bent(scalar), energy.slope, energy.curve
    thick = parts(scalar).share
    three, mat = energy.vec, energy.mat

    @wp.func
    def curved(
        lattice: Lattice,
        terms: Terms,
        u: wp.array2d(dtype=vec),
        s: wp.int32,
        n: wp.int32,
        role: wp.int32,
    ):
        """The second derivative of a corner's energy by its bonds."""
        Y1 = arm(lattice, u, s, n, place(lattice, role, 0))
        Y2 = arm(lattice, u, s, n, place(lattice, role, 1))
        E = strain(Y1, Y2, lattice.inverse[0], sign(role))
        g, H = three(), mat()
        for k in range(terms.kind.shape[0]):
            if terms.seen[k] == CORNER:
                c = thick(lattice, n, n) * terms.c[terms.first_term + k]
                g += c * slope(terms.kind[k], terms.angle[k], terms.exponent[k], E)
                H += c * curve(terms.kind[k], terms.angle[k], terms.exponent[k], E)
        return bent(Y1, Y2, lattice.inverse[0], sign(role), g, H)

    return curved


@cache
def _product(scalar):
    of = types(scalar)
    vec, Lattice, Terms = of.vec, of.Lattice, of.Terms
    four = wp.types.vector(4, scalar)
    place, apex, share, curved = _place(scalar), _apex(scalar), _share(scalar), _curved(scalar)

    @wp.kernel(enable_backward=False)
    def product_of_corners(
        lattice: Lattice,
        terms: Terms,
        u: wp.array2d(dtype=vec),
        v: wp.array2d(dtype=vec),
        df: wp.array2d(dtype=vec),
    ):
        """Adds the corners' part of K v."""
        s, i = wp.tid()
        total = df[s, i]
        for role in range(ROLES):
            n = apex(lattice, role, i)
            if n >= 0:
                y1 = v[s, lattice.neighbour[n, place(lattice, role, 0)]] - v[s, n]
                y2 = v[s, lattice.neighbour[n, place(lattice, role, 1)]] - v[s, n]
                T = curved(lattice, terms, u, s, n, role) * four(y1[0], y1[1], y2[0], y2[1])
                own = share(role)
                total += own[0] * vec(T[0], T[1]) + own[1] * vec(T[2], T[3])
        df[s, i] = total

    return product_of_corners


@cache
def _rows(scalar):
    of = types(scalar)
    vec, Lattice, Terms = of.vec, of.Lattice, of.Terms
    pair = wp.types.matrix((2, 2), scalar)
    place, back, apex, share = _place(scalar), _back(scalar), _apex(scalar), _share(scalar)
    curved = _curved(scalar)

    @wp.kernel(enable_backward=False)
    def rows_of_corners(
        lattice: Lattice,
        terms: Terms,
        rows: wp.array(dtype=wp.int32),
        window: Window,
        u: wp.array2d(dtype=vec),
        K: wp.array2d(dtype=pair),
    ):
        """Adds the corners' part of the tangent, as rows_of_tangent leaves it."""
        r = wp.tid()
        a = rows[r]
        for role in range(ROLES):
            n = apex(lattice, role, a)
            if n >= 0:
                M = curved(lattice, terms, u, 0, n, role)
                own = share(role)
                column = wp.int32(window.centre)
                if role >= 4:
                    column = window.centre + window.shift[back(lattice, role)]
                for axis in range(2):
                    d = 2 * axis
                    local = own[0] * pair(M[0, d], M[0, d + 1], M[1, d], M[1, d + 1])
                    local += own[1] * pair(M[2, d], M[2, d + 1], M[3, d], M[3, d + 1])
                    far = column + window.shift[place(lattice, role, axis)]
                    K[r, far] = K[r, far] + local
                    K[r, column] = K[r, column] - local

    return rows_of_corners


@cache
def _stress(scalar):
    of = types(scalar)
    energy = energies(scalar)
    vec, Lattice, Terms, three = of.vec, of.Lattice, of.Terms, energy.vec
    pair = wp.types.matrix((2, 2), scalar)
    place, apex, arm, sign = _place(scalar), _apex(scalar), _arm(scalar), _sign(scalar)
    strain, pull, slope = _strain(scalar), _pull(scalar), energy.slope
    thick = parts(scalar).share

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
                Y1, Y2 = arm(lattice, u, s, i, p), arm(lattice, u, s, i, q)
                E = strain(Y1, Y2, inverse, sign(role))
                g = three()
                for k in range(terms.kind.shape[0]):
                    if terms.seen[k] == CORNER:
                        local = slope(terms.kind[k], terms.angle[k], terms.exponent[k], E)
                        g += thick(lattice, i, i) * terms.c[terms.first_term + k] * local
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
        product=_product(scalar),
        rows=_rows(scalar),
        stress=_stress(scalar),
    )
