"""Solves in three dimensions: a manufactured solution of the local limit, and what is refused."""

import numpy as np
import pytest

import warp_peri
from tests.support.clouds import cube, field, load, solid
from tests.support.problems import fitted_order
from tests.support.solving import solve
from warp_peri import CG, Direct
from warp_peri.certificates import critical_time_step
from warp_peri.crystals import crystal_from_lps
from warp_peri.solvers.verlet import inertia

pytestmark = pytest.mark.filterwarnings("ignore:spacing. the model is certified")
LENGTH, RATIO = 2.0, 2.0


def error(number, lam, mu):
    """Root mean square error on number³ unknown nodes, relative to the field."""
    h = LENGTH / number
    points = cube(number, RATIO * h, h, centred=True)
    exact = field(points.x)
    model = solid(RATIO * h, lam, mu)
    u = solve(model, points, load(points.x, lam, mu), exact, allow_uncertified=True)
    return np.sqrt(((u - exact)[points.interior] ** 2).mean() / (exact**2).mean())


@pytest.mark.parametrize("lam", [0.3, 3.0], ids=["softer", "stiffer"])
def test_the_solution_tends_to_that_of_elasticity_with_second_order(lam):
    numbers = np.array([3, 4, 6])
    errors = [error(number, lam, 0.8) for number in numbers]
    assert fitted_order(LENGTH / numbers, errors) >= 2


def test_it_moves_at_a_proven_step_not_much_shorter_than_the_longest():
    model, density = solid(2.0, lam=3.0), 2000.0
    step = critical_time_step(model, spacing=1.0, density=density, allow_uncertified=True)
    waves = np.random.default_rng(2).uniform(-np.pi, np.pi, (2000, 3))
    stiffest = np.linalg.eigvalsh(crystal_from_lps(model, 1.0).symbol(waves)).max()
    longest = 2 * np.sqrt(inertia(density, model.units) / stiffest)
    assert 0.6 * longest < step < longest
    points = cube(3, 2.0)
    u = np.where(points.interior[:, None], np.random.default_rng(3).normal(size=points.x.shape), 0)
    problem = warp_peri.Dirichlet(points, None, 1e-3 * u)
    operator = model.on(points, allow_uncertified=True)
    motion = warp_peri.simulate(operator, problem, density=density, step=0.9 * step, steps=200)
    assert motion.u.shape == points.x.shape
    assert np.ptp(motion.energy) < 1e-9 * motion.energy.mean()


def test_iteration_finds_what_a_factorisation_does_in_space():
    points = cube(5, 2.0)
    operator = solid(2.0, lam=50.0).on(points, allow_uncertified=True)
    b, u = np.random.default_rng(0).normal(size=(2, *points.x.shape))
    first = operator.solve(b, u, Direct()).u
    for method in ("sine", "multigrid", "strip"):
        found = operator.solve(b, u, CG(method, tolerance=1e-11))
        np.testing.assert_allclose(found.u, first, atol=1e-8 * np.abs(first).max())


def test_large_cubes_and_periods_are_solved_in_space():
    large, model = cube(16, 2.0), solid(2.0)
    operator = model.on(large, allow_uncertified=True)
    b = np.random.default_rng(0).normal(size=large.x.shape)
    solution = operator.solve(b, 0 * b)
    assert solution.method == "sine"
    inside = large.interior
    left = operator(solution.u) - b[inside]
    assert np.linalg.norm(left) <= 1.1e-8 * np.linalg.norm(b[inside])
    cell = model.on(warp_peri.Points.sheet((6, 6, 6), 1.0), allow_uncertified=True)
    u = np.random.default_rng(1).normal(size=(216, 3))
    u -= u.mean(axis=0)
    found = warp_peri.solve(cell, warp_peri.Periodic(cell.points, cell(u))).u
    np.testing.assert_allclose(found, u, atol=1e-10)
