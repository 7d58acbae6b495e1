"""Losses under noise: the correction, the linearised response, and what a fit makes of them."""

import dataclasses

import numpy as np
import pytest

from tests.support.learning import fit
from tests.support.problems import kernel, lattice, manufactured, with_nodes
from tests.support.solving import solve
from tests.support.waves import fluctuation, noisy, waves
from warp_peri import Bernstein, InputError, Samples
from warp_peri.fitting.losses import without_noise
from warp_peri.fitting.training_data import sample_weights
from warp_peri.materials.lps import Model
from warp_peri.materials.lps_output import CollarResponse, WaveResponse, squares
from warp_peri.materials.lps_rows import Products, products
from warp_peri.points.families import bond_classes

HORIZON, DEGREE = 3.0, 5
SIZE = 0.02


@pytest.fixture(scope="module")
def model():
    return kernel("sign-changing", HORIZON, lam=-0.2, mu=0.7)


@pytest.fixture(scope="module")
def clean(model):
    return waves(model)


def near(model, seed=1, size=0.03):
    """A model a little off."""
    random = np.random.default_rng(seed)
    return Model(
        model.lam + size * random.normal(),
        model.mu + size * random.normal(),
        model.alpha,
        model.D * (1 + size * random.normal(size=len(model.D))),
        model.horizon,
        certified_on=(1.0,),
    )


CLASSES = bond_classes(1.0, HORIZON)


def square(rows, model):
    return squares([rows], [CLASSES], model)


def noise_rows(noise, weight):
    bare = Samples(noise.points, noise.u, np.zeros_like(noise.u))
    return Products(bare, HORIZON).rows(np.full(len(noise), weight.sum() / len(noise))).R


def form(R, y):
    """[R, −y]ᵗ [R, −y]: the quadratic form of ‖R p − y‖² in (p, 1)."""
    both = np.column_stack([R, -y])
    return both.T @ both


def test_noise_adds_what_the_correction_expects(model, clean):
    weight = sample_weights([clean], normalise=True)[0]
    noise = fluctuation(clean, 200, SIZE, seed=5)
    N = noise_rows(noise, weight)
    operator = model.on(clean, allow_uncertified=True)
    expected = weight.sum() * (operator(noise.u) ** 2).sum() / len(noise)
    assert np.sum((N @ products(model, CLASSES)) ** 2) == pytest.approx(expected, rel=1e-10)


def both_forms(clean, size, count, noise):
    """The form of a noisy loss less that of its noise, and the corrected one."""
    weight = sample_weights([clean], normalise=True)[0]
    loss = Products(noisy(clean, size, seed=1), HORIZON).rows(weight)
    N = noise_rows(fluctuation(clean, count, noise, seed=2), weight)
    difference = form(loss.R, loss.y) - form(N, np.zeros(len(N)))
    return loss, difference, form(*without_noise(loss.R, loss.y, N))


def test_the_corrected_form_is_the_difference_where_that_is_positive(clean):
    _, difference, less = both_forms(clean, 0.001, 50, 0.0003)
    assert np.linalg.eigvalsh(difference).min() > 0
    np.testing.assert_allclose(less, difference, atol=1e-12 * np.abs(difference).max())


def test_the_corrected_form_never_turns_negative(clean):
    loss, difference, less = both_forms(clean, SIZE, 3, 2 * SIZE)
    assert np.linalg.eigvalsh(difference).min() < 0
    before = np.linalg.eigvalsh((form(loss.R, loss.y) - less)[:-1, :-1])
    assert before.min() > -1e-10 * before.max()  # of what the model does, never more than before
    assert np.isfinite(less).all()


def test_the_corrected_form_has_the_minimum_of_the_difference():
    """At the minimum noise is all that is left, so that the difference itself is below zero."""
    random, width = np.random.default_rng(1), 20
    R, c = random.normal(size=(3 * width, width)), random.normal(size=width)
    y = R @ c - 0.1 * random.normal(size=3 * width)
    N = random.normal(size=(width + 1, width)) / 2
    difference = form(R, y) - form(N, np.zeros(width + 1))
    inside, load = difference[:-1, :-1], difference[:-1, -1]
    assert np.linalg.eigvalsh(inside).min() > 0 > np.linalg.eigvalsh(difference).min()
    lowest = np.linalg.lstsq(*without_noise(R, y, N), rcond=None)[0]
    np.testing.assert_allclose(inside @ lowest, -load, atol=1e-9 * np.abs(load).max())


