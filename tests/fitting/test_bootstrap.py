"""Bands without fields of noise: coverage on data of known truth, one signature, refusals."""

import dataclasses

import numpy as np
import pytest

import warp_peri as wp
from tests.support.problems import lattice
from warp_peri.fitting.bootstrap import BootstrapResult
from warp_peri.materials.crystal_fit import fit_dispersion
from warp_peri.methods import bootstrap

HORIZON, NOISE, LOADS = 2.0, 0.1, 10
MODULI = wp.crystals.voigt_to_tensor([[1.0, 0.3, 0.0], [0.3, 1.0, 0.0], [0.0, 0.0, 0.5]])
LAW = wp.Crystal(HORIZON, "4mm", moduli=None)
WAVES = np.array([[0.3, 0.1], [0.6, 0.5], [1.0, 0.2]])


def known():
    """A crystal on a lattice of spacing 1, dispersive."""

    def symbol(k):
        local = np.einsum("ijkl,nj,nl->nik", MODULI, k, k)
        return local * (1 - 0.03 * (k**2).sum(axis=1))[:, None, None]

    return fit_dispersion(symbol, 1.0, HORIZON, symmetry="4mm", tensor=MODULI)


TRUTH = known()
POINTS = dataclasses.replace(lattice(8, HORIZON, 1.0), axis=0.0)
CENTRE = int(np.argmin(np.hypot(*(POINTS.x - POINTS.x[POINTS.interior].mean(axis=0)).T)))


def waved(count, rng):
    """Fields of single waves, [count, N, 2]."""
    k = rng.uniform(0.2, 1.2, (count, 1, 2)) * rng.choice([-1, 1], (count, 1, 2))
    phase = (POINTS.x[None] * k).sum(axis=2) + rng.uniform(0, 6, (count, 1))
    return 0.01 * rng.normal(size=(count, 1, 2)) * np.cos(phase)[:, :, None]


def answered(u):
    """The same with the loads that the crystal answers with them."""
    b = np.zeros_like(u)
    b[:, POINTS.interior] = TRUTH.on(POINTS)(u)
    return wp.Samples(POINTS, u, b)


def noisy(seed):
    """Loads of random waves; each load's own noise on its forces, of any size."""
    rng = np.random.default_rng(seed)
    one = answered(waved(LOADS, rng))
    b, inside = one.b.copy(), POINTS.interior
    size = NOISE * np.sqrt((b[:, inside] ** 2).mean()) * rng.uniform(0.5, 1.5, (LOADS, 1, 1))
    b[:, inside] += size * rng.normal(size=b[:, inside].shape)
    return wp.Samples(POINTS, one.u, b)


def dispersion(material):
    """D(k) at the middle node, by waves about it, [3, 2, 2]."""
    from_here = POINTS.x - POINTS.x[CENTRE]
    fields = np.cos(WAVES @ from_here.T)[:, None, :, None] * np.eye(2)[:, None, :]
    place = np.flatnonzero(POINTS.interior).tolist().index(CENTRE)
    return material.on(POINTS)(fields.reshape(6, -1, 2))[:, place].reshape(3, 2, 2)


def quantities(material):
    """Constants, dispersion, and a predicted answer, of a material."""
    D = dispersion(material)
    answer = np.linalg.solve(D[1], [1.0, 0.5])
    return np.array([*material.moduli().values(), *D[:, 0, 0], *D[:, 1, 1], *answer])


def test_a_band_leaves_half_of_the_rest_on_each_side():
    """Of draws 0, 1 and 2, by a table of Student's distribution: 2.132 for 4 at 95 %."""
    found = BootstrapResult([0.0, 1.0, 2.0], loads=5, knows="")
    low, high = found.band(1.0, float)
    assert (high - low) / 2 == pytest.approx(2.132 * 0.6826 * np.sqrt(5 / 4), rel=1e-4)
    assert (high + low) / 2 == pytest.approx(1)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:symmetry")  # ten noisy loads may seem to contradict theirs
def test_bands_of_90_percent_hold_the_truth_of_so_many_sets():
    inside, true = [], quantities(TRUTH)
    for seed in range(100, 160):
        samples = noisy(seed)
        low, high = bootstrap(samples, LAW).band(wp.fit(samples, LAW).material, quantities)
        inside.append((low <= true) & (true <= high))
    assert 0.85 <= np.mean(inside) <= 0.97


def test_more_loads_than_four_and_levels_that_are_probabilities():
    samples = noisy(0)
    few = wp.Samples(POINTS, samples.u[:3], samples.b[:3])
    with pytest.raises(wp.InputError, match="at least 4 loads, got 3"):
        bootstrap(few, LAW)
    with pytest.raises(wp.InputError, match="draws: expected at least 10"):
        bootstrap(samples, LAW, draws=3)
    found = bootstrap(samples, LAW, draws=10)
    assert len(found.materials) == 10
    assert "not an error that all loads share" in found.knows
    with pytest.raises(wp.InputError, match="level"):
        found.band(TRUTH, dispersion, level=1.0)
