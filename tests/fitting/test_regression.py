"""Least squares under inequalities: the optimum obeys, and those it meets carry its slope."""

import numpy as np
import pytest

from warp_peri import InputError
from warp_peri.fitting.regression import least_squares_above


def test_the_optimum_is_one():
    random = np.random.default_rng(0)
    A, y = random.normal(size=(30, 8)), random.normal(size=30)
    G = random.normal(size=(20, 8))
    h = G @ random.normal(size=8) - random.uniform(size=20)
    x = least_squares_above(A, y, G, h)
    gap = G @ x - h
    assert gap.min() > -1e-9
    met = gap < 1e-8
    assert met.any()
    slope = A.T @ (A @ x - y)
    carried, *_ = np.linalg.lstsq(G[met].T, slope, rcond=None)
    np.testing.assert_allclose(G[met].T @ carried, slope, atol=1e-8)
    assert carried.min() > -1e-8


def test_no_bound_that_matters_is_plain_least_squares():
    A, y = np.diag([1.0, 2.0, 4.0]), np.array([1.0, 2.0, 4.0])
    np.testing.assert_allclose(least_squares_above(A, y, np.zeros((0, 3)), np.zeros(0)), 1)
    for bound, expected in ((0.5, 1), (2.0, 2)):
        found = least_squares_above(A, y, np.eye(3), np.full(3, bound))
        np.testing.assert_allclose(found, expected)


def test_what_cannot_be_is_refused():
    G = np.array([[1.0, 0.0], [-1.0, 0.0]])
    for last, h, words in ((1.0, np.ones(2), "no x"), (0.0, -np.ones(2), "full column rank")):
        with pytest.raises(InputError, match=words):
            least_squares_above(np.diag([1.0, last]), np.zeros(2), G, h)
