"""Coordinates of the constrained optimum: what they keep, and their derivatives."""

import numpy as np
import pytest

from tests.support.problems import GRADIENT, difference
from warp_peri.fitting.regression import Settled
from warp_peri.fitting.settings import GaussNewton, StabilityConditions
from warp_peri.materials.lps import LPSParameters
from warp_peri.materials.lps_force import bernstein_basis
from warp_peri.materials.lps_law import BernsteinKernel, LPSFound, LPSLaw
from warp_peri.points.families import bond_classes

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


def some(degree, seed=0):
    D = np.random.default_rng(seed).uniform(0.3, 1, degree + 1)
    return LPSFound(LPSParameters(0.2, 0.7, 1.4, D))


def law_of(lattices, given):
    method = GaussNewton(moduli=None, smoothness=1e-3)
    return LPSLaw(lattices, given, StabilityConditions(zeta=0.01), method)


def back(law, theta):
    at = Settled(theta, [], 0.0, [], 0.0, 0.0, 0)
    return law.found(at).solid


def tables(classes, alpha, D):
    """K W / m of each class."""
    kw = classes.weight * classes.r**-alpha * (bernstein_basis(classes.r, 3.0, len(D) - 1) @ D)
    return kw / (classes.count @ (kw * classes.r**2))


@every_case
def test_a_point_has_the_stiffnesses_of_its_parameters(lattices, degree):
    given = some(degree)
    law = law_of(lattices, given)
    theta = law.start(given)
    found, mu = law.stiffnesses(theta)
    assert mu == pytest.approx(0.7)
    assert theta[0] == pytest.approx((0.2 - 0.7) / 0.7)
    for classes, v in zip(lattices, found):
        np.testing.assert_allclose(v, 0.7 * tables(classes, 1.4, given.solid.D), atol=1e-9)


@every_case
def test_there_and_back_keeps_the_kernel_at_every_bond(lattices, degree):
    given = some(degree)
    law = law_of(lattices, given)
    solid = back(law, law.start(given))
    assert (solid.lam, solid.mu, solid.alpha) == pytest.approx((0.2, 0.7, 1.4))
    for classes in lattices:
        expected = tables(classes, 1.4, given.solid.D)
        np.testing.assert_allclose(tables(classes, 1.4, solid.D), expected, atol=1e-9)
    volumes = [
        lattices[0].count @ (K * lattices[0].weight * lattices[0].r ** (2 - 1.4))
        for K in (bernstein_basis(lattices[0].r, 3.0, degree) @ solid.D, 1.0)
    ]
    assert volumes[0] == pytest.approx(volumes[1])


@every_case
def test_derivatives(lattices, degree):
    given = some(degree)
    law = law_of(lattices, given)
    theta = law.start(given)
    if law.kernel.free_alpha:
        theta[-1] += 0.2  # away from where the tables were made

    def values(theta):
        at = law(theta)
        return np.concatenate([*at.p, at.margins, at.beside])

    expected, at = difference(values, theta, 1e-3).T, law(theta)
    derivatives = np.vstack([*at.slopes, at.M, at.by])
    assert np.abs(derivatives - expected).max() <= GRADIENT * np.abs(expected).max()


@pytest.mark.parametrize(
    ("lattices", "degree", "free"),
    [(ONE, 4, True), (ONE, 5, False), (ONE, 8, False), (TWO, 4, True)],
)
def test_the_exponent_is_free_where_coefficients_do_not_reach_every_length(lattices, degree, free):
    kernel = BernsteinKernel(lattices, 1.0, degree)
    assert kernel.free_alpha == free
    assert len(kernel.start(some(degree))) == kernel.rank + free
    assert kernel.rank == min(degree + 1, 6) if len(lattices) == 1 else degree + 1
    assert not BernsteinKernel(lattices, 1.0, degree, fixed=True).free_alpha


def test_coefficients_that_no_bond_sees_are_smooth():
    """Of a straight line through the bond lengths, degree 9 makes a straight line."""
    line = LPSFound(LPSParameters(0.2, 0.7, 1.4, np.linspace(0.2, 1.4, 10)))
    law = law_of(ONE, line)
    D = back(law, law.start(line)).D
    np.testing.assert_allclose(np.diff(D, n=2), 0, atol=1e-7 * np.abs(D).max())
