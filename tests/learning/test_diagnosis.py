"""The diagnosis names the cause that was planted."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.problems import kernel, lattice, manufactured
from tests.support.waves import fluctuation
from warp_peri import InputError, diagnose
from warp_peri.learning.diagnosis import _Grid
from warp_peri.transfer.operator import LPSOperator

HORIZON = 2.5
MODEL = kernel("positive", HORIZON, lam=0.1, mu=0.7)
EVERY = np.arange(24)


@pytest.fixture(scope="module")
def samples():
    return manufactured(MODEL, lattice(9, HORIZON), len(EVERY), wave_number=0.6)


def with_force(samples, extra):
    """The samples with loads that a model of their own would need besides, a tenth as large."""
    b = samples.b.copy()
    inside = b[:, samples.interior]
    b[:, samples.interior] += 0.1 * extra * np.linalg.norm(inside) / np.linalg.norm(extra)
    return replace(samples, b=b)


def planted(samples, cause):
    grid = _Grid(samples, HORIZON)
    if cause == "dispersion":
        other = kernel("steep", HORIZON, lam=0.4, mu=0.7)
        return LPSOperator(other, samples.points)(samples.u)
    if cause == "anisotropy":
        return grid.pairs(EVERY)[..., 0]
    if cause == "nonlinearity":
        return grid.quadratic(EVERY)[..., 3] + grid.quadratic(EVERY)[..., 20]
    factor = np.random.default_rng(0).normal(size=(grid.place.shape[0], 1))
    return factor * samples.b[:, samples.interior]


@pytest.mark.parametrize("cause", ["dispersion", "anisotropy", "nonlinearity", "heterogeneity"])
def test_the_planted_cause_is_named(samples, cause):
    diagnosis = diagnose(MODEL, with_force(samples, planted(samples, cause)))
    assert diagnosis.residual == pytest.approx(0.1, rel=0.15)
    assert max(diagnosis.shares, key=diagnosis.shares.get) == cause
    assert diagnosis.shares[cause] > 0.5
    assert sum(diagnosis.shares.values()) == pytest.approx(1.0)
    assert diagnosis.sentence.startswith("The model leaves ")
    assert cause in diagnosis.sentence or "short waves" in diagnosis.sentence


def test_noise_is_named_where_its_fields_are_given(samples):
    noisy = replace(samples, u=samples.u + fluctuation(samples, len(EVERY), 0.01, seed=1).u)
    diagnosis = diagnose(MODEL, noisy, fluctuation(samples, 12, 0.01, seed=2))
    assert max(diagnosis.shares, key=diagnosis.shares.get) == "noise"
    assert diagnosis.shares["noise"] == pytest.approx(1.0, abs=0.2)


def test_what_cannot_be_told_is_refused(samples):
    few = replace(samples, u=samples.u[:3], b=samples.b[:3])
    with pytest.raises(InputError, match="expected 8 at least on a lattice, got 3"):
        diagnose(MODEL, few)
