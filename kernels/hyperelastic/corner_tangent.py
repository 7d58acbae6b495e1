"""The tangent of the corners of lattice cells: products with it, and its rows."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.hyperelastic.corners import (
    ROLES,
    apex_of,
    back_of,
    corner_of,
    place_of,
    share_of,
    sign_of,
)
from warp_peri.kernels.hyperelastic.energies import energies
from warp_peri.kernels.hyperelastic.parts import CORNER, parts, types
from warp_peri.kernels.hyperelastic.rows import Window


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
def _curved(scalar):
    of = types(scalar)
    energy = energies(scalar)
    vec, Lattice, Terms = of.vec, of.Lattice, of.Terms
    corner, sign, bent = corner_of(scalar), sign_of(scalar), _bent(scalar)
    slope, curve = energy.slope, energy.curve
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
        Y1, Y2, E = corner(lattice, u, s, n, role)
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
    place, apex, share, curved = (
        place_of(scalar),
        apex_of(scalar),
        share_of(scalar),
        _curved(scalar),
    )

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
    place, back, apex, share = place_of(scalar), back_of(scalar), apex_of(scalar), share_of(scalar)
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
def corner_tangents(scalar):
    """Kernels that add what corners hold to products with the tangent and to its rows, (H10)."""
    return SimpleNamespace(product=_product(scalar), rows=_rows(scalar))
