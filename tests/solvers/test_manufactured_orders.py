"""u_h^δ → u at fixed δ/h for K = 1/r: manufactured solutions of the local limit, fitted orders."""

from dataclasses import replace

import numpy as np
import pytest

from examples.reproduce.slides import curl_and_pressure
from tests.support.clouds import cloud, plain
from tests.support.problems import LAM, MU, fitted_order, kernel, lattice
from tests.support.solving import solve
from warp_peri.certificates import check_solvability

pytestmark = pytest.mark.filterwarnings("ignore:spacing. the model is certified")
LENGTH = 2.0
NUMBERS = np.array([8, 16, 32])
LATTICE, CLOUD = 1.9, 1.8  # least orders


def ordered(number, horizon):
    points = lattice(number, horizon, LENGTH / number)
    return replace(points, x=points.x + LENGTH / number / 2)


def scattered(number, horizon, seed=0):
    return cloud(number, horizon, seed=seed, length=LENGTH)


def orders(make, ratio, stiffer):
    """Fitted orders of the root mean square and the largest error."""
    errors = []
    for number in NUMBERS:
        horizon = ratio * LENGTH / number
        points = make(number, horizon)
        exact, load = curl_and_pressure(points.x, stiffer)
        model = plain(horizon, stiffer * MU, MU)
        u = solve(model, points, load, exact, allow_uncertified=True)
        error = (u - exact)[points.interior]
        errors.append((np.sqrt((error**2).mean()), np.abs(error).max()))
    return [fitted_order(LENGTH / NUMBERS, column) for column in np.transpose(errors)]


@pytest.mark.parametrize(
    ("make", "stiffer", "ratio", "least"),
    [
        (ordered, 1.0, 3.0, LATTICE),  # of bonds alone
        (scattered, 1.0, 3.0, CLOUD),
        (ordered, 1e4, 3.0, LATTICE),
        (ordered, 0.4, 2.0, LATTICE),
        (scattered, 100.0, 3.0, CLOUD),
    ],
)
def test_second_order_however_incompressible(make, stiffer, ratio, least):
    assert min(orders(make, ratio, stiffer)) >= least


def test_forces_converge_and_those_of_other_kernels_to_other_constants():
    errors = {"1/r": [], "steep": []}
    for number in NUMBERS:
        spacing = LENGTH / number
        points = ordered(number, 3 * spacing)
        u, b = curl_and_pressure(points.x, LAM / MU)
        for name, found in errors.items():
            force = kernel(name, 3 * spacing, spacing).on(points)(u)
            found.append(np.abs(force - b[points.interior]).max())
    assert fitted_order(1 / NUMBERS, errors["1/r"]) >= 1.9
    assert fitted_order(1 / NUMBERS, errors["steep"]) < 0.5


def test_perturbed_points_lose_order_where_the_material_is_nearly_incompressible():
    """Φ and Ψ are no transposes there: at λ = 10⁴ μ their mismatch outweighs μΓ."""
    assert max(orders(scattered, 3.0, 1e4)) < 1
    points = scattered(8, 3.0 * LENGTH / 8)
    assert check_solvability(plain(3.0 * LENGTH / 8, 1e4 * MU), points).symmetric_min < 0
    assert check_solvability(plain(3.0 * LENGTH / 8, 100 * MU), points).symmetric_min > 0
