"""Cut bodies: corrected dilatation, affine fields, and the traction-free problem of the paper."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.clouds import cloud, plain
from tests.support.problems import ell, fitted_order, kernel, lattice, noise
from tests.support.solving import solve
from warp_peri import InputError, Model, certify
from warp_peri.materials.lps_matrices import matrices
from warp_peri.points.families import families_of

pytestmark = pytest.mark.filterwarnings("ignore:spacing. the model is certified")
HORIZON = 3.0
GRADIENT = np.array([[0.3, -0.7], [0.2, 0.9]])


def notched(points):
    """Nodes outside a body with a corner and a curved edge."""
    x, y = (points.x - points.x[points.interior].mean(axis=0)).T
    return ((x > 1) & (y > 0.4)) | (np.hypot(x + 5, y) < 4.3)


BODIES = {"lattice": lattice(ell(), HORIZON), "cloud": cloud(6, HORIZON)}


@pytest.mark.parametrize("points", BODIES.values(), ids=BODIES)
@pytest.mark.parametrize("name", ["1/r", "positive"])
def test_dilatation_of_an_affine_field_is_exact_on_a_cut_body(points, name):
    outside = notched(points)
    body = replace(points, interior=points.interior & ~outside, outside=outside)
    families = families_of(body, HORIZON)
    assert len(families.cut) > 5
    u = points.x @ GRADIENT.T + (0.4, -1.3)
    u[outside] = np.nan  # nobody looks
    theta = matrices(kernel(name, HORIZON), body).phi
    theta = theta @ np.nan_to_num(u, nan=1e3).ravel()
    np.testing.assert_allclose(theta[families.cut], np.trace(GRADIENT), rtol=0, atol=1e-11)


@pytest.mark.parametrize("points", BODIES.values(), ids=BODIES)
def test_force_of_an_affine_field_vanishes_where_the_ball_of_twice_the_horizon_is_full(points):
    outside = notched(points)
    body = replace(points, interior=points.interior & ~outside, outside=outside)
    operator = plain(HORIZON).on(body, allow_uncertified=True)
    force = operator(points.x @ GRADIENT.T)
    gap = np.linalg.norm(body.x[body.interior][:, None] - points.x[outside], axis=2).min(axis=1)
    full = gap > 2 * HORIZON
    rough = np.abs(operator(noise(points))).max()
    assert not full.any() or np.abs(force[full]).max() < 1e-11 * rough
    near = gap < HORIZON
    assert np.abs(force[near]).max() > 1e-3 * rough


def test_force_is_exact_deep_in_a_body_with_a_far_surface():
    points = lattice(14, HORIZON)
    outside = points.x[:, 0] > 12.5
    body = replace(points, interior=points.interior & ~outside, outside=outside)
    operator = plain(HORIZON).on(body, allow_uncertified=True)
    force = operator(points.x @ GRADIENT.T)
    deep = body.x[body.interior, 0] < 13 - 2 * HORIZON
    assert deep.sum() >= 14 * 7
    assert np.abs(force[deep]).max() < 1e-11
    assert np.abs(force[~deep]).max() > 1e-2


def test_matrices_are_the_operator_on_a_cut_body():
    points = BODIES["cloud"]
    outside = notched(points)
    body = replace(points, interior=points.interior & ~outside, outside=outside)
    model = kernel("sign-changing", HORIZON)
    u = noise(points)
    expected = model.on(body, allow_uncertified=True)(u)
    L = matrices(model, body).operator(model.lam, model.mu)
    np.testing.assert_allclose((L @ u.ravel()).reshape(-1, 2), expected, rtol=0, atol=1e-9)


def traction_free(lam, mu, number, points):
    """Largest error on a unit square whose right edge is free, under no load."""
    h = 1 / number
    model = plain(HORIZON * h, lam, mu)
    outside = points.x[:, 0] > 1
    body = replace(points, interior=points.interior & ~outside, outside=outside)
    a, b = points.x.T
    stretch = 3 * lam / (lam + 2 * mu)  # no stress across the edge; 1 where λ = μ, as printed
    exact = np.stack([stretch * a + b, -a - 3 * b], axis=1)
    given = np.where(outside[:, None], 0.0, exact)
    u = solve(model, body, 0 * exact, given, allow_uncertified=True)
    return np.abs(u - exact)[body.interior].max()


@pytest.mark.parametrize("lam", [0.8, 0.3, -0.2, 2.4], ids=["bond-based", "0.3", "-0.2", "2.4"])
def test_a_free_edge_is_right_to_the_first_order(lam):
    numbers = np.array([8, 16, 32])
    errors = []
    for n in numbers:
        points = lattice(n, HORIZON / n, 1 / n)
        errors.append(traction_free(lam, 0.8, n, replace(points, x=points.x + 0.5 / n)))
    assert 0.9 <= fitted_order(1 / numbers, errors) <= 1.5
    assert errors[-1] < 0.011


@pytest.mark.parametrize(
    "outside",
    [np.zeros(3, bool), np.zeros(len(BODIES["lattice"].x)), BODIES["lattice"].interior],
    ids=["few", "numbers", "interior"],
)
def test_an_outside_that_does_not_fit_is_refused(outside):
    with pytest.raises(InputError, match="outside: expected (shape|bool|true for no interior)"):
        replace(BODIES["lattice"], outside=outside)


def test_a_cut_operator_that_is_not_definite_is_refused_or_named():
    points = lattice(8, HORIZON)
    outside = points.x[:, 0] > 5.5
    body = replace(points, interior=points.interior & ~outside, outside=outside)
    fields = 0 * points.x, np.where(outside[:, None], 0, points.x @ GRADIENT.T)
    solve(kernel("1/r", HORIZON), body, *fields)
    numbers = {"lam": -0.3, "mu": 0.8, "alpha": 1.0, "D": [-0.5, -0.8, 0.9, 0.1, 0.5]}
    model = Model(**numbers, horizon=HORIZON, certified_on=(1.0,))
    assert certify(model, spacing=1.0).holds
    message = r"smallest eigenvalue of its symmetric part is -0.068"
    with pytest.raises(InputError, match=message):
        solve(model, body, *fields)
    with pytest.warns(UserWarning, match=message):
        solve(model, body, *fields, allow_uncertified=True)
