"""Influence functions given as callables: their polynomial, their fit, their gradients."""

import dataclasses
import pickle
import re

import numpy as np
import pytest
import torch

from tests.problems import GRADIENT, REDUCED, difference, kernel, lattice, manufactured
from tests.waves import fluctuation, noisy, waves
from warp_peri import InfluenceFunction, InputError, certify, evaluate, fit, load_model
from warp_peri.conditions import Conditions
from warp_peri.families import bond_classes
from warp_peri.full_loss import FullLoss, sample_weights
from warp_peri.optimum import Problem
from warp_peri.parameters import Parameters
from warp_peri.reduced import reduce
from warp_peri.shape_coordinates import ShapeCoordinates
from warp_peri.shapes import conical, exponential, gaussian, named, table
from warp_peri.symbol import stiffnesses
from warp_peri.uncertainty import fit_uncertainty

HORIZON = 3.0
LENGTHS = bond_classes(1.0, HORIZON).r
RECOVERED = 1e-4
"""Parameters of a shape from data that are exactly in equilibrium: a fit ends at a relative
residual of about 1e-8 and two Gaussians of nearly one width are told apart by a part of that."""


def humps(r, width, ratio, size):
    """Two Gaussians, the wider one of size −`size`."""
    return np.exp(-((r / width) ** 2)) - size * np.exp(-((r / (ratio * width)) ** 2))


def lines(r, K):
    """A table whose values are what is learned."""
    return np.interp(r, [0.5, 1.5, 2.5, 3.0], K)


SHAPES = {
    "gaussian": InfluenceFunction(gaussian, {"width": 1.9}),
    "exponential": InfluenceFunction(exponential, {"length": 1.2}),
    "conical": InfluenceFunction(conical, {"reach": 3.7}),
    "sign-changing": InfluenceFunction(
        humps,
        {"width": 1.6, "ratio": 2.0, "size": 0.1},
        {"width": (0.5, 4.0), "ratio": (1.1, 3.0), "size": (0.0, 0.9)},
    ),
    "table": InfluenceFunction(lines, {"K": [1.0, 0.7, -0.1, 0.2]}),
}
every_shape = pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)


def solid(shape, *spacings, lam=0.1, mu=0.7, horizon=HORIZON):
    """The model of a shape, taken as certified."""
    model = shape.model(lam=lam, mu=mu, horizon=horizon, spacings=spacings)
    return dataclasses.replace(model, certified_on=spacings)


def off(shape):
    """The same shape with parameters that are 10 to 20 % off."""
    change = 1 + 0.1 * (1 + np.arange(len(shape.vector)) / len(shape.vector))
    return shape.at(shape.vector * change)


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
    found = np.abs(model.influence(r) - shape(r)).max() / size
    assert model.provenance["influence"]["departure"] == pytest.approx(found, rel=0.2)
    assert found > 1e-4


def test_one_over_r_is_the_solid_of_that_exponent():
    shape = InfluenceFunction(lambda r, a: r**-a, {"a": 1.0})
    classes = bond_classes(1.0, HORIZON)
    found = stiffnesses(solid(shape, 1.0, lam=0.3, mu=0.8), classes)
    for one, expected in zip(found, stiffnesses(kernel("1/r", HORIZON), classes)):
        np.testing.assert_allclose(one, expected, atol=1e-8)


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
    coordinates = ShapeCoordinates(lattices, shape)
    y = coordinates.start(Parameters(0.1, 0.7, 0.0, np.ones(1), shape=shape))
    point = coordinates.point(y)

    def values(y):
        at = coordinates.point(y)
        rough, _ = coordinates.roughness(y, at)
        return np.concatenate([[at.mu], *at.v, *at.z, at.limits, rough])

    _, rough = coordinates.roughness(y, point)
    found = np.concatenate([point.dmu[None], *point.dv, *point.dz, point.dlimits, rough])
    assert len(point.limits) == 2 * np.size(next(iter(shape.parameters.values())))
    np.testing.assert_allclose(found, difference(values, y, 1e-3).T, atol=1e-8)
    for classes, v, z in zip(lattices, point.v, point.z):
        expected = stiffnesses(solid(shape, 1.0, 0.8), classes)
        np.testing.assert_allclose(v, expected[0], atol=1e-8)
        np.testing.assert_allclose(z, expected[1], atol=1e-8)
        assert point.kappa == pytest.approx(expected[2])


