"""Bands around a fit hold the truth as often as they say."""

import dataclasses
import re
import warnings

import numpy as np
import pytest

from tests.support.problems import kernel, lattice, manufactured
from tests.support.solving import solve
from tests.support.waves import fluctuation, noisy, waves
from warp_peri import Bernstein, InputError
from warp_peri.learning.fit import Fit, Settings
from warp_peri.learning.fit import learn as fit
from warp_peri.learning.response import WaveResponse, as_model, output_optimum
from warp_peri.learning.stages import LossChoice
from warp_peri.learning.uncertainty import Uncertainty, fit_uncertainty
from warp_peri.lps.model import stiffnesses
from warp_peri.lps.symbol import moduli
from warp_peri.points.families import bond_classes
from warp_peri.regression.coordinates import Parameters
from warp_peri.regression.losses import corrected, noise_loss, reduce, sample_weights
from warp_peri.regression.optimum import (
    Conditions,
    LatticeConditions,
    ZoneSearch,
    constrained_optimum,
)

HORIZON = 2.5
CLASSES = bond_classes(1.0, HORIZON)
REPLICATES = 200
SIZE = 0.02


def fitted(data, start, zeta=0.01):
    """The output-error fit alone, without the stages and proofs around it."""
    asked = [LatticeConditions(CLASSES, Conditions("direct", zeta))]
    optimum = output_optimum([WaveResponse(data, HORIZON)], start, asked, HORIZON)
    settings = Settings(asked, normalise=True, two_functions=False, moduli=None)
    return Fit(
        as_model(optimum.parameters, HORIZON), [], [], [], {}, LossChoice("output", ""), settings
    )


def constants(model):
    """λ, μ, E, the moduli, and K at the bonds, scaled to unit weighted volume."""
    K = model.influence(CLASSES.r)
    K = K / (CLASSES.count @ (K * CLASSES.weight * CLASSES.r**2))
    return np.array([model.lam, model.mu, model.E, *moduli(model, CLASSES).values(), *K])


