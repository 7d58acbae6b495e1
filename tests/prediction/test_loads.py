"""Loads to learn from: they hold all waves."""

import numpy as np
import pytest

import warp_peri as wp
from tests.support.problems import lattice
from warp_peri.prediction import design_loads


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