@every_shape
def test_the_gradient_through_the_whole_forward_pass(shape):
    """That of the fit, against differences of the full loss that Warp evaluates."""
    points = manufactured(solid(shape, 1.0), lattice(4, HORIZON), 2)
    (weight,) = sample_weights([points], normalise=False)
    classes, full = bond_classes(1.0, HORIZON), FullLoss(points, HORIZON, weight)
    coordinates = ShapeCoordinates([classes], shape)
    problem = Problem(
        [reduce(points, HORIZON, weight)], [Conditions(classes, "direct", 0.01)], coordinates, None
    )
    y = coordinates.start(Parameters(0.3, 0.5, 0.0, np.ones(1), shape=off(shape)))

    def loss(y):
        at = coordinates.parameters(y, [])
        numbers = (
            torch.tensor(value, dtype=torch.float64) for value in (at.lam, at.mu, at.alpha, at.D)
        )
        return np.array(full.loss(*numbers).item())

    e, slope = problem.residual(y)
    expected = difference(loss, y, 1e-3)
    assert e @ e == pytest.approx(loss(y), rel=1e-6)
    assert np.abs(expected).min() > 0 or shape is SHAPES["table"]
    np.testing.assert_allclose(2 * slope.T @ e, expected, atol=GRADIENT * np.abs(expected).max())


# The fit


@every_shape
def test_a_fit_gives_back_the_shape_that_made_the_data(shape, tmp_path):
    points = manufactured(solid(shape, 1.0), lattice(4, HORIZON), 3)
    found = fit(points, horizon=HORIZON, influence=off(shape))
    model = found.model
    assert found.influence is not None
    value, expected = found.influence.vector, shape.vector
    if shape is SHAPES["table"]:  # whose scale has no effect
        value, expected = value / np.linalg.norm(value), expected / np.linalg.norm(expected)
        value = value * np.sign(value @ expected)
    np.testing.assert_allclose(value, expected, rtol=RECOVERED)
    assert (model.lam, model.mu) == pytest.approx((0.1, 0.7), rel=RECOVERED)
    assert model.certified_on == (1.0,)
    assert found.certificate.symbol_bound >= 0.01
    assert evaluate(model, points)["E_u"] < 1e-6
    model.save(tmp_path / "model.json")
    again = load_model(tmp_path / "model.json")
    assert again.provenance["influence"]["function"] == shape.name
    np.testing.assert_array_equal(again.influence(LENGTHS), model.influence(LENGTHS))


def test_two_lattices_at_once():
    shape, spacings = SHAPES["sign-changing"], (1.0, 0.8)
    sets = [manufactured(solid(shape, *spacings), lattice(4, HORIZON, h), 2) for h in spacings]
    found = fit(sets, horizon=HORIZON, influence=off(shape))
    assert found.influence is not None
    np.testing.assert_allclose(found.influence.vector, shape.vector, rtol=RECOVERED)
    assert found.model.certified_on == spacings


def test_a_given_table_leaves_the_constants_to_learn():
    shape = table([0.5, 1.5, 3.0], [1.0, 0.6, 0.1])
    points = manufactured(solid(shape, 1.0), lattice(4, HORIZON), 2)
    found = fit(points, horizon=HORIZON, influence=shape)
    assert found.influence is not None
    assert found.influence.parameters == {}
    assert (found.model.lam, found.model.mu) == pytest.approx((0.1, 0.7), rel=RECOVERED)


