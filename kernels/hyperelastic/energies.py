"""Strain energies Φ(E) and bond energies ψ(s) with first and second derivatives, (H5) and (H2).

E holds E11, E22 and 2 E12. The numbers of the kinds are those of tissue/solid.py.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp


@cache
def _area(scalar):
    vec = wp.types.vector(3, scalar)
    one, two = scalar(1.0), scalar(2.0)

    @wp.func
    def area(E: vec):
        """det C, C = I + 2 E."""
        return (one + two * E[0]) * (one + two * E[1]) - E[2] * E[2]

    return area


@cache
def _area_slope(scalar):
    vec = wp.types.vector(3, scalar)
    one, two = scalar(1.0), scalar(2.0)

    @wp.func
    def area_slope(E: vec):
        return vec(two * (one + two * E[1]), two * (one + two * E[0]), -two * E[2])

    return area_slope


@cache
def _area_curve(scalar):
    mat = wp.types.matrix((3, 3), scalar)
    zero, two = scalar(0.0), scalar(2.0)

    @wp.func
    def area_curve():
        four = scalar(4.0)
        return mat(zero, four, zero, four, zero, zero, zero, zero, -two)

    return area_curve


@cache
def _direction(scalar):
    vec = wp.types.vector(3, scalar)
    two = scalar(2.0)

    @wp.func
    def direction(angle: scalar):
        """m with m·E = 2 n·E n = I4 − 1."""
        c, s = wp.cos(angle), wp.sin(angle)
        return vec(two * c * c, two * s * s, two * c * s)

    return direction


@cache
def _of_area(scalar):
    vec = wp.types.vector(3, scalar)
    zero, half, one, two = scalar(0.0), scalar(0.5), scalar(1.0), scalar(2.0)

    @wp.func
    def of_area(kind: wp.int32, D: scalar):
        """f, f′ and f″ of the energies f(D) + trace part."""
        if kind == 6:
            return vec(wp.log(D), one / D, -one / (D * D))
        if kind == 7:
            return vec(D, one, zero)
        if kind == 8:
            return vec(one / D, -one / (D * D), two / (D * D * D))
        if kind == 9:
            return vec(-wp.log(D), -one / D, one / (D * D))
        if kind == 10:
            return vec(half * (D - one) - half * wp.log(D), half - half / D, half / (D * D))
        return vec(one / D - one, -one / (D * D), two / (D * D * D))

    return of_area


@cache
def _of_fibre(scalar):
    vec = wp.types.vector(3, scalar)
    zero, half, one, two = scalar(0.0), scalar(0.5), scalar(1.0), scalar(2.0)

    @wp.func
    def of_fibre(kind: wp.int32, p: scalar, x: scalar):
        """φ, φ′ and φ″ of x = ⟨I4 − 1⟩."""
        if x <= zero:
            return vec(zero, zero, zero)
        if kind == 12:
            below = wp.pow(x, p - two)
            return vec(below * x * x / p, below * x, (p - one) * below)
        growth = wp.exp(p * x * x)
        value = half * x * x
        if p > scalar(1.0e-8):
            value = (growth - one) / (two * p)
        return vec(value, x * growth, growth * (one + two * p * x * x))

    return of_fibre


@cache
def _quadratic(scalar):
    mat = wp.types.matrix((3, 3), scalar)
    zero, one, two = scalar(0.0), scalar(1.0), scalar(2.0)

    @wp.func
    def quadratic(kind: wp.int32):
        """A of ½ E·A E for the quadratics, trace, shear."""
        if kind == 0:
            return mat(two, zero, zero, zero, zero, zero, zero, zero, zero)
        if kind == 1:
            return mat(zero, zero, zero, zero, two, zero, zero, zero, zero)
        if kind == 2:
            return mat(zero, zero, zero, zero, zero, zero, zero, zero, two)
        if kind == 3:
            return mat(zero, one, zero, one, zero, zero, zero, zero, zero)
        if kind == 4:
            return mat(zero, zero, one, zero, zero, zero, one, zero, zero)
        if kind == 5:
            return mat(zero, zero, zero, zero, zero, one, zero, one, zero)
        if kind == 14:
            return mat(one, one, zero, one, one, zero, zero, zero, zero)
        return mat(one, -one, zero, -one, one, zero, zero, zero, one)

    return quadratic


@cache
def _value(scalar):
    vec = wp.types.vector(3, scalar)
    half, one, two = scalar(0.5), scalar(1.0), scalar(2.0)
    area, direction, of_area = _area(scalar), _direction(scalar), _of_area(scalar)
    of_fibre, quadratic = _of_fibre(scalar), _quadratic(scalar)

    @wp.func
    def value(kind: wp.int32, angle: scalar, p: scalar, E: vec):
        if kind >= 6 and kind <= 11:
            total = of_area(kind, area(E))[0]
            if kind == 9 or kind == 11:
                total += two * (E[0] + E[1])
            return total
        if kind == 17:
            D = area(E)
            return D + two * (one + E[0] + E[1]) / D - scalar(3.0)
        if kind == 18:
            over = wp.max(two * (one + E[0] + E[1]) + one / area(E) - scalar(3.0), scalar(0.0))
            return wp.pow(over, p)
        if kind == 12 or kind == 13:
            return of_fibre(kind, p, wp.dot(direction(angle), E))[0]
        if kind == 16:
            x = wp.dot(direction(angle), E)
            return half * x * x
        return half * wp.dot(E, quadratic(kind) * E)

    return value


@cache
def _slope(scalar):
    vec = wp.types.vector(3, scalar)
    zero, one, two = scalar(0.0), scalar(1.0), scalar(2.0)
    area, area_slope, direction = _area(scalar), _area_slope(scalar), _direction(scalar)
    of_area, of_fibre, quadratic = _of_area(scalar), _of_fibre(scalar), _quadratic(scalar)

    @wp.func
    def slope(kind: wp.int32, angle: scalar, p: scalar, E: vec):
        """∂Φ/∂E."""
        if kind >= 6 and kind <= 11:
            total = of_area(kind, area(E))[1] * area_slope(E)
            if kind == 9 or kind == 11:
                total += vec(two, two, zero)
            return total
        if kind == 17:
            D = area(E)
            by_area = one - two * (one + E[0] + E[1]) / (D * D)
            return by_area * area_slope(E) + vec(two / D, two / D, zero)
        if kind == 18:
            D = area(E)
            over = wp.max(two * (one + E[0] + E[1]) + one / D - scalar(3.0), zero)
            return p * wp.pow(over, p - one) * (vec(two, two, zero) - area_slope(E) / (D * D))
        if kind == 12 or kind == 13:
            m = direction(angle)
            return of_fibre(kind, p, wp.dot(m, E))[1] * m
        if kind == 16:
            m = direction(angle)
            return wp.dot(m, E) * m
        return quadratic(kind) * E

    return slope


@cache
def _curve(scalar):
    vec = wp.types.vector(3, scalar)
    zero, one, two = scalar(0.0), scalar(1.0), scalar(2.0)
    area, area_slope, area_curve = _area(scalar), _area_slope(scalar), _area_curve(scalar)
    direction, of_area, of_fibre = _direction(scalar), _of_area(scalar), _of_fibre(scalar)
    quadratic = _quadratic(scalar)

    @wp.func
    def curve(kind: wp.int32, angle: scalar, p: scalar, E: vec):
        """∂²Φ/∂E²."""
        if kind >= 6 and kind <= 11:
            f, d = of_area(kind, area(E)), area_slope(E)
            return f[2] * wp.outer(d, d) + f[1] * area_curve()
        if kind == 17:
            D, d, e = area(E), area_slope(E), vec(two, two, zero)
            T = two * (one + E[0] + E[1])
            mixed = (wp.outer(d, e) + wp.outer(e, d)) / (D * D)
            own = two * T / (D * D * D) * wp.outer(d, d) + (one - T / (D * D)) * area_curve()
            return own - mixed
        if kind == 18:
            D, d = area(E), area_slope(E)
            over = wp.max(two * (one + E[0] + E[1]) + one / D - scalar(3.0), zero)
            e = vec(two, two, zero) - d / (D * D)
            bent = two / (D * D * D) * wp.outer(d, d) - area_curve() / (D * D)
            return p * wp.pow(over, p - two) * ((p - one) * wp.outer(e, e) + over * bent)
        if kind == 12 or kind == 13:
            m = direction(angle)
            return of_fibre(kind, p, wp.dot(m, E))[2] * wp.outer(m, m)
        if kind == 16:
            m = direction(angle)
            return wp.outer(m, m)
        return quadratic(kind)

    return curve


@cache
def _slope_by_angle(scalar):
    vec = wp.types.vector(3, scalar)
    two = scalar(2.0)
    direction, of_fibre = _direction(scalar), _of_fibre(scalar)

    @wp.func
    def slope_by_angle(kind: wp.int32, angle: scalar, p: scalar, E: vec):
        """∂²Φ/∂E∂(angle) of a fibre."""
        c, s = wp.cos(angle), wp.sin(angle)
        m = direction(angle)
        turned = vec(-two * two * c * s, two * two * c * s, two * (c * c - s * s))
        f = of_fibre(kind, p, wp.dot(m, E))
        return f[2] * wp.dot(turned, E) * m + f[1] * turned

    return slope_by_angle


@cache
def _slope_by_exponent(scalar):
    vec = wp.types.vector(3, scalar)
    zero, one = scalar(0.0), scalar(1.0)
    direction = _direction(scalar)

    @wp.func
    def slope_by_exponent(kind: wp.int32, angle: scalar, p: scalar, E: vec):
        """∂²Φ/∂E∂p of a fibre."""
        m = direction(angle)
        x = wp.dot(m, E)
        if x <= zero:
            return vec(zero, zero, zero)
        if kind == 12:
            return wp.pow(x, p - one) * wp.log(x) * m
        return x * x * x * wp.exp(p * x * x) * m

    return slope_by_exponent


@cache
def _slope_by(scalar):
    vec = wp.types.vector(3, scalar)
    slope, slope_by_angle = _slope(scalar), _slope_by_angle(scalar)
    slope_by_exponent = _slope_by_exponent(scalar)

    @wp.func
    def slope_by(by: wp.int32, kind: wp.int32, angle: scalar, p: scalar, E: vec):
        """∂Φ/∂E, or its derivative by a fibre's angle (by = 1) or exponent (2)."""
        if by == 0:
            return slope(kind, angle, p, E)
        if kind != 12 and kind != 13:
            return vec()
        if by == 1:
            return slope_by_angle(kind, angle, p, E)
        return slope_by_exponent(kind, angle, p, E)

    return slope_by


