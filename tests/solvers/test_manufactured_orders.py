"""u_h^δ → u at fixed δ/h for K = 1/r: manufactured solutions of the local limit, fitted orders."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from tests.support import clouds
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
    return clouds.cloud(number, horizon, seed=seed, length=LENGTH)


def orders(make, ratio, field, load, lam):
    """Fitted orders of the root mean square and the largest error."""
    errors = []
    for number in NUMBERS:
        horizon = ratio * LENGTH / number
        points = make(number, horizon)
        exact = field(points.x)
        model = clouds.plain(horizon, lam, MU)
        u = solve(model, points, load(points.x), exact, allow_uncertified=True)
        error = (u - exact)[points.interior]
        errors.append((np.sqrt((error**2).mean()), np.abs(error).max()))
    return [fitted_order(LENGTH / NUMBERS, column) for column in np.transpose(errors)]


def bond_based(make, ratio):
    load = partial(clouds.bond_based_load, mu=MU)
    return orders(make, ratio, clouds.bond_based_field, load, MU)


def state_based(make, ratio, lam):
    field = partial(clouds.state_based_field, lam=lam, mu=MU)
    return orders(make, ratio, field, partial(clouds.state_based_load, lam=lam, mu=MU), lam)


@pytest.mark.parametrize(("make", "least"), [(ordered, LATTICE), (scattered, CLOUD)])
def test_bond_based(make, least):
    assert min(bond_based(make, 3.0)) >= least


@pytest.mark.parametrize(
    ("make", "stiffer", "ratio", "least"),
    [(ordered, 1e4, 3.0, LATTICE), (ordered, 0.4, 2.0, LATTICE), (scattered, 100.0, 3.0, CLOUD)],
)
def test_state_based_however_incompressible(make, stiffer, ratio, least):
    assert min(state_based(make, ratio, stiffer * MU)) >= least


def test_forces_converge_and_those_of_other_kernels_to_other_constants():
    errors = {"1/r": [], "steep": []}
    for number in NUMBERS:
        spacing = LENGTH / number
        points = ordered(number, 3 * spacing)
        known = (points.x, LAM, MU)
        u, b = clouds.state_based_field(*known), clouds.state_based_load(*known)
        for name, found in errors.items():
            force = kernel(name, 3 * spacing, spacing).on(points)(u)
            found.append(np.abs(force - b[points.interior]).max())
    assert fitted_order(1 / NUMBERS, errors["1/r"]) >= 1.9
    assert fitted_order(1 / NUMBERS, errors["steep"]) < 0.5


def test_perturbed_points_lose_order_where_the_material_is_nearly_incompressible():
    """Φ and Ψ are no transposes there: at λ = 10⁴ μ their mismatch outweighs μΓ."""
    assert max(state_based(scattered, 3.0, 1e4 * MU)) < 1
    points = scattered(8, 3.0 * LENGTH / 8)
    assert check_solvability(clouds.plain(3.0 * LENGTH / 8, 1e4 * MU, MU), points).symmetric_min < 0
    assert check_solvability(clouds.plain(3.0 * LENGTH / 8, 100 * MU, MU), points).symmetric_min > 0