def in_a_body(model, points):
    """Displacement in the middle of a small body under its loads, its collar held."""
    u = solve(model, points, points.b, points.u, allow_uncertified=True)
    return u[:, len(points.x) // 2]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:spacing. the model is certified on no spacing")
def test_the_band_holds_the_truth_as_often_as_it_says():
    true = kernel("positive", HORIZON, lam=-0.1, mu=0.7)
    start = Parameters(true.lam, true.mu, true.alpha, true.D)
    clean = waves(true, cells=4, highest=3)
    body = manufactured(true, lattice(3, HORIZON), 1, seed=3)

    def quantities(model):
        return np.concatenate([constants(model), in_a_body(model, body).ravel()])

    expected = quantities(true)
    held = []
    for replicate in range(REPLICATES):
        data = noisy(clean, SIZE, seed=2 * replicate)
        noise = fluctuation(clean, 12, SIZE, seed=2 * replicate + 1)
        result = fitted(data, start)
        lower, upper = fit_uncertainty(result, data, noise).band(
            result.material, quantities, level=0.9
        )
        held.append((lower <= expected) & (expected <= upper))
    coverage = np.mean(held, axis=0)
    assert coverage.min() >= 0.80, coverage
    assert coverage.max() <= 0.97, coverage


def test_samples_of_one_seed_share_their_noise():
    """Noise that every sample carries does not average out."""
    true = kernel("positive", HORIZON, lam=-0.1, mu=0.7)
    start = Parameters(true.lam, true.mu, true.alpha, true.D)
    data = noisy(waves(true, cells=4, highest=3), SIZE, seed=1)
    noise = fluctuation(data, 12, SIZE, seed=2)
    result = fitted(data, start)
    pairs = np.arange(len(data)) // 2
    twice = dataclasses.replace(
        data,
        **{name: np.concatenate([getattr(data, name)] * 2) for name in ("u", "b")},
        arrays={"wave_vector": np.concatenate([data.arrays["wave_vector"]] * 2)},
    )

    def spread(points, seed=None):
        samples = points.arrays if seed is None else {**points.arrays, "seed": seed}
        points = dataclasses.replace(points, arrays=samples)
        return fit_uncertainty(result, points, noise).deviation(constants)

    once = spread(data)
    seeds = np.tile(np.arange(len(data)), 2)
    np.testing.assert_allclose(spread(twice, seeds), once, rtol=1e-6)
    np.testing.assert_allclose(spread(twice), once / np.sqrt(2), rtol=1e-2)
    assert (spread(data, pairs) != once).any()


def test_an_active_condition_stays_where_it_is():
    """The margin at its worst wave vector does not move along with the noise."""
    true = kernel("positive", HORIZON, lam=-0.1, mu=0.7)
    start = Parameters(true.lam, true.mu, true.alpha, true.D)
    data = noisy(waves(true, cells=4, highest=3), SIZE, seed=1)
    noise = fluctuation(data, 12, SIZE, seed=2)
    margin = float(
        ZoneSearch(LatticeConditions(CLASSES, Conditions("direct", 1e-9)))
        .worst(*stiffnesses(fitted(data, start).material, CLASSES))[0]
        .min()
    )

    def smallest(model):
        table = ZoneSearch(LatticeConditions(CLASSES, Conditions("direct", 1e-9)))
        return table.worst(*stiffnesses(model, CLASSES))[0].min()

    free = fit_uncertainty(fitted(data, start), data, noise).deviation(smallest)
    held = fit_uncertainty(fitted(data, start, zeta=1.3 * margin), data, noise).deviation(smallest)
    assert held < 0.05 * free


def test_deviations_add_in_squares():
    true = kernel("1/r", HORIZON)
    pairs = [
        (*(dataclasses.replace(true, mu=true.mu + sign * off * step) for sign in (1, -1)), off)
        for step, off in ((0.03, 1.0), (0.04, 0.25))
    ]
    uncertainty = Uncertainty(pairs)
    assert uncertainty.deviation(lambda model: model.mu) == pytest.approx(0.05)
    lower, upper = uncertainty.band(true, lambda model: model.mu, level=0.6826894921)
    assert (upper - lower) / 2 == pytest.approx(0.05)
    with pytest.raises(InputError, match="between 0 and 1"):
        uncertainty.band(true, lambda model: model.mu, level=90)


def test_a_deviation_beyond_every_solid_is_still_told():
    """One standard deviation off there is no solid any more; the deviation is that of a part."""
    true = kernel("positive", HORIZON, lam=-0.1, mu=0.7)
    start = Parameters(true.lam, true.mu, true.alpha, true.D)
    data = waves(true, cells=4, highest=3)
    result = fitted(data, start)
    small, large = (
        fit_uncertainty(result, data, fluctuation(data, 12, size, seed=2)) for size in (1e-4, 10.0)
    )
    assert {off for *_, off in small.pairs} == {1.0}
    assert min(off for *_, off in large.pairs) < 1
    ratio = large.deviation(lambda model: model.mu) / small.deviation(lambda model: model.mu)
    assert ratio == pytest.approx(1e5, rel=0.3)


GPA = ("angstrom", "GPa")


def test_what_it_cannot_do_is_refused():
    true = kernel("1/r", HORIZON, lam=-0.1, mu=0.7)
    data = waves(true, cells=3, highest=2)
    noise = fluctuation(data, 3, SIZE, seed=2)
    result = fit(data, horizon=HORIZON, kernel=Bernstein(0), normalise=True)
    with pytest.raises(InputError, match="two fields"):
        fit_uncertainty(result, data, fluctuation(data, 1, SIZE, seed=2))
    with pytest.raises(InputError, match=r"points: expected Samples .* got Points"):
        fit_uncertainty(result, data.points, noise)
    with pytest.raises(InputError, match=r"noise: expected Samples .* got list"):
        fit_uncertainty(result, data, [noise.points])
    with pytest.raises(InputError, match="expected 1 sets"):
        fit_uncertainty(result, [data, data], noise)
    there = dataclasses.replace(data, points=dataclasses.replace(data.points, units=GPA))
    for sets in ((there, noise), (data, dataclasses.replace(noise, points=there.points))):
        with pytest.raises(InputError, match="units: the model is in angstrom and TPa"):
            fit_uncertainty(result, *sets)
    with pytest.raises(InputError, match="wave_vector"):
        fit_uncertainty(
            dataclasses.replace(result, loss=LossChoice("output", "")),
            dataclasses.replace(data, arrays={}),
            noise,
        )


def by_residual(data, noise=None, zeta=0.01, horizon=HORIZON, name="positive"):
    """The fit by the residual, corrected where noise is given, without the stages and proofs."""
    (weight,) = sample_weights([data], normalise=True)
    asked = [LatticeConditions(bond_classes(1.0, horizon), Conditions(zeta=zeta))]
    true = kernel(name, horizon, lam=-0.1, mu=0.7)
    start = Parameters(true.lam, true.mu, true.alpha, true.D)
    loss = reduce(data, horizon, weight)
    if noise is not None:
        loss = corrected(loss, noise_loss(noise, data, horizon, weight))
    optimum = constrained_optimum([loss], start, asked)
    settings = Settings(asked, normalise=True, two_functions=False, moduli=None)
    model = as_model(optimum.parameters, horizon)
    choice = LossChoice("residual" if noise is None else "corrected", "")
    return Fit(model, [], [], [], {}, choice, settings)


def coverage(size, replicates, quantities=constants, horizon=HORIZON, name="positive", **extent):
    """How often 90 % bands of the corrected loss hold the truth, and their width over the scatter.

    Shapes [Q].
    """
    true = kernel(name, horizon, lam=-0.1, mu=0.7)
    clean = waves(true, **extent)
    values, deviations = [], []
    for replicate in range(replicates):
        data = noisy(clean, size, seed=2 * replicate)
        noise = fluctuation(clean, 12, size, seed=2 * replicate + 1)
        result = by_residual(data, noise, horizon=horizon, name=name)
        values.append(quantities(result.material))
        deviations.append(fit_uncertainty(result, data, noise).deviation(quantities))
    off = np.abs(np.array(values) - quantities(true))
    width = np.sqrt(np.mean(np.square(deviations), axis=0)) / np.std(values, axis=0)
    return (off <= 1.6449 * np.array(deviations)).mean(axis=0), width


@pytest.mark.slow
def test_bands_of_the_corrected_loss_hold_the_truth_as_often_as_they_say():
    held, width = coverage(2e-4, 60, cells=4, highest=3)
    assert held.min() >= 0.80, held
    assert held.max() <= 0.97, held
    assert 0.8 < width.min() < width.max() < 1.5, width


@pytest.mark.slow
@pytest.mark.parametrize("size", [1e-4, 3e-4])
def test_so_they_do_up_to_the_noise_that_is_warned_about(size):
    held, _ = coverage(size, 200, cells=4, highest=3)
    assert held.min() >= 0.80, held
    assert held.max() <= 0.97, held


@pytest.mark.slow
def test_a_direction_that_hardly_matters_does_not_widen_the_bands_of_constants():
    """α beside five coefficients: one deviation along it is far outside what is linear."""

    def moduli_of(model):
        return np.array([model.lam, model.mu, model.E])

    held, width = coverage(
        5e-5, 100, moduli_of, horizon=4.0, name="sign-changing", cells=6, highest=4
    )
    assert held.min() >= 0.80, held
    assert held.max() <= 0.97, held
    assert width.max() < 1.5, width


@pytest.mark.parametrize(("size", "warned"), [(2e-4, False), (1e-3, True)])
def test_noise_that_hides_the_curvature_is_warned_about(size, warned):
    true = kernel("positive", HORIZON, lam=-0.1, mu=0.7)
    clean = waves(true, cells=4, highest=3)
    data, noise = noisy(clean, size, seed=0), fluctuation(clean, 12, size, seed=1)
    result = by_residual(data, noise)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        fit_uncertainty(result, data, noise)
    assert any("curvature of the loss" in str(warning.message) for warning in caught) == warned


def test_bands_that_noise_pulls_off_the_truth_are_warned_about():
    """Noise biases the residual: the truth is many deviations off, as the warning says."""
    true = kernel("positive", HORIZON, lam=-0.1, mu=0.7)
    clean = waves(true, cells=4, highest=3)
    data = noisy(clean, 5e-4, seed=0)
    result = by_residual(data)
    with pytest.warns(UserWarning, match="noise pulls a fit by 'residual'") as caught:
        bands = fit_uncertainty(result, data, fluctuation(clean, 12, 5e-4, seed=1))
    said = float(re.search("by ([0-9.e+]+) standard", str(caught[0].message))[1])
    off = np.abs(constants(result.material) - constants(true)) / bands.deviation(constants)
    assert off[:3].min() > 2  # λ, μ, E: no band of 90 % holds them
    assert off.max() / 3 < said
    quiet = noisy(clean, 1e-7, seed=0)
    fit_uncertainty(by_residual(quiet), quiet, fluctuation(clean, 12, 1e-7, seed=1))
