"""u_h^δ → u at fixed δ/h for K = 1/r, the local limit, by fitted orders; solves in space."""

from dataclasses import replace

import numpy as np
from numpy.linalg import norm

from examples.reproduce.slides import curl_and_pressure
from tests.support import filterwarnings, near, parametrize, sup
from tests.support.clouds import cloud, cube, field, load, plain, solid
from tests.support.problems import MU, fitted_order, lattice, noise, normal
from tests.support.solving import solve
from warp_peri import CG, Direct, Periodic, Points
from warp_peri import solve as at_rest
from warp_peri.certificates import check_solvability

pytestmark = filterwarnings("ignore:spacing. the model is certified")
LENGTH = 2.0
NUMBERS = np.array([8, 16, 32])
scattered = lambda number, horizon, seed=0: cloud(number, horizon, seed=seed, length=LENGTH)


def ordered(number, horizon):
    points = lattice(number, horizon, LENGTH / number)
    return replace(points, x=points.x + LENGTH / number / 2)


def orders(make, ratio, stiffer):
    """Fitted orders of the root mean square and the largest error."""
    errors = []
    for number in NUMBERS:
        horizon = ratio * LENGTH / number
        points = make(number, horizon)
        exact, load = curl_and_pressure(points.x, stiffer)
        u = solve(plain(horizon, stiffer * MU, MU), points, load, exact, allow_uncertified=True)
        error = (u - exact)[points.interior]
        errors.append((np.sqrt((error**2).mean()), sup(error)))
    return [fitted_order(LENGTH / NUMBERS, column) for column in np.transpose(errors)]


@parametrize(
    ("make", "stiffer", "ratio"),
    [(ordered, 1, 3), (scattered, 1, 3), (ordered, 1e4, 3), (ordered, 0.4, 2), (scattered, 100, 3)],
)
def test_second_order_however_incompressible(make, stiffer, ratio):
    """Where λ = μ of bonds alone."""
    assert min(orders(make, ratio, stiffer)) >= (1.9 if make is ordered else 1.8)


def test_perturbed_points_lose_order_where_the_material_is_nearly_incompressible():
    """Φ and Ψ are no transposes there: at λ = 10⁴ μ their mismatch outweighs μΓ."""
    assert max(orders(scattered, 3.0, 1e4)) < 1
    points = scattered(8, 3.0 * LENGTH / 8)
    assert check_solvability(plain(3.0 * LENGTH / 8, 1e4 * MU), points).symmetric_min < 0
    assert check_solvability(plain(3.0 * LENGTH / 8, 100 * MU), points).symmetric_min > 0


def error(number, lam, mu):
    """Root mean square error on number³ unknown nodes, relative to the field."""
    h = LENGTH / number
    points = cube(number, 2 * h, h, centred=True)
    exact = field(points.x)
    u = solve(solid(2 * h, lam, mu), points, load(points.x, lam, mu), exact, allow_uncertified=True)
    return np.sqrt(((u - exact)[points.interior] ** 2).mean() / (exact**2).mean())


@parametrize("lam", [0.3, 3.0])
def test_the_solution_tends_to_that_of_elasticity_with_second_order(lam):
    numbers = np.array([3, 4, 6])
    assert fitted_order(LENGTH / numbers, [error(number, lam, 0.8) for number in numbers]) >= 2


def test_iteration_finds_what_a_factorisation_does_in_space():
    points = cube(5, 2.0)
    operator = solid(2.0, lam=50.0).on(points, allow_uncertified=True)
    b, u = normal((2, *points.x.shape))
    first = operator.solve(b, u, Direct()).u
    for method in ("sine", "multigrid", "strip"):
        near(operator.solve(b, u, CG(method, tolerance=1e-11)).u, first, 1e-8)


def test_large_cubes_and_periods_are_solved_in_space():
    large, model = cube(16, 2.0), solid(2.0)
    operator = model.on(large, allow_uncertified=True)
    b = noise(large)
    solution = operator.solve(b, 0 * b)
    assert solution.method == "sine"
    inside = large.interior
    assert norm(operator(solution.u) - b[inside]) <= 1.1e-8 * norm(b[inside])
    cell = model.on(Points.sheet((6, 6, 6), 1.0), allow_uncertified=True)
    u = normal((216, 3), 1)
    u -= u.mean(0)
    near(at_rest(cell, Periodic(cell.points, cell(u))).u, u, 1e-11, 1)
