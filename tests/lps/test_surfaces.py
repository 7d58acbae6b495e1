"""Cut bodies: corrected dilatation, affine fields, and the traction-free problem of the paper."""

import numpy as np

from tests.support import approx, clouds, filterwarnings, parametrize, refused, warned
from tests.support.clouds import cloud, plain
from tests.support.problems import cut, ell, fitted_order, kernel, lattice, noise, normal
from tests.support.solving import solve
from warp_peri import LPSMaterial, certify
from warp_peri.materials.lps_operator import LPSOperator
from warp_peri.points.families import families_of

pytestmark = filterwarnings("ignore:spacing. the model is certified")
HORIZON = 3.0


def body(points):
    """Without what is outside of a corner and a curved edge, in space of a face."""
    a, b, *deep = (points.x - points.x[points.interior].mean(0)).T
    outside = a > 0.5 if deep else ((a > 1) & (b > 0.4)) | (np.hypot(a + 5, b) < 4.3)
    return cut(points, outside)


BODIES = {
    "lattice": (body(lattice(ell(), HORIZON)), kernel("sign-changing", HORIZON)),
    "cloud": (body(cloud(6, HORIZON)), kernel("sign-changing", HORIZON)),
    "space": (body(clouds.cube(3, 2.0)), clouds.solid(2.0, alpha=1.2, D=[1.0, -0.3, 0.6])),
}


@parametrize(("points", "model"), BODIES.values(), ids=BODIES)
def test_dilatation_of_an_affine_field_is_exact_and_matrices_are_the_operator(points, model):
    d, parts = points.dimension, LPSOperator(model, points).matrices
    G = normal((d, d), 6)
    u = points.x @ G.T + 0.4
    u[points.outside] = 1e3  # nobody looks
    cut = families_of(points, model.horizon).cut
    assert len(cut) > 5
    assert (parts.phi @ u.ravel())[cut] == approx(np.trace(G), abs=1e-11)
    u = noise(points)
    expected = model.on(points, allow_uncertified=True)(u)
    L = parts.operator(model.lam, model.mu)
    assert (L @ u.ravel()).reshape(-1, d) == approx(expected, abs=1e-9)


def traction_free(lam, mu, n):
    """Largest error on a unit square whose right edge is free, under no load."""
    points = lattice(n, HORIZON / n, 1 / n, origin=(0.5 / n, 0.5 / n))
    outside, (a, b) = points.x[:, 0] > 1, points.x.T
    points = cut(points, outside)
    stretch = 3 * lam / (lam + 2 * mu)  # no stress across the edge; 1 where λ = μ, as printed
    exact = np.c_[stretch * a + b, -a - 3 * b]
    given = np.where(outside[:, None], 0.0, exact)
    u = solve(plain(HORIZON / n, lam, mu), points, 0 * exact, given, allow_uncertified=True)
    return np.abs(u - exact)[points.interior].max()


def test_a_free_edge_is_right_to_the_first_order():
    numbers = np.array([8, 16, 32])
    errors = [traction_free(2.4, 0.8, n) for n in numbers]
    assert 0.9 <= fitted_order(1 / numbers, errors) <= 1.5
    assert errors[-1] < 0.011


def test_a_cut_operator_that_is_not_definite_is_refused_or_named():
    points = lattice(8, HORIZON)
    outside = points.x[:, 0] > 5.5
    points = cut(points, outside)
    fields = 0 * points.x, np.where(outside[:, None], 0, points.x @ [[0.3, 0.2], [-0.7, 0.9]])
    solve(kernel("1/r", HORIZON), points, *fields)
    model = LPSMaterial(-0.3, 0.8, 1.0, [-0.5, -0.8, 0.9, 0.1, 0.5], HORIZON, certified_on=(1.0,))
    assert certify(model, spacing=1.0).holds
    message = r"smallest eigenvalue of its symmetric part is -0.068"
    with refused(message):
        solve(model, points, *fields)
    with warned(message):
        solve(model, points, *fields, allow_uncertified=True)
