"""The thickness of a sheet: positive, one at the centre, slopes by its numbers, what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from warp_peri import InputError
from warp_peri.materials.hyperelastic.from_displacement import Thickness

X = np.random.default_rng(0).uniform(-1, 3, (50, 2))


def test_it_is_a_polynomial_of_its_degree():
    even = Thickness.over(X, 2)
    assert even.names == ["x", "y", "x^2", "x y", "y^2"]
    np.testing.assert_array_equal(even.at(X), 1.0)
    uneven = replace(even, numbers=np.array([0.1, -0.2, 0.3, 0.4, -0.5]))
    p, q = ((X - uneven.centre) / uneven.half).T
    assert max(abs(p).max(), abs(q).max()) == pytest.approx(1.0)
    expected = 0.1 * p - 0.2 * q + 0.3 * p**2 + 0.4 * p * q - 0.5 * q**2
    np.testing.assert_allclose(np.log(uneven.at(X)), expected, atol=1e-14)
    assert uneven.at(uneven.centre[None]) == pytest.approx(1.0)


def test_slopes_are_central_differences():
    uneven = replace(Thickness.over(X, 3), numbers=0.3 * np.cos(np.arange(9)))
    for n, slope in enumerate(uneven.slopes(X).T):
        step = 1e-5 * np.eye(9)[n]
        ends = [replace(uneven, numbers=uneven.numbers + s * step).at(X) for s in (1, -1)]
        np.testing.assert_allclose(slope, (ends[0] - ends[1]) / 2e-5, atol=1e-8)


def test_beyond_the_largest_it_stays_as_it_is():
    steep = Thickness(1, np.zeros(2), np.ones(2), np.array([100.0, 0.0]))
    there = np.array([[1.0, 0.5], [0.1, 0.5]])
    assert steep.at(there) == pytest.approx(np.exp([20.0, 10.0]))
    np.testing.assert_array_equal(steep.slopes(there)[0], 0.0)


def test_what_is_no_thickness_is_refused():
    for degree in (7, 0, 2.0, True, "2"):
        with pytest.raises(InputError, match=f"degree: expected 1 to 6, got {degree!r}"):
            Thickness.over(X, degree)
    with pytest.raises(InputError, match=r"x: expected shape \[N, 2\], got \[2\]"):
        Thickness.over(X, 2).at(X[0])
    with pytest.raises(InputError, match=r"numbers: expected shape \[5\], got \[4\]"):
        replace(Thickness.over(X, 2), numbers=np.ones(4))
    with pytest.raises(InputError, match="half: expected two lengths > 0"):
        Thickness.over(X[:1], 2)
