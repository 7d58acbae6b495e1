"""Losses under noise: the correction, and the linearised responses of displacement."""

import dataclasses

import numpy as np
import pytest

from tests.support.learning import fit
from tests.support.problems import difference, kernel, lattice, manufactured, with_nodes
from tests.support.solving import solve
from tests.support.waves import fluctuation, noisy, waves
from warp_peri import Bernstein, InputError, Samples
from warp_peri.fitting.rows import sample_weights, without_noise
from warp_peri.materials.lps_law import Products, products
from warp_peri.materials.lps_stages import CollarResponse, WaveResponse, squares
from warp_peri.points.families import bond_classes

HORIZON, SIZE = 3.0, 0.02
CLASSES = bond_classes(1.0, HORIZON)
MODEL = kernel("sign-changing", HORIZON, lam=-0.2, mu=0.7)


def moved(x):
    """The model with other λ, μ, α and D."""
    numbers = dict(zip(("lam", "mu", "alpha"), x.tolist()))
    return dataclasses.replace(MODEL, **numbers, D=x[3:], certified_on=(1.0,))


HERE = np.array([MODEL.lam, MODEL.mu, MODEL.alpha, *MODEL.D])
NEAR = HERE * (1 + 0.03 * np.random.default_rng(1).normal(size=len(HERE)))
NEAR[2] = MODEL.alpha


@pytest.fixture(scope="module")
def clean():
    return waves(MODEL)


def square(rows, model):
    return squares([rows], [CLASSES], model)


def noise_rows(noise, weight):
    bare = Samples(noise.points, noise.u, np.zeros_like(noise.u))
    return Products(bare, HORIZON).rows(np.full(len(noise), weight.sum() / len(noise))).R


def form(R, y):
    """[R, −y]ᵗ [R, −y]: the quadratic form of ‖R p − y‖² in (p, 1)."""
    both = np.column_stack([R, -y])
    return both.T @ both


def test_noise_adds_what_the_correction_takes_off(clean):
    weight = sample_weights([clean], normalise=True)[0]
    noise = fluctuation(clean, 200, SIZE, seed=5)
    N = noise_rows(noise, weight)
    expected = weight.sum() * (MODEL.on(clean, allow_uncertified=True)(noise.u) ** 2).sum() / 200
    assert np.sum((N @ products(MODEL, CLASSES)) ** 2) == pytest.approx(expected, rel=1e-10)
    loss = Products(noisy(clean, 0.001, seed=1), HORIZON).rows(weight)
    N = noise_rows(fluctuation(clean, 50, 0.0003, seed=2), weight)
    less = form(loss.R, loss.y) - form(N, np.zeros(len(N)))
    assert np.linalg.eigvalsh(less).min() > 0
    corrected = form(*without_noise(loss.R, loss.y, N))
    np.testing.assert_allclose(corrected, less, atol=1e-12 * np.abs(less).max())


def test_the_corrected_form_has_the_minimum_of_the_difference():
    """At the minimum noise is all that is left, so that the difference itself is below zero."""
    random, width = np.random.default_rng(1), 20
    R, c = random.normal(size=(3 * width, width)), random.normal(size=width)
    y = R @ c - 0.1 * random.normal(size=3 * width)
    N = random.normal(size=(width + 1, width)) / 2
    less = form(R, y) - form(N, np.zeros(width + 1))
    inside, load = less[:-1, :-1], less[:-1, -1]
    assert np.linalg.eigvalsh(inside).min() > 0 > np.linalg.eigvalsh(less).min()
    lowest = np.linalg.lstsq(*without_noise(R, y, N), rcond=None)[0]
    np.testing.assert_allclose(inside @ lowest, -load, atol=1e-9 * np.abs(load).max())


def misfit(model, points):
    """Mean of ‖û − u‖²/‖u‖² on the interior, by the library's own solver."""
    solved = solve(model, points, points.b, points.u, allow_uncertified=True)
    inside = points.interior
    wrong = ((solved - points.u)[:, inside] ** 2).sum(axis=(1, 2))
    return float(np.mean(wrong / (points.u[:, inside] ** 2).sum(axis=(1, 2))))


def assert_tangent(response):
    """The linearised loss has the gradient of the loss, by central differences."""
    grid = response.about(moved(NEAR))
    by_step = difference(lambda x: square(grid, moved(x)), NEAR, 1e-5, order=2)
    exact = difference(lambda x: square(response.about(moved(x)), moved(x)), NEAR, 1e-5, order=2)
    np.testing.assert_allclose(by_step, exact, rtol=1e-5, atol=1e-8)


def test_the_collar_response_is_the_solve_and_its_tangent():
    points = manufactured(MODEL, lattice(4, HORIZON), 5)
    response = CollarResponse(Products(points, HORIZON))
    expected = misfit(moved(NEAR), points)
    assert square(response.about(moved(NEAR)), moved(NEAR)) == pytest.approx(expected, rel=1e-9)
    assert_tangent(response)


def test_the_wave_response_is_exact_for_every_parity_and_so_is_its_tangent(clean):
    """Moved by any distance, a wave is answered by the same symbol."""
    response = WaveResponse(Products(clean, HORIZON))
    assert square(response.about(MODEL), MODEL) < 1e-20
    assert square(response.about(moved(NEAR)), moved(NEAR)) > 1e-5
    assert_tangent(response)
    k, x = clean.arrays["wave_vector"], clean.x
    quarter = np.pi / 2 / np.where(k == 0, np.inf, k)  # cos becomes sin along axis 0
    axis, sample = np.arange(len(k)) % 2, np.arange(len(k))
    for shift in ([1, 0], [0, 1], [1, 1]):
        phase = k[:, None] * (x - quarter[:, None] * shift)
        u, b = np.zeros_like(clean.u), np.zeros_like(clean.b)
        cos, sin = np.cos(phase).prod(axis=2).T, np.sin(phase).prod(axis=2).T
        u[sample, :, axis] = (response.u[sample, axis] * cos).T
        u[sample, :, 1 - axis] = -(response.u[sample, 1 - axis] * sin).T
        b[sample, :, axis] = (response.b[sample, axis] * cos).T
        there = WaveResponse(Products(dataclasses.replace(clean, u=u, b=b), HORIZON))
        assert square(there.about(MODEL), MODEL) < 1e-20


def test_what_noise_and_waves_cannot_be_used_is_refused(clean):
    noise, b = fluctuation(clean, 2, SIZE, seed=4), clean.b.copy()
    for given, words in (
        (noise[:0], "at least one field"),
        (with_nodes(noise, x=noise.x + 0.5), "nodes"),
        ([noise, noise], "expected 1 sets"),
    ):
        with pytest.raises(InputError, match=words):
            fit(clean, HORIZON, Bernstein(2), noise=given)
    b[3] = 0
    with pytest.raises(InputError, match="sample 3"):
        WaveResponse(Products(dataclasses.replace(clean, b=b), HORIZON))
