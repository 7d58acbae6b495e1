"""Losses by rows: that of Warp's operator, the correction for noise, displacement's responses."""

from dataclasses import replace

import numpy as np
import torch
from numpy.linalg import eigvalsh, lstsq
from numpy.random import default_rng

from tests.support import approx, near, parametrize, problems, shared
from tests.support.clouds import cube
from tests.support.fields import double
from tests.support.problems import difference, ell, kernel, lattice, manufactured, noise, normal
from tests.support.solving import fit
from tests.support.symbols import fluctuation, noisy, waves
from tests.support.told import assert_refused, each_refused
from warp_peri import Bernstein, Samples, evaluate
from warp_peri.fitting import regression
from warp_peri.fitting.regression import sample_weights, without_noise
from warp_peri.fitting.result import check_noise
from warp_peri.materials.lps_law import Products, products, squares
from warp_peri.materials.lps_stages import CollarResponse, WaveResponse, class_weights
from warp_peri.points.families import bond_classes

NEAR_HORIZON = 2.5
numbers = lambda alpha, D: [double(one) for one in (-0.2, 0.7, alpha, D)]
"""λ, μ, α and D."""
HORIZON, SIZE = 3.0, 0.02
CLASSES = bond_classes(1.0, HORIZON)
MODEL = kernel("sign-changing", HORIZON, lam=-0.2, mu=0.7)
HERE = np.array([MODEL.lam, MODEL.mu, MODEL.alpha, *MODEL.D])
NEAR = HERE * (1 + 0.03 * normal(len(HERE), 1))
NEAR[2] = MODEL.alpha
square = lambda rows, model: squares([rows], [CLASSES], model)


def samples(spacing=1.0, seed=0):
    """Loads of very different size that no kernel explains."""
    points = lattice(ell(), NEAR_HORIZON, spacing=spacing)
    points = manufactured(kernel("growing", NEAR_HORIZON, spacing), points, 4, seed=seed)
    size = np.array([1.0, 0.1, 3.0, 1.0])[:, None, None]
    return replace(points, u=size * points.u, b=size * (points.b + noise(points, 4, seed=seed)))


SETS = [samples(), samples(0.5, seed=1)]


def by_rows(sets, weights, lam, mu, alpha, D):
    """‖R p − y‖² over the sets as a function of λ, μ, α, D."""
    total = 0.0
    for each, weight in zip(sets, weights):
        products = Products(each, NEAR_HORIZON)
        of, w = products.rows(weight), class_weights(products.classes, alpha, D)
        i, j = np.triu_indices(len(w))
        p = torch.cat([mu * w, (lam - mu) * w[i] * w[j]])
        total += (torch.from_numpy(of.R) @ p - torch.from_numpy(of.y)).square().sum()
    return total


@parametrize("name", ["steep", "positive", "growing"])
def test_the_loss_is_its_definition(name, monkeypatch):
    monkeypatch.setattr(regression, "BLOCK", 1)
    shares = []
    for each in SETS:
        model = kernel(name, NEAR_HORIZON, each.spacing, lam=-0.2, mu=0.7)
        for force, b in zip(model.on(each)(each.u), each.b[:, each.interior]):
            shares.append(np.sum((force - b) ** 2) / np.sum(b**2))
    weights = sample_weights(SETS, normalise=True)
    found = by_rows(SETS, weights, *numbers(**problems.KERNELS[name]))
    near(found.item(), np.mean(shares), 1e-11)


def moved(x):
    """The model with other λ, μ, α and D."""
    numbers = dict(zip(("lam", "mu", "alpha"), x.tolist()))
    return replace(MODEL, **numbers, D=x[3:], certified_on=(1.0,))


@shared
def clean():
    return waves(MODEL)


def noise_rows(noise, weight):
    bare = Samples(noise.points, noise.u, 0 * noise.u)
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
    near(np.sum((N @ products(MODEL, CLASSES)) ** 2), expected, 1e-10)
    loss = Products(noisy(clean, 0.001, seed=1), HORIZON).rows(weight)
    N = noise_rows(fluctuation(clean, 50, 0.0003, seed=2), weight)
    less = form(loss.R, loss.y) - form(N, np.zeros(len(N)))
    sizes = eigvalsh(less)
    assert sizes.min() > -1e-14 * sizes.max()  # one is zero
    near(form(*without_noise(loss.R, loss.y, N)), less, 1e-12)


def test_the_corrected_form_has_the_minimum_of_the_difference():
    """At the minimum noise is all that is left, so that the difference itself is below zero."""
    random, width = default_rng(1), 20
    R, c = random.normal(size=(3 * width, width)), random.normal(size=width)
    y = R @ c - 0.1 * random.normal(size=3 * width)
    N = random.normal(size=(width + 1, width)) / 2
    less = form(R, y) - form(N, np.zeros(width + 1))
    inside, load = less[:-1, :-1], less[:-1, -1]
    assert eigvalsh(inside).min() > 0 > eigvalsh(less).min()
    near(inside @ lstsq(*without_noise(R, y, N), rcond=None)[0], -load, 1e-9)


def assert_tangent(response):
    """The linearised loss has the gradient of the loss, by central differences."""
    grid = response.about(moved(NEAR))
    by_step = difference(lambda x: square(grid, moved(x)), NEAR, 1e-5, order=2)
    exact = difference(lambda x: square(response.about(moved(x)), moved(x)), NEAR, 1e-5, order=2)
    assert by_step == approx(exact, rel=1e-5, abs=1e-8)


def test_the_collar_response_is_the_solve_and_its_tangent():
    points = manufactured(MODEL, lattice(4, HORIZON), 5)
    response = CollarResponse(Products(points, HORIZON))
    model = moved(NEAR)
    errors = evaluate(model, points)["E_u_samples"]
    near(square(response.about(model), model), np.mean(np.square(errors)), 1e-9)
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
        cos, sin = np.cos(phase).prod(2).T, np.sin(phase).prod(2).T
        u[sample, :, axis] = (response.u[sample, axis] * cos).T
        u[sample, :, 1 - axis] = -(response.u[sample, 1 - axis] * sin).T
        b[sample, :, axis] = (response.b[sample, axis] * cos).T
        there = WaveResponse(Products(replace(clean, u=u, b=b), HORIZON))
        assert square(there.about(MODEL), MODEL) < 1e-20


def test_what_noise_and_waves_cannot_be_used_is_refused(clean):
    noise, b = fluctuation(clean, 2, SIZE, seed=4), clean.b.copy()
    check_noise(replace(noise, b=1e-12 * clean.b[:2]), clean)
    each_refused(lambda given: fit(clean, HORIZON, Bernstein(2), noise=given), {
        "at least one field": noise[:0],
        "nodes": replace(noise, points=replace(noise.points, x=noise.x + 0.5)),
        "expected 1 sets": [noise, noise],
        "noise: expected .* unloaded body, got loads": replace(noise, b=clean.b[:2]),
    })  # fmt: skip
    b[3] = 0
    assert_refused({
        "sample 3 has no load and cannot be normalised":
            lambda: sample_weights([replace(clean, b=b)], normalise=True),
        "units: .* in 2 dimensions, .* in 3 dimensions":
            lambda: fit([clean, Samples(cube(2, 2.0), *np.ones((2, 1, 1000, 3)))], 2.0),
        "sample 3": lambda: WaveResponse(Products(replace(clean, b=b), HORIZON)),
    })  # fmt: skip