@pytest.mark.parametrize("seed", range(4))
def test_a_table_at_every_bond_is_as_good_as_the_polynomial(seed):
    """Both then reach every kernel of the lattice: one optimum, conditions active."""
    first = np.random.default_rng(seed).normal(size=len(LENGTHS)) if seed else 1 / LENGTHS
    true = kernel("sign-changing", HORIZON, lam=-0.3, mu=0.7)
    points = noisy(manufactured(true, lattice(4, HORIZON), 3), 0.02, seed=1)
    shape = table(LENGTHS, first, learned=True)
    found = fit(points, horizon=HORIZON, influence=shape, loss="residual")
    expected = fit(points, horizon=HORIZON, degree=len(LENGTHS) - 1, method="optimum")
    (loss,), reference = found.starts.values(), min(expected.starts.values())
    assert loss == pytest.approx(reference, rel=1e-5)
    classes = bond_classes(1.0, HORIZON)
    for one, other in zip(stiffnesses(found.model, classes), stiffnesses(expected.model, classes)):
        np.testing.assert_allclose(one, other, atol=1e-3)


def test_bounds_are_kept():
    shape = SHAPES["gaussian"]
    points = manufactured(solid(shape, 1.0), lattice(4, HORIZON), 2)
    bounded = InfluenceFunction(gaussian, {"width": 2.4}, {"width": (2.2, 3.0)})
    found = fit(points, horizon=HORIZON, influence=bounded)
    assert found.influence is not None
    assert found.influence.parameters["width"] == pytest.approx(2.2, abs=1e-6)


def test_the_fit_does_not_need_a_forecast_of_the_width():
    shape = SHAPES["gaussian"]
    points = manufactured(solid(shape, 1.0), lattice(4, HORIZON), 2)
    found = fit(points, horizon=HORIZON, influence=named("gaussian", HORIZON))
    assert found.influence is not None
    assert found.influence.parameters["width"] == pytest.approx(1.9, rel=RECOVERED)


def test_noise_and_how_sure_a_shape_is():
    """The output-error fit takes shapes, and its bands speak of them."""
    shape = SHAPES["gaussian"]
    true = solid(shape, 1.0, horizon=2.5)
    clean = waves(true, cells=4, highest=6)
    size = 0.002
    noise = fluctuation(clean, 8, size, seed=1)
    data = noisy(clean, size, seed=2)
    found = fit(data, horizon=2.5, influence=off(shape), loss="output", noise=noise)
    sure = fit_uncertainty(found, data, noise)
    K = 2.0

    def ratio(model):
        return model.influence(K) / model.influence(1.0)

    deviation = sure.deviation(ratio)
    assert 0 < deviation < 0.1
    assert abs(ratio(found.model) - ratio(true)) < 4 * deviation
    assert abs(found.model.mu - true.mu) < 4 * sure.deviation(lambda model: model.mu)


@pytest.mark.parametrize("start", [1e-300, 1e-12, 1e-6])
def test_a_start_beside_zero_is_no_trap(start):
    def falling(r, a):
        return np.exp(-a * r**2)

    true = InfluenceFunction(falling, {"a": 0.28})
    points = manufactured(solid(true, 1.0), lattice(4, HORIZON), 2)
    found = fit(points, horizon=HORIZON, influence=true.at(np.array([start])))
    assert found.influence is not None
    assert found.influence.parameters["a"] == pytest.approx(0.28, rel=RECOVERED)


def test_derivatives_beside_zero_and_at_the_bounds():
    def wave(r, phase):
        return np.cos(r + phase)

    for phase in (1e-12, 0.0, 0.4, 1.0):
        shape = InfluenceFunction(wave, {"phase": phase}, {"phase": (0.0, 1.0)})
        expected = -np.sin(LENGTHS + phase)[:, None]
        np.testing.assert_allclose(shape.slopes(LENGTHS), expected, atol=1e-10)


def test_a_function_is_never_asked_beyond_its_bounds():
    def root(r, a):
        if a < 0:
            raise ValueError("outside")
        return 1 + np.sqrt(a) * r

    true = InfluenceFunction(root, {"a": 0.0}, {"a": (0.0, 5.0)})
    points = manufactured(solid(true, 1.0), lattice(4, HORIZON), 2)
    start = InfluenceFunction(root, {"a": 0.5}, {"a": (0.0, 5.0)})
    found = fit(points, horizon=HORIZON, influence=start)
    assert found.influence is not None
    assert 0 <= found.influence.parameters["a"] < 1e-4


