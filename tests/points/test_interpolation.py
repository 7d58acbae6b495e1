"""Interpolation from scattered nodes, and fields carried to a lattice."""

import numpy as np
import pytest

from tests.support.clouds import cloud
from warp_peri import InputError, Points, Samples
from warp_peri.transfers import mean_spacing, onto_lattice

CLOUD = cloud(11, 1.0, 0.35)


def test_quadratic_fields_are_carried_as_they_are_by_quintic_splines():
    points, powers = CLOUD, np.array([(0, 0), (1, 0), (1, 1), (0, 2)])
    fields = lambda x: np.stack([(x**p).prod(1)[:, None] * (1.0, -0.5) for p in powers])
    carried = onto_lattice(Samples(points, fields(points.x)), spacing=0.9)
    assert carried.u == pytest.approx(fields(carried.x), abs=1e-8)


def test_fields_carried_to_a_lattice():
    points = CLOUD
    assert mean_spacing(points) == pytest.approx(1.0, rel=0.05)
    wave = lambda x: np.sin(x @ (0.5, 0.4))[None, :, None] * (1.0, 0.3)
    carried = onto_lattice(Samples(points, wave(points.x), 2 * wave(points.x)), spacing=1.0)
    inside = carried.interior
    assert (carried.spacing, inside.sum() >= points.interior.sum()) == (1.0, True)
    assert np.array_equal(carried.x, np.rint(carried.x))
    assert carried.u[:, inside] == pytest.approx(wave(carried.x)[:, inside], abs=1e-3)
    assert carried.b == pytest.approx(2 * carried.u)
    assert onto_lattice(Samples(points, wave(points.x)), spacing=1.0).b is None
    left = {"seen": points.x[None, :, 0] < 0, "load_id": np.array(["a"])}
    carried = onto_lattice(Samples(points, wave(points.x)[:1], arrays=left), spacing=1.0)
    near = np.abs(carried.x[:, 0]) > 0.8
    assert np.array_equal(carried.arrays["seen"][0, near], carried.x[near, 0] < 0)
    assert carried.arrays["load_id"].tolist() == ["a"]


def test_what_cannot_be_interpolated():
    few, line = CLOUD.x[:30], np.stack([np.arange(99.0), np.zeros(99)], axis=1)
    for x, words in ((few, "at least 80 nodes to inter.*, got 30"), (line, "on a line or a conic")):
        points = Points(x, np.ones(len(x), bool), 0.0)
        with pytest.raises(InputError, match=words):
            onto_lattice(Samples(points, np.zeros((1, *x.shape))), spacing=1.0)
