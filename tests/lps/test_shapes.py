"""Influence functions given as callables: their polynomial and their gradients."""

import dataclasses
import re

import numpy as np
import pytest
import torch

from tests.support.problems import GRADIENT, REDUCED, difference, kernel, lattice, manufactured
from tests.support.shapes import HORIZON, LENGTHS, SHAPES, every_shape, off, solid
from warp_peri import InputError, certify
from warp_peri.fitting.regression import Regression
from warp_peri.fitting.settings import Conditions, Optimum
from warp_peri.fitting.training_data import sample_weights
from warp_peri.materials.influence import gaussian, table
from warp_peri.materials.lps import Solid, stiffnesses
from warp_peri.materials.lps_fit import LPSFound, LPSLaw, Products, ShapeKernel
from warp_peri.materials.lps_loss import OperatorLoss
from warp_peri.points.families import bond_classes
from warp_peri.shapes import InfluenceFunction

# The polynomial


@every_shape
@pytest.mark.parametrize("spacings", [(1.0,), (1.0, 0.8)], ids=["one lattice", "two lattices"])
def test_the_polynomial_is_the_function_at_every_bond(shape, spacings):
    model = solid(shape, *spacings)
    for spacing in spacings:
        r = bond_classes(spacing, HORIZON).r
        np.testing.assert_allclose(model.influence(r), shape(r), atol=1e-8 * np.abs(shape(r)).max())


@pytest.mark.parametrize("name", ["gaussian", "exponential", "conical", "sign-changing"])
def test_a_smooth_function_is_kept_between_the_bonds_too(name):
    shape = SHAPES[name]
    r = np.linspace(LENGTHS[0] / 2, HORIZON, 1001)
    K = shape(r)
    np.testing.assert_allclose(solid(shape, 1.0).influence(r), K, atol=3e-8 * np.abs(K).max())


def test_how_far_a_kinked_function_is_off_is_said():
    shape = SHAPES["table"]
    model = solid(shape, 1.0)
    r = np.linspace(LENGTHS[0] / 2, HORIZON, 1001)
    size = np.abs(shape(LENGTHS)).max()
    departure = np.abs(model.influence(r) - shape(r)).max() / size
    assert model.provenance["influence"]["departure"] == pytest.approx(departure, rel=0.2)
    assert departure > 1e-4


def test_one_over_r_is_the_solid_of_that_exponent():
    shape = InfluenceFunction(lambda r, a: r**-a, {"a": 1.0})
    classes = bond_classes(1.0, HORIZON)
    tables = stiffnesses(solid(shape, 1.0, lam=0.3, mu=0.8), classes)
    for stiffness, expected in zip(tables, stiffnesses(kernel("1/r", HORIZON), classes)):
        np.testing.assert_allclose(stiffness, expected, atol=1e-8)


def test_a_function_with_a_jump_between_close_bonds_is_refused():
    jagged = InfluenceFunction(lambda r: 1.0 + (np.round(r * 1e3) % 2))
    with pytest.raises(InputError, match="no polynomial of degree 80 takes its values"):
        jagged.model(lam=0.0, mu=1.0, horizon=20.0, spacings=[5.0, 2.5, 2.0, 1.0])


# Derivatives


@every_shape
def test_slopes(shape):
    expected = difference(lambda p: shape.at(p)(LENGTHS), shape.vector, 1e-3).T
    np.testing.assert_allclose(shape.slopes(LENGTHS), expected, rtol=1e-9, atol=1e-9)


def test_slopes_of_a_gaussian_are_those_of_the_formula():
    shape = SHAPES["gaussian"]
    expected = 2 * LENGTHS**2 / 1.9**3 * gaussian(LENGTHS, 1.9)
    np.testing.assert_allclose(shape.slopes(LENGTHS)[:, 0], expected, rtol=1e-11)


@every_shape
def test_coordinates(shape):
    lattices = [bond_classes(1.0, HORIZON), bond_classes(0.8, HORIZON)]
    shape = dataclasses.replace(shape, bounds={next(iter(shape.parameters)): (-5.0, 9.0)})
    start = LPSFound(Solid(0.1, 0.7, 0.0, np.ones(1)), shape)
    law = LPSLaw(lattices, start, Conditions(zeta=0.01), Optimum(moduli=None, smoothness=1e-3))
    assert isinstance(law.kernel, ShapeKernel)
    theta = law.start(start)
    tables, _, dmu = law.stiffnesses(theta)

    def values(theta):
        tables, mu, _ = law.stiffnesses(theta)
        at = law(theta)
        return np.concatenate([[mu], *(v for v, _ in tables), at.margins, at.beside])

    at = law(theta)
    derivatives = np.concatenate([dmu[None], *(dv for _, dv in tables), at.M, at.by])
    assert len(at.margins) == 2 + 2 * np.size(next(iter(shape.parameters.values())))
    np.testing.assert_allclose(derivatives, difference(values, theta, 1e-3).T, atol=1e-7)
    for classes, (v, _) in zip(lattices, tables):
        expected = stiffnesses(solid(shape, 1.0, 0.8), classes)
        np.testing.assert_allclose(v, expected[0], atol=1e-8)
        assert theta[0] / 0.7 == pytest.approx(expected[1])