@cache
def _bond(scalar):
    vec = wp.types.vector(3, scalar)
    zero, half, one, two = scalar(0.0), scalar(0.5), scalar(1.0), scalar(2.0)

    @wp.func
    def bond(kind: wp.int32, s: scalar):
        """ψ, ψ′ and ψ″."""
        third = scalar(1.0) / scalar(3.0)
        if kind == 0:
            return vec(half * s * s, s, one)
        if kind == 1:
            return vec(third * s * s * s, s * s, two * s)
        if kind == 4:
            stretch = one + two * s
            return vec(s - half * wp.log(stretch), one - one / stretch, two / (stretch * stretch))
        if kind == 5:
            if s < zero:
                return vec(half * s * s, s, one)
            return vec(zero, zero, zero)
        if s <= zero:
            return vec(zero, zero, zero)
        if kind == 2:
            return vec(half * s * s, s, one)
        return vec(third * s * s * s, s * s, two * s)

    return bond


@cache
def energies(scalar):
    """The functions in one precision."""
    vec, mat = wp.types.vector(3, scalar), wp.types.matrix((3, 3), scalar)
    return SimpleNamespace(
        vec=vec,
        mat=mat,
        area=_area(scalar),
        value=_value(scalar),
        slope=_slope(scalar),
        curve=_curve(scalar),
        slope_by=_slope_by(scalar),
        bond=_bond(scalar),
    )
