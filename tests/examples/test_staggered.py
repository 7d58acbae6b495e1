"""Nearly incompressible solids on scattered points: orders however large λ/μ is, and refusals."""

import numpy as np
import pytest

from examples.studies.staggered import derivatives, staggered, thinned
from tests.support import clouds
from tests.support.problems import fitted_order
from warp_peri import InputError, Points

LENGTH, MU = 2.0, 0.8
NUMBERS = np.array([8, 16, 32])


def error(number, lam, seed):
    horizon = 3 * LENGTH / number
    points = clouds.cloud(number, horizon, seed=seed, length=LENGTH)
    exact = clouds.state_based_field(points.x, lam, MU)
    load = clouds.state_based_load(points.x, lam, MU)
    solved = staggered(clouds.plain(horizon, lam, MU), points).solve(load[None], exact[None])[0]
    assert (solved == exact)[~points.interior].all()
    return np.linalg.norm(solved - exact) / np.linalg.norm(exact[points.interior])


@pytest.mark.parametrize(("ratio", "seed"), [(3.0, 0), (1e4, 1), (1e6, 2)])
def test_second_order_however_incompressible(ratio, seed):
    errors = [error(number, ratio * MU, seed) for number in NUMBERS]
    assert fitted_order(LENGTH / NUMBERS, errors) > 1.9
    assert errors[-1] < (1.6e-3 if ratio < 100 else 6e-4)


def bent(number, ratio, seed):
    """Error of pure bending, which no face across x₂ feels; nodes end at x₂ = LENGTH."""
    horizon = 3 * LENGTH / number
    points = clouds.cloud(number, horizon, seed=seed, length=LENGTH)
    middle = points.x[points.interior].mean(axis=0)
    outside = points.x[:, 1] > LENGTH
    body = Points(points.x, points.interior & ~outside, 0.0, outside=outside)
    x, y = (points.x - middle).T
    exact = np.stack([x * y, -(x**2 + ratio / (ratio + 2) * y**2) / 2], axis=1)
    given = np.where(outside[:, None], 0.0, exact)
    solved = staggered(clouds.plain(horizon, ratio * MU, MU), body).solve(
        0 * given[None], given[None]
    )
    off = (solved[0] - exact)[body.interior]
    return np.linalg.norm(off) / np.linalg.norm(exact[body.interior])


@pytest.mark.parametrize(("ratio", "seed"), [(3.0, 0), (1e4, 1), (1e6, 2)])
def test_a_free_edge_is_right_to_the_first_order(ratio, seed):
    errors = [bent(number, ratio, seed) for number in NUMBERS[:2]]
    assert fitted_order(LENGTH / NUMBERS[:2], errors) > 0.9
    assert errors[-1] < 0.03


def test_derivatives_are_exact_for_cubics():
    x = np.random.default_rng(0).uniform(-1, 1, (200, 2))
    f = x[:, 0] ** 3 - 2 * x[:, 0] * x[:, 1] ** 2 + x[:, 1]
    exact = [3 * x[:, 0] ** 2 - 2 * x[:, 1] ** 2, 1 - 4 * x.prod(axis=1)]
    for matrix, there in zip(derivatives(x[:20], x), exact):
        np.testing.assert_allclose(matrix @ f, there[:20], atol=1e-9)


def test_no_two_that_are_kept_are_near_and_every_other_is_near_one():
    x = np.random.default_rng(1).uniform(0, 1, (300, 2))
    kept = thinned(x, np.arange(300), 0.1)
    apart = np.linalg.norm(x[kept][:, None] - x[kept], axis=-1) + np.eye(len(kept))
    assert apart.min() > 0.1
    assert np.linalg.norm(x[:, None] - x[kept], axis=-1).min(axis=1).max() <= 0.1


def test_what_cannot_be_staggered_is_refused():
    steps = np.argwhere(np.ones(2 * [16])) - 8.0
    few = Points(steps, np.abs(steps).max(axis=1) < 1.5, 0.0)
    with pytest.raises(InputError, match="expected at least 20 nodes to read, got"):
        staggered(clouds.plain(3.0), few)
    with pytest.raises(InputError, match="lie on a curve of degree 3"):
        derivatives(steps[:1], np.stack([np.arange(30.0), 0 * np.arange(30.0)], axis=1))
    cube = np.argwhere(np.ones(3 * [9])) - 4.0
    space = Points(cube, np.abs(cube).max(axis=1) < 0.5, 0.0)
    with pytest.raises(InputError, match="points of the plane"):
        staggered(clouds.plain(2.0), space)
