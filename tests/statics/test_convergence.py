"""The local limit: K = 1/r at fixed δ/h against linear elasticity."""

import numpy as np
import pytest

from tests.support.problems import LAM, MU, ORDER, fitted_order, kernel, lattice
from tests.support.solving import solve
from warp_peri.transfer.operator import LPSOperator

SPACINGS = 1 / np.array([6, 12, 24])


def field(x):
    """A smooth displacement, shape [N, 2]."""
    X, Y = x.T
    return np.stack([np.sin(1.3 * X + 0.4) * np.cos(0.8 * Y), np.exp(0.4 * X) * np.sin(Y)], axis=1)


def load(x, lam, mu):
    """−[μ ∇²u + (λ + μ) ∇(∇·u)] of that displacement."""
    X, Y = x.T
    a, b = 1.3, 0.8
    s, c = np.sin(a * X + 0.4), np.cos(a * X + 0.4)
    sy, cy, e = np.sin(b * Y), np.cos(b * Y), np.exp(0.4 * X)
    u1, u2 = s * cy, e * np.sin(Y)
    laplacian = np.stack([-(a**2 + b**2) * u1, (0.16 - 1) * u2], axis=1)
    divergence_x = -(a**2) * u1 + 0.4 * e * np.cos(Y)
    divergence_y = -a * b * c * sy - u2
    return -mu * laplacian - (lam + mu) * np.stack([divergence_x, divergence_y], axis=1)


def problem(spacing, ratio):
    number = round(1 / spacing) + 1
    return lattice(number, ratio * spacing, spacing), kernel("1/r", ratio * spacing, spacing)


def test_the_load_is_that_of_the_field():
    x, step = np.array([[0.3, 0.7]]), 1e-3

    def second(a, b):
        corners = [(p, q, p * q) for p in (-1, 1) for q in (-1, 1)]
        if a == b:
            e = step * np.eye(2)[a]
            return (field(x + e) - 2 * field(x) + field(x - e))[0] / step**2
        return sum(w * field(x + step * np.array([p, q]))[0] for p, q, w in corners) / (4 * step**2)

    xx, yy, xy = second(0, 0), second(1, 1), second(0, 1)
    expected = -0.8 * (xx + yy) - 1.1 * np.array([xx[0] + xy[1], xy[0] + yy[1]])
    np.testing.assert_allclose(load(x, 0.3, 0.8)[0], expected, rtol=1e-5)


@pytest.mark.parametrize("ratio", [2.0, 3.0])
def test_the_operator_converges_with_the_square_of_the_spacing(ratio):
    errors = []
    for spacing in SPACINGS:
        points, model = problem(spacing, ratio)
        force = LPSOperator(model, points)(field(points.x))
        errors.append(np.abs(force - load(points.x[points.interior], LAM, MU)).max())
    assert fitted_order(SPACINGS, errors) >= ORDER


@pytest.mark.parametrize("ratio", [2.0, 3.0])
def test_the_solution_converges_with_the_square_of_the_spacing(ratio):
    errors = []
    for spacing in SPACINGS:
        points, model = problem(spacing, ratio)
        exact = field(points.x)
        u = solve(model, points, load(points.x, LAM, MU), exact)
        errors.append(np.abs(u - exact).max())
    assert fitted_order(SPACINGS, errors) >= ORDER


def test_other_kernels_converge_to_other_constants():
    """The reason why the limit is tested with K = 1/r: the moduli of others are not λ and μ."""
    errors = []
    for spacing in SPACINGS:
        points, _ = problem(spacing, 3.0)
        steep = kernel("steep", 3.0 * spacing, spacing)
        force = LPSOperator(steep, points)(field(points.x))
        errors.append(np.abs(force - load(points.x[points.interior], LAM, MU)).max())
    assert fitted_order(SPACINGS, errors) < 0.5