def misfit(model, points):
    """Mean of ‖û − u‖²/‖u‖² on the interior, by the library's own solver."""
    solved = solve(model, points, points.b, points.u, allow_uncertified=True)
    inside = points.interior
    wrong = ((solved - points.u)[:, inside] ** 2).sum(axis=(1, 2))
    return float(np.mean(wrong / (points.u[:, inside] ** 2).sum(axis=(1, 2))))


def test_the_collar_response_is_the_solve_and_its_tangent(model):
    points = manufactured(model, lattice(4, HORIZON), 5)
    other = near(model)
    made = Products(points, HORIZON)
    response = CollarResponse(made, made.rows(sample_weights([points], normalise=True)[0]))
    grid = response.about(other)
    assert square(grid, other) == pytest.approx(misfit(other, points), rel=1e-9)
    assert_tangent(lambda model: square(response.about(model), model), grid, other)


def test_the_wave_response_is_exact_and_its_tangent_is(model, clean):
    response = WaveResponse(Products(clean, HORIZON))
    assert square(response.about(model), model) < 1e-20
    assert square(response.first, model) < 1e-20
    other = near(model)
    grid = response.about(other)
    assert square(grid, other) > 1e-5
    assert_tangent(lambda model: square(response.about(model), model), grid, other)


def assert_tangent(loss, grid, model, step=1e-5):
    """The linearised loss has the gradient of the loss, by central differences."""
    for change in ("lam", "mu", "alpha", *range(len(model.D))):

        def moved(by, change=change):
            if isinstance(change, int):
                D = model.D.copy()
                D[change] += by
                return dataclasses.replace(model, D=D)
            return dataclasses.replace(model, **{change: getattr(model, change) + by})

        exact = (loss(moved(step)) - loss(moved(-step))) / (2 * step)
        by_step = (square(grid, moved(step)) - square(grid, moved(-step))) / (2 * step)
        assert by_step == pytest.approx(exact, rel=1e-5, abs=1e-8)


def test_every_parity_of_waves_is_known(model, clean):
    """Moved by any distance, a wave is answered by the same symbol."""
    response = WaveResponse(Products(clean, HORIZON))
    k, x = clean.arrays["wave_vector"], clean.x
    quarter = np.pi / 2 / np.where(k == 0, np.inf, k)  # cos becomes sin along axis 0
    for shift in ([1, 0], [0, 1], [1, 1]):
        u, b = np.zeros_like(clean.u), np.zeros_like(clean.b)
        for s in range(len(clean)):
            moved = x - quarter[s] * shift
            c, d = np.cos(k[s] * moved).prod(axis=1), np.sin(k[s] * moved).prod(axis=1)
            axis = s % 2
            u[s, :, axis] = response.u[s, axis] * c
            u[s, :, 1 - axis] = -response.u[s, 1 - axis] * d
            b[s, :, axis] = response.b[s, axis] * c
        points = dataclasses.replace(clean, u=u, b=b)
        assert square(WaveResponse(Products(points, HORIZON)).about(model), model) < 1e-20


def test_noise_that_does_not_belong_to_the_samples_is_refused(clean):
    noise = fluctuation(clean, 2, SIZE, seed=4)
    for given, words in (
        (dataclasses.replace(noise, u=noise.u[:0]), "at least one field"),
        (with_nodes(noise, x=noise.x + 0.5), "nodes"),
        ([noise, noise], "expected 1 sets"),
    ):
        with pytest.raises(InputError, match=words):
            fit(clean, HORIZON, Bernstein(2), noise=given)


def test_a_sample_without_its_wave_is_named(clean):
    b = clean.b.copy()
    b[3] = 0
    with pytest.raises(InputError, match="sample 3"):
        WaveResponse(Products(dataclasses.replace(clean, b=b), HORIZON))