def test_a_start_that_leaves_its_domain_is_passed_over():
    def logarithm(r, a):
        with np.errstate(invalid="ignore"):
            return np.log(a - r)

    points = manufactured(solid(SHAPES["gaussian"], 1.0), lattice(4, HORIZON), 2)
    bad = InfluenceFunction(logarithm, {"a": 3.01})
    found = fit(points, horizon=HORIZON, influence=[bad, off(SHAPES["gaussian"])])
    assert list(found.starts) == ["1 gaussian"]
    with pytest.raises(InputError, match="'logarithm': K is not finite"):
        fit(points, horizon=HORIZON, influence=bad)


@pytest.mark.parametrize("moduli", [(-0.2, 0.7), "isotropic"])
def test_moduli_that_a_shape_cannot_have_are_no_result(moduli):
    shape = table([0.5, 3.0], [1.0, 0.1])
    points = manufactured(solid(shape, 1.0), lattice(4, HORIZON), 2)
    with pytest.raises(RuntimeError, match="moduli to be held missed by"):
        fit(points, horizon=HORIZON, influence=shape, moduli=moduli)


def test_moduli_are_held_by_a_shape_that_can():
    def two(r, a, b):
        return 1 / r + a + b * r

    shape = InfluenceFunction(two, {"a": 0.1, "b": 0.1})
    points = manufactured(solid(shape, 1.0), lattice(4, HORIZON), 2)
    found = fit(points, horizon=HORIZON, influence=shape, moduli=(0.1, 0.6))
    assert found.moduli[0]["C44"] == pytest.approx(0.6, abs=1e-6)
    assert (found.model.lam, found.model.mu) == pytest.approx((0.1, 0.6), abs=1e-6)


def test_a_fit_with_a_table_travels():
    shape = table([0.5, 1.5, 3.0], [1.0, 0.6, 0.1], learned=True)
    again = pickle.loads(pickle.dumps(shape))
    np.testing.assert_array_equal(again(LENGTHS), shape(LENGTHS))


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
        ShapeCoordinates([classes], shape)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "degree, influence: expected one of the two"),
        ({"degree": 3, "influence": SHAPES["gaussian"]}, "expected one of the two"),
        ({"influence": SHAPES["gaussian"], "method": "two-stage"}, "one for both parts"),
        ({"influence": SHAPES["gaussian"], "two_functions": True}, "one for both parts"),
        ({"influence": gaussian}, r"f\(r, width\) is InfluenceFunction\(f, "),
        ({"influence": "gaussian"}, "expected an InfluenceFunction or a list of them"),
        ({"influence": [gaussian]}, "expected an InfluenceFunction or a list of them"),
        ({"degree": 1, "moduli": 0.7}, r"expected \(λ, μ\)"),
        ({"degree": 1, "moduli": (0.7,)}, r"expected \(λ, μ\)"),
        ({"degree": 1, "moduli": (0.1, 0.7, 0.2)}, r"expected \(λ, μ\)"),
    ],
)
def test_what_a_fit_refuses(options, message):
    points = manufactured(kernel("1/r", HORIZON), lattice(3, HORIZON), 1)
    with pytest.raises(InputError, match=message):
        fit(points, horizon=HORIZON, **options)


def test_scattered_points_are_refused():
    points = manufactured(kernel("1/r", HORIZON), lattice(3, HORIZON), 1)
    scattered = dataclasses.replace(points, spacing=0.0)
    with pytest.raises(InputError, match="on lattices only"):
        fit(scattered, horizon=HORIZON, influence=SHAPES["gaussian"])


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


def test_several_starts_and_the_best_of_them():
    shape = SHAPES["gaussian"]
    points = manufactured(solid(shape, 1.0), lattice(4, HORIZON), 2)
    others = [SHAPES["exponential"], named("conical", HORIZON)]
    found = fit(points, horizon=HORIZON, influence=[others[0], off(shape), others[1]])
    assert found.influence is not None
    assert found.influence.name == "gaussian"
    assert list(found.starts) == ["0 exponential", "1 gaussian", "2 conical"]
    assert found.starts["1 gaussian"] < 1e-6 < found.starts["2 conical"]
