"""One influence function for many lattices."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.problems import kernel
from warp_peri import InputError
from warp_peri.lps.symbol import moduli
from warp_peri.points.families import bond_classes
from warp_peri.transfer.lattice import dispersion, rings, wave_errors
from warp_peri.transfer.shared_kernel import _fitted_on
from warp_peri.transfers import one_kernel

HOME = replace(kernel("1/r", 3.0), largest_wave_number=2.0)


@pytest.fixture(scope="module")
def many():
    return one_kernel(HOME, horizon=3.0, ratios=(0.25, 0.33), degree=8)


def test_it_holds_between_the_lattices_it_was_fitted_on(many):
    record = many.provenance["many_lattices"]
    waves = rings(np.linspace(0.1, 2 * np.pi / record["waves_longer_than"], 8))
    for ratio, most in zip(record["h_over_horizon"], record["largest_error"]):
        assert not np.isclose(ratio, _fitted_on(0.25, 0.33)).any()
        wrong = wave_errors(dispersion(many, 3.0 * ratio, waves), dispersion(HOME, 1.0, waves))
        assert wrong.max() <= 1.2 * most + 1e-3
    assert max(record["mean_error"]) < 0.04
    bounds = [figures["symbol_bound"] for figures in many.certificate.values()]
    assert min(bounds) >= 0.0099


def test_moduli_hold_on_every_lattice(many):
    home = moduli(HOME, bond_classes(1.0, 3.0))
    for ratio in np.linspace(0.25, 0.33, 23):
        here = moduli(many, bond_classes(3.0 * ratio, 3.0))
        assert here["C44"] == pytest.approx(home["C44"], rel=0.02)


def test_lattices_are_fitted_where_weights_jump():
    ratios = _fitted_on(0.11, 0.3)
    for squares in (13, 16, 20, 25, 64):
        assert np.isclose(1 / np.sqrt(squares), ratios).any()  # with bonds of that length
    assert len(ratios) < 80
    assert min(ratios) < 0.11
    assert max(ratios) > 0.3


def test_ratios_that_are_none():
    with pytest.raises(InputError, match="ratios: expected"):
        one_kernel(HOME, horizon=3.0, ratios=(0.3, 0.6))