@every_shape
def test_the_gradient_through_the_whole_forward_pass(shape):
    """That of the fit, against differences of the full loss that Warp evaluates."""
    points = manufactured(solid(shape, 1.0), lattice(4, HORIZON), 2)
    (weight,) = sample_weights([points], normalise=False)
    products, full = Products(points, HORIZON), OperatorLoss(points, HORIZON, weight)
    start = LPSFound(Solid(0.3, 0.5, 0.0, np.ones(1)), off(shape))
    law = LPSLaw([products.classes], start, Conditions(zeta=0.01), Optimum(moduli=None))
    problem = Regression([products.rows(weight)], law, 0.01, 1.0)
    y = law.start(start)

    def loss(y):
        solid = law.found(problem.found(y, [1.0], 0.0)).solid
        numbers = (torch.tensor(value, dtype=torch.float64) for value in solid.values())
        return np.array(full.loss(*numbers).item())

    state = problem.state(y)
    e, slope = state.residual, state.J
    expected = difference(loss, y, 1e-3)
    assert e @ e == pytest.approx(loss(y), rel=1e-6)
    assert np.abs(expected).min() > 0 or shape is SHAPES["table"]
    np.testing.assert_allclose(2 * slope.T @ e, expected, atol=GRADIENT * np.abs(expected).max())


def test_derivatives_beside_zero_and_at_the_bounds():
    def wave(r, phase):
        return np.cos(r + phase)

    for phase in (1e-12, 0.0, 0.4, 1.0):
        shape = InfluenceFunction(wave, {"phase": phase}, {"phase": (0.0, 1.0)})
        expected = -np.sin(LENGTHS + phase)[:, None]
        np.testing.assert_allclose(shape.slopes(LENGTHS), expected, atol=1e-10)


# What is refused


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"function": gaussian, "parameters": {"width": np.nan}}, "width: expected finite numbers"),
        ({"function": gaussian, "parameters": {"width": "2"}}, "width: expected finite numbers"),
        ({"function": 3}, "expected a function of r, got 3"),
        ({"function": gaussian, "parameters": [8.0]}, "parameters: expected a dict, got [8.0]"),
        (
            {"function": gaussian, "parameters": {"width": 2.0}, "bounds": {"width": 5}},
            "bounds of width: expected (lowest, highest), got 5",
        ),
        (
            {"function": gaussian, "parameters": {"width": 2.0}, "bounds": {"width": (1, None)}},
            "bounds of width: expected (lowest, highest), got (1, None)",
        ),
        (
            {"function": gaussian, "parameters": {"width": 2.0}, "bounds": {"reach": (0, 1)}},
            "no parameter 'reach'; there are: width",
        ),
        (
            {"function": gaussian, "parameters": {"width": 2.0}, "bounds": {"width": (3, 1)}},
            "bounds of width: expected (lowest, highest), got (3, 1)",
        ),
        (
            {"function": gaussian, "parameters": {"width": 2.0}, "bounds": {"width": (3, 4)}},
            "are not within",
        ),
    ],
)
def test_parameters_that_make_no_sense(options, message):
    with pytest.raises(InputError, match=re.escape(message)):
        InfluenceFunction(**options)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda r: r[0], r"expected K of shape \[6\], the shape of r, got \[\]"),
        (lambda r: np.where(r > 2, np.nan, 1.0), "K is not finite at r = 2.23607"),
        (lambda r: 0 * r, "K is zero at every bond length"),
        (lambda r: 1j * r, "expected real K, got complex128"),
    ],
)
def test_functions_that_are_no_influence_function(function, message):
    with pytest.raises(InputError, match=message):
        InfluenceFunction(function).coefficients(LENGTHS, HORIZON)


def test_a_function_may_change_what_it_gets_and_return_a_list():
    def careless(r, c):
        r *= c[0]
        c[0] = 7.0
        return list(r)

    shape = InfluenceFunction(careless, {"c": [2, 3]})
    assert shape.parameters["c"].dtype == float
    before = LENGTHS.copy()
    np.testing.assert_allclose(shape(LENGTHS), 2 * before)
    np.testing.assert_array_equal(LENGTHS, before)
    np.testing.assert_allclose(shape(LENGTHS), 2 * before)


def test_a_volume_of_zero():
    classes = bond_classes(1.0, HORIZON)
    size = classes.count * classes.r**2 * classes.weight
    shape = InfluenceFunction(lambda r: np.interp(r, LENGTHS, np.array([1, -1, 0, 0, 0, 0]) / size))
    with pytest.raises(InputError, match="weighted volume"):
        ShapeKernel([classes], shape)


@pytest.mark.parametrize(
    ("r", "K", "message"),
    [
        ([0, 1], [1.0], "of one shape"),
        ([1, 0], [1.0, 1.0], "rising"),
        ([0, 1], [1.0, np.inf], "finite K"),
    ],
)
def test_tables_that_make_no_sense(r, K, message):
    with pytest.raises(InputError, match=message):
        table(r, K)


def test_certify_takes_a_model_made_from_a_shape():
    model = SHAPES["gaussian"].model(lam=0.1, mu=0.7, horizon=HORIZON, spacings=[1.0])
    certificate = certify(model, spacing=1.0)
    assert certificate.holds
    assert certificate.symbol_bound <= certificate.symbol_min * (1 + REDUCED)
