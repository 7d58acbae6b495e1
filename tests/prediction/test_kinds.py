"""Predictions on every kind of points and rich member that has one; the others are refused."""

from dataclasses import replace

import numpy as np
import pytest

import warp_peri as wp
from tests.crystal.test_operator import body, learned
from tests.support.problems import kernel, lattice, manufactured
from warp_peri.prediction import CalibrationFactors, Ensemble, EnsembleMaterial, design_loads

HORIZON, APART = 3.0, 0.02
pytestmark = pytest.mark.filterwarnings("ignore:transferred:UserWarning")


def ensemble(rich, *numbers):
    """A second member 1 % stiffer than the rich one, and halves 2 % to either side."""
    second, *halves = (
        replace(rich, **{name: getattr(rich, name) * f for name in numbers})
        for f in (1.01, 1.02, 0.98)
    )
    plain = CalibrationFactors(1.0, 1.0, 0.0)
    return EnsembleMaterial(rich, second, tuple(halves), factors=plain)


@pytest.fixture(scope="module")
def family():
    """Of a certified linear solid."""
    rich = kernel("positive", HORIZON)
    rich = replace(rich, certificate={"1": wp.certify(rich, spacing=1.0).figures()})
    return ensemble(rich, "lam", "mu")


def asked(points):
    """A load along x and a collar that is held."""
    b = np.zeros_like(points.x)
    b[:, 0] = 1e-3
    return wp.Dirichlet(points, b, 0 * b)


def check(family, points):
    """Half of the doubts' squares: waves 1 %, data 2 % times √2."""
    answer = wp.predict(family, asked(points), None)
    assert answer.uncovered == ()
    expected = np.sqrt((0.01**2 + 2 * APART**2) / 2)
    assert answer.error == pytest.approx(expected, rel=0.15)
    assert answer.corrected.shape == points.x.shape
    assert answer.map()[points.interior].min() >= 0


@pytest.mark.parametrize("how", [{"spacing": 0.8}, {"angle": 0.3}])
def test_other_and_turned_lattices(family, how):
    check(family, lattice(9, HORIZON, **how))


def test_crystals_in_space():
    check(ensemble(learned(3), "tensors"), body(3, "cube"))


def test_what_data_hold_nothing_of_is_named(family):
    points = lattice(9, HORIZON)
    strained = replace(family, strain=1e-6, quadratic=7 * (0.1,))
    answer = wp.predict(strained, asked(points), 1.0)
    assert "of the data of a linear law" in answer.uncovered[0]
    assert not answer.kept
    law = wp.LPS(HORIZON, wp.Bernstein(1))
    long = manufactured(kernel("positive", HORIZON), lattice(10, HORIZON), 4, wave_number=0.25)
    learned = wp.fit(long, Ensemble(law), progress=False).material
    short = manufactured(kernel("positive", HORIZON), lattice(10, HORIZON), 1, wave_number=2.0)
    answer = wp.predict(learned, wp.Dirichlet(short, short.b[0], short.u[0]), None)
    assert any(one.startswith("short waves") for one in answer.uncovered)
    assert np.isnan(answer.error)
    assert np.isnan(answer.map()[short.interior]).all()
    assert not answer.kept


def test_designed_loads_hold_all_waves_without_a_mean():
    sheet = wp.Points.sheet((20, 20), 5.0)
    loads = design_loads(sheet, shortest_wave=20.0)
    assert loads.shape == (2, 400, 2)
    assert np.abs(loads.mean(axis=1)).max() < 1e-12
    assert np.linalg.norm(loads, axis=-1).max() == pytest.approx(1)
    power = np.abs(np.fft.fft2(loads[0].reshape(20, 20, 2), axes=(0, 1))).sum(axis=-1)
    k = np.hypot(*np.meshgrid(*2 * [np.fft.fftfreq(20)]))
    held = power > 1e-9 * power.max()
    assert held[(k > 0) & (k <= 0.25)].all()
    assert not held[k > 0.25 + 1e-9].any()
    with pytest.raises(wp.InputError, match="box"):
        design_loads(lattice(4, 1.0), 3.0)
