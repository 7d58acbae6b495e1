"""Bands without fields of noise: coverage on data of known truth, one signature, refusals."""

import dataclasses

import numpy as np
import pytest

import warp_peri as wp
from tests.support.problems import lattice
from warp_peri.methods import resample_loads
from warp_peri.micromodulus.learning import fit_symbol

HORIZON, NOISE, LOADS = 2.0, 0.1, 10
MODULI = wp.micromodulus.from_voigt([[1.0, 0.3, 0.0], [0.3, 1.0, 0.0], [0.0, 0.0, 0.5]])
LAW = wp.Micromodulus(HORIZON, "4mm", moduli=None)
WAVES = np.array([[0.3, 0.1], [0.6, 0.5], [1.0, 0.2]])


def known():
    """A crystal on a lattice of spacing 1, dispersive."""

    def symbol(k):
        local = np.einsum("ijkl,nj,nl->nik", MODULI, k, k)
        return local * (1 - 0.03 * (k**2).sum(axis=1))[:, None, None]

    return fit_symbol(symbol, 1.0, HORIZON, symmetry="4mm", tensor=MODULI)


TRUTH = known()
POINTS = dataclasses.replace(lattice(6, HORIZON, 1.0), axis=0.0)


def noisy(seed):
    """Loads of random waves; each load's own noise on its forces, of any size."""
    rng = np.random.default_rng(seed)
    k = rng.uniform(0.2, 1.2, (LOADS, 1, 2)) * rng.choice([-1, 1], (LOADS, 1, 2))
    phase = (POINTS.x[None] * k).sum(axis=2) + rng.uniform(0, 6, (LOADS, 1))
    u = 0.01 * rng.normal(size=(LOADS, 1, 2)) * np.cos(phase)[:, :, None]
    b = np.zeros_like(u)
    b[:, POINTS.interior] = TRUTH.on(POINTS)(u)
    size = (
        NOISE * np.sqrt((b[:, POINTS.interior] ** 2).mean()) * rng.uniform(0.5, 1.5, (LOADS, 1, 1))
    )
    b[:, POINTS.interior] += size * rng.normal(size=b[:, POINTS.interior].shape)
    return wp.Samples(POINTS, u, b)


def quantities(material):
    """Moduli, a tensor of the nearest bond, dispersion, and a predicted answer."""
    D = material.symbol(WAVES)
    answer = np.linalg.solve(D[1], [1.0, 0.5])
    C = material.elastic_tensor()
    return np.array([C[0, 0], C[0, 1], C[2, 2], *D[:, 0, 0], *D[:, 1, 1], *answer])


def covered(seeds, **options):
    """Part of the true quantities inside their bands of 90 %, over data sets."""
    inside, true = [], quantities(TRUTH)
    for seed in seeds:
        samples = noisy(seed)
        middle = wp.fit(samples, LAW).material
        low, high = resample_loads(samples, LAW, **options).band(middle, quantities)
        inside.append((low <= true) & (true <= high))
    return float(np.mean(inside))


def test_bands_hold_the_truth_on_a_few_sets():
    assert covered(range(3), leave_one_out=True) > 0.7


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"leave_one_out": True}, {"draws": 40}])
def test_bands_of_90_percent_hold_the_truth_of_twenty_sets(options):
    assert 0.85 <= covered(range(100, 120), **options) <= 0.97


def test_more_loads_than_four_and_levels_that_are_probabilities():
    samples = noisy(0)
    few = wp.Samples(POINTS, samples.u[:3], samples.b[:3])
    with pytest.raises(wp.InputError, match="at least 4 loads, got 3"):
        resample_loads(few, LAW)
    with pytest.raises(wp.InputError, match="draws: expected at least 10"):
        resample_loads(samples, LAW, draws=3)
    found = resample_loads(samples, LAW, leave_one_out=True)
    assert len(found.materials) == LOADS
    assert "not an error that all loads share" in found.knows
    with pytest.raises(wp.InputError, match="level"):
        found.band(TRUTH, quantities, level=1.0)
