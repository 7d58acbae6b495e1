"""Coordinates of the constrained optimum: what they keep, and their derivatives."""

import numpy as np
import pytest

from tests.support.problems import GRADIENT, difference
from warp_peri.materials.lps import bernstein_basis
from warp_peri.points.families import bond_classes
from warp_peri.regression.coordinates import Coordinates, Parameters

ONE = [bond_classes(1.0, 3.0)]  # 6 bond lengths
TWO = [bond_classes(1.0, 3.0), bond_classes(0.8, 3.0)]  # 6 and 9, one of them in both
CASES = {
    "free exponent": (ONE, 3),
    "redundant exponent": (ONE, 5),
    "more coefficients than lengths": (ONE, 9),
    "constant": (ONE, 0),
    "two lattices": (TWO, 4),
}
every_case = pytest.mark.parametrize(("lattices", "degree"), CASES.values(), ids=CASES)


def some_parameters(degree, seed=0):
    D = np.random.default_rng(seed).uniform(0.3, 1, degree + 1)
    return Parameters(0.2, 0.7, 1.4, D)


def tables(classes, alpha, D):
    """K W / m of each class."""
    kw = classes.weight * classes.r**-alpha * (bernstein_basis(classes.r, 3.0, len(D) - 1) @ D)
    return kw / (classes.count @ (kw * classes.r**2))


@every_case
def test_a_point_has_the_stiffnesses_of_its_parameters(lattices, degree):
    given = some_parameters(degree)
    coordinates = Coordinates(lattices, given.alpha, degree)
    point = coordinates.point(coordinates.start(given))
    assert (point.mu, point.alpha) == pytest.approx((0.7, 1.4))
    assert point.kappa == pytest.approx((0.2 - 0.7) / 0.7**2)
    for classes, v in zip(lattices, point.v):
        np.testing.assert_allclose(v, 0.7 * tables(classes, 1.4, given.D), atol=1e-9)


@every_case
def test_there_and_back_keeps_the_kernel_at_every_bond(lattices, degree):
    given = some_parameters(degree)
    coordinates = Coordinates(lattices, given.alpha, degree)
    back = coordinates.parameters(coordinates.start(given), [0.5])
    assert (back.lam, back.mu, back.alpha) == pytest.approx((0.2, 0.7, 1.4))
    assert back.losses == [0.5]
    for classes in lattices:
        expected = tables(classes, 1.4, given.D)
        np.testing.assert_allclose(tables(classes, 1.4, back.D), expected, atol=1e-9)
    volumes = [
        lattices[0].count @ (K * lattices[0].weight * lattices[0].r ** (2 - 1.4))
        for K in (bernstein_basis(lattices[0].r, 3.0, degree) @ back.D, 1.0)
    ]
    assert volumes[0] == pytest.approx(volumes[1])


@every_case
def test_derivatives(lattices, degree):
    given = some_parameters(degree)
    coordinates = Coordinates(lattices, given.alpha, degree)
    y = coordinates.start(given)
    if coordinates.free_alpha:
        y[-1] += 0.2  # away from where the tables were made
    point = coordinates.point(y)

    def values(y):
        point = coordinates.point(y)
        rough, _ = coordinates.roughness(y, point)
        return np.concatenate([[point.kappa, point.mu, point.alpha], *point.v, rough])

    expected = difference(values, y, 1e-3).T
    kappa, alpha = np.eye(len(y))[[0, -1]]
    alpha = alpha * coordinates.free_alpha
    _, rough = coordinates.roughness(y, point)
    derivatives = np.vstack([kappa, point.dmu, alpha, *point.dv, rough])
    assert np.abs(derivatives - expected).max() <= GRADIENT * np.abs(expected).max()


@pytest.mark.parametrize(
    ("lattices", "degree", "free"),
    [(ONE, 4, True), (ONE, 5, False), (ONE, 8, False), (TWO, 4, True)],
)
def test_the_exponent_is_free_where_coefficients_do_not_reach_every_length(lattices, degree, free):
    coordinates = Coordinates(lattices, 1.0, degree)
    assert coordinates.free_alpha == free
    assert len(coordinates.start(some_parameters(degree))) == 1 + coordinates.rank + free
    assert coordinates.rank == min(degree + 1, 6) if len(lattices) == 1 else degree + 1


def test_coefficients_that_no_bond_sees_are_smooth():
    """Of a straight line through the bond lengths, degree 9 makes a straight line."""
    line = Parameters(0.2, 0.7, 1.4, np.linspace(0.2, 1.4, 10))
    coordinates = Coordinates(ONE, 1.4, 9)
    back = coordinates.parameters(coordinates.start(line), [])
    np.testing.assert_allclose(np.diff(back.D, n=2), 0, atol=1e-7 * np.abs(back.D).max())
