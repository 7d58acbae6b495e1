"""Least squares under inequalities, and the coordinates of the linear solid's optimum."""

import numpy as np
from numpy.linalg import lstsq
from numpy.random import default_rng
from numpy.testing import assert_allclose

from tests.support import approx, each_refused, near, parametrize, sup
from tests.support.problems import difference
from warp_peri.fitting.regression import Settled, least_squares_above
from warp_peri.materials.lps import LPSParameters, bernstein_basis
from warp_peri.materials.lps_law import BernsteinKernel, LPSFound, LPSLaw
from warp_peri.methods import GaussNewton, StabilityConditions
from warp_peri.points.families import bond_classes

ONE = [bond_classes(1.0, 3.0)]  # 6 bond lengths
TWO = [bond_classes(1.0, 3.0), bond_classes(0.8, 3.0)]  # 6 and 9, one of them in both
back = lambda law, theta: law.found(Settled(theta, [], 0.0, [], 0.0, 0.0, 0)).solid


def test_the_optimum_is_one():
    random = default_rng(0)
    A, y = random.normal(size=(30, 8)), random.normal(size=30)
    G = random.normal(size=(20, 8))
    h = G @ random.normal(size=8) - random.uniform(size=20)
    x = least_squares_above(A, y, G, h)
    gap = G @ x - h
    assert gap.min() > -1e-9
    met = gap < 1e-8
    assert met.any()
    slope = A.T @ (A @ x - y)
    carried, *_ = lstsq(G[met].T, slope, rcond=None)
    assert_allclose(G[met].T @ carried, slope, atol=1e-8)
    assert carried.min() > -1e-8


def test_bounds_that_do_not_matter_leave_least_squares_and_impossible_ones_are_refused():
    A, y = np.diag([1.0, 2.0, 4.0]), np.array([1.0, 2.0, 4.0])
    assert_allclose(least_squares_above(A, y, np.zeros((0, 3)), np.zeros(0)), 1)
    for bound, expected in ((0.5, 1), (2.0, 2)):
        assert_allclose(least_squares_above(A, y, np.eye(3), np.full(3, bound)), expected)
    G = np.array([[1.0, 0.0], [-1.0, 0.0]])
    each_refused(lambda last, h: least_squares_above(np.diag([1.0, last]), np.zeros(2), G, h), {
        "no x": (1.0, np.ones(2)), "full column rank": (0.0, -np.ones(2)),
    })  # fmt: skip


def law_of(lattices, D):
    """The law about λ = 0.2, μ = 0.7, α = 1.4 and D, and their θ."""
    given = LPSFound(LPSParameters(0.2, 0.7, 1.4, D))
    method = GaussNewton(moduli=None, smoothness=1e-3)
    law = LPSLaw(lattices, given, StabilityConditions(zeta=0.01), method)
    return law, law.start(given)


def tables(classes, alpha, D):
    """K W / m of each class."""
    kw = classes.weight * classes.r**-alpha * (bernstein_basis(classes.r, 3.0, len(D) - 1) @ D)
    return kw / (classes.count @ (kw * classes.r**2))


# a free exponent, a redundant one, more coefficients than lengths, a constant, two lattices
@parametrize(("lattices", "degree"), [(ONE, 3), (ONE, 5), (ONE, 9), (ONE, 0), (TWO, 4)])
def test_a_point_has_its_stiffnesses_and_slopes_and_leads_back_to_its_solid(lattices, degree):
    D = default_rng(0).uniform(0.3, 1, degree + 1)
    law, theta = law_of(lattices, D)
    lengths = 6 if lattices is ONE else 14
    assert law.kernel.free_alpha == (degree + 1 < lengths)
    assert len(theta) - 1 - law.kernel.free_alpha == law.kernel.rank == min(degree + 1, lengths)
    assert not BernsteinKernel(lattices, 1.0, degree, fixed=True).free_alpha
    found, mu = law.stiffnesses(theta)
    assert (mu, theta[0]) == approx((0.7, (0.2 - 0.7) / 0.7))
    solid = back(law, theta)
    assert (solid.lam, solid.mu, solid.alpha) == approx((0.2, 0.7, 1.4))
    for classes, v in zip(lattices, found):
        expected = tables(classes, 1.4, D)
        assert_allclose(v, 0.7 * expected, atol=1e-9)
        assert_allclose(tables(classes, 1.4, solid.D), expected, atol=1e-9)
    first = lattices[0]
    volumes = [
        first.count @ (K * first.weight * first.r ** (2 - 1.4))
        for K in (bernstein_basis(first.r, 3.0, degree) @ solid.D, 1.0)
    ]
    assert volumes[0] == approx(volumes[1])
    if law.kernel.free_alpha:
        theta[-1] += 0.2  # away from where the tables were made

    def values(theta):
        at = law(theta)
        return np.concatenate([*at.p, at.margins, at.beside])

    expected, at = difference(values, theta, 1e-3).T, law(theta)
    near(np.vstack([*at.slopes, at.M, at.by]), expected, 1e-7)


def test_coefficients_that_no_bond_sees_are_smooth():
    """Of a straight line through the bond lengths, degree 9 makes a straight line."""
    D = back(*law_of(ONE, np.linspace(0.2, 1.4, 10))).D
    assert_allclose(np.diff(D, n=2), 0, atol=1e-7 * sup(D))
