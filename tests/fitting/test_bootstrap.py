"""Bands without fields of noise: coverage on data of known truth, one signature, refusals."""

from types import SimpleNamespace

import numpy as np
import pytest

import warp_peri as wp
from tests.support.problems import kernel, lattice, manufactured
from warp_peri.fitting.evaluate import BootstrapResult
from warp_peri.methods import bootstrap

NOISE, LOADS = 0.3, 10
POINTS = lattice(5, 2.0)


class Springs:
    """b = c u at every node: one stiffness, by least squares over the loads."""

    def learn(self, samples, **options):
        return SimpleNamespace(material=float((samples.u * samples.b).sum() / (samples.u**2).sum()))


def noisy(seed):
    """Loads of springs of stiffness 1; each load's own noise on its forces, of any size."""
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(LOADS, *POINTS.x.shape))
    size = NOISE * rng.uniform(0.5, 1.5, (LOADS, 1, 1))
    return wp.Samples(POINTS, u, u + size * rng.normal(size=u.shape))


def quantities(c):
    """What is linear in the stiffness, and what is not."""
    return np.array([c, 1 / c, c**2])


def test_a_band_leaves_half_of_the_rest_on_each_side():
    """Of draws 0, 1 and 2, by a table of Student's distribution: 2.132 for 4 at 95 %."""
    found = BootstrapResult([0.0, 1.0, 2.0], loads=5, knows="")
    low, high = found.band(1.0, float)
    assert (high - low) / 2 == pytest.approx(2.132 * 0.6826 * np.sqrt(5 / 4), rel=1e-4)
    assert (high + low) / 2 == pytest.approx(1)


def test_bands_of_90_percent_hold_the_truth_of_so_many_sets():
    inside = []
    for seed in range(100):
        samples = noisy(seed)
        best = Springs().learn(samples).material
        low, high = bootstrap(samples, Springs()).band(best, quantities)
        inside.append((low <= 1) & (high >= 1))
    assert 0.85 <= np.mean(inside) <= 0.97


def test_choices_among_exact_loads_give_one_solid():
    samples = manufactured(kernel("1/r", 2.0), lattice(5, 2.0), 6)
    found = bootstrap(samples, wp.LPS(2.0), draws=10)
    assert found.deviation(lambda solid: [solid.lam, solid.mu]).max() < 1e-6


def test_more_loads_than_four_and_levels_that_are_probabilities():
    samples, found = noisy(0), bootstrap(noisy(0), Springs(), draws=10)
    assert len(found.materials) == 10
    assert "not an error that all loads share" in found.knows
    for call, words in (
        (lambda: bootstrap(samples[:3], Springs()), "at least 4 loads, got 3"),
        (lambda: bootstrap(samples, Springs(), draws=3), "draws: expected at least 10"),
        (lambda: found.band(1.0, quantities, level=1.0), "level"),
    ):
        with pytest.raises(wp.InputError, match=words):
            call()
