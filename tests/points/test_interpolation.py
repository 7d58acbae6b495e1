"""Interpolation from scattered nodes, and fields carried to a lattice."""

import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator

from warp_peri import InputError, Points, Samples
from warp_peri.points.interpolation import interpolation, mean_spacing
from warp_peri.transfers import onto_lattice


def cloud(half=9, shift=0.35, seed=0):
    """A lattice of spacing 1 whose nodes are shifted, and its interior."""
    lattice = np.argwhere(np.ones(2 * [2 * half + 1])) - half
    shifts = np.random.default_rng(seed).uniform(-shift, shift, lattice.shape)
    return Points(lattice + shifts, np.abs(lattice).max(axis=1) <= half - 4, 0.0)


def test_it_is_the_interpolator_of_scipy_and_exact_for_quadratic_fields():
    x, y = cloud().x, np.random.default_rng(1).uniform(-5, 5, (40, 2))
    values = np.random.default_rng(2).normal(size=(len(x), 3))
    theirs = RBFInterpolator(x, values, kernel="quintic", neighbors=30)(y)
    assert interpolation(x, y, neighbours=30) @ values == pytest.approx(theirs, abs=1e-8)
    for p in ((0, 0), (1, 0), (1, 1), (0, 2)):
        assert interpolation(x, y) @ (x**p).prod(1) == pytest.approx((y**p).prod(1), abs=1e-10)


def test_fields_carried_to_a_lattice():
    points = cloud()
    assert mean_spacing(points) == pytest.approx(1.0, rel=0.05)
    wave = lambda x: np.sin(x @ (0.5, 0.4))[None, :, None] * (1.0, 0.3)
    carried = onto_lattice(Samples(points, wave(points.x), 2 * wave(points.x)), spacing=1.0)
    inside = carried.interior
    assert (carried.spacing, inside.sum() >= points.interior.sum()) == (1.0, True)
    assert np.array_equal(carried.x, np.rint(carried.x))
    assert carried.u[:, inside] == pytest.approx(wave(carried.x)[:, inside], abs=1e-3)
    assert carried.b == pytest.approx(2 * carried.u)
    assert onto_lattice(Samples(points, wave(points.x)), spacing=1.0).b is None


def test_what_cannot_be_interpolated():
    points, line = cloud(), np.stack([np.arange(50.0), np.zeros(50)], axis=1)
    few = Samples(Points(points.x[:30], np.ones(30, bool), 0.0), np.zeros((1, 30, 2)))
    for call, words in (
        (lambda: onto_lattice(few, spacing=1.0), "at least 80 nodes to interpolate from, got 30"),
        (lambda: onto_lattice(few, spacing=0.0), "spacing: expected a lattice spacing"),
        (lambda: interpolation(line, line[20:22] + 0.1, neighbours=12), "on a line or a conic"),
    ):
        with pytest.raises(InputError, match=words):
            call()
