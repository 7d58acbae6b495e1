"""Fits of influence functions given as callables."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from tests.support.problems import kernel, lattice, manufactured, with_nodes
from tests.support.shapes import HORIZON, LENGTHS, SHAPES, every_shape, off, solid
from tests.support.waves import fluctuation, noisy, waves
from warp_peri import InputError, evaluate
from warp_peri.learning.fit import learn as fit
from warp_peri.materials.influence import gaussian, named, table
from warp_peri.materials.lps import Model
from warp_peri.methods import Optimum, TwoStage
from warp_peri.shapes import InfluenceFunction

RECOVERED = 1e-4
"""Parameters of a shape from data that are exactly in equilibrium: a fit ends at a relative
residual of about 1e-8 and two Gaussians of nearly one width are told apart by a part of that."""


@every_shape
def test_a_fit_gives_back_the_shape_that_made_the_data(shape, tmp_path):
    points = manufactured(solid(shape, 1.0), lattice(4, HORIZON), 3)
    learned = fit(points, horizon=HORIZON, kernel=off(shape))
    model = learned.material
    assert learned.influence is not None
    value, expected = learned.influence.vector, shape.vector
    if shape is SHAPES["table"]:  # whose scale has no effect
        value, expected = value / np.linalg.norm(value), expected / np.linalg.norm(expected)
        value = value * np.sign(value @ expected)
    np.testing.assert_allclose(value, expected, rtol=RECOVERED)
    assert (model.lam, model.mu) == pytest.approx((0.1, 0.7), rel=RECOVERED)
    assert model.certified_on == (1.0,)
    assert learned.certificate.symbol_bound >= 0.01
    assert evaluate(model, points)["E_u"] < 1e-6
    model.save(tmp_path / "model.json")
    again = Model.load(tmp_path / "model.json")
    assert again.provenance["influence"]["function"] == shape.name
    np.testing.assert_array_equal(again.influence(LENGTHS), model.influence(LENGTHS))


def test_two_lattices_at_once():
    shape, spacings = SHAPES["sign-changing"], (1.0, 0.8)
    sets = [manufactured(solid(shape, *spacings), lattice(4, HORIZON, h), 2) for h in spacings]
    learned = fit(sets, horizon=HORIZON, kernel=off(shape))
    assert learned.influence is not None
    np.testing.assert_allclose(learned.influence.vector, shape.vector, rtol=RECOVERED)
    assert learned.material.certified_on == spacings


def test_a_given_table_leaves_the_constants_to_learn():
    shape = table([0.5, 1.5, 3.0], [1.0, 0.6, 0.1])
    points = manufactured(solid(shape, 1.0), lattice(4, HORIZON), 2)
    learned = fit(points, horizon=HORIZON, kernel=shape)
    assert learned.influence is not None
    assert learned.influence.parameters == {}
    assert (learned.material.lam, learned.material.mu) == pytest.approx((0.1, 0.7), rel=RECOVERED)


def test_bounds_are_kept():
    shape = SHAPES["gaussian"]
    points = manufactured(solid(shape, 1.0), lattice(4, HORIZON), 2)
    bounded = InfluenceFunction(gaussian, {"width": 2.4}, {"width": (2.2, 3.0)})
    learned = fit(points, horizon=HORIZON, kernel=bounded)
    assert learned.influence is not None
    assert learned.influence.parameters["width"] == pytest.approx(2.2, abs=1e-6)


def test_the_fit_does_not_need_a_forecast_of_the_width():
    shape = SHAPES["gaussian"]
    points = manufactured(solid(shape, 1.0), lattice(4, HORIZON), 2)
    learned = fit(points, horizon=HORIZON, kernel=named("gaussian", HORIZON))
    assert learned.influence is not None
    assert learned.influence.parameters["width"] == pytest.approx(1.9, rel=RECOVERED)


def test_the_output_error_fit_takes_shapes():
    shape = SHAPES["gaussian"]
    true = solid(shape, 1.0, horizon=2.5)
    clean = waves(true, cells=4, highest=6)
    size = 0.002
    noise = fluctuation(clean, 8, size, seed=1)
    data = noisy(clean, size, seed=2)
    learned = fit(data, horizon=2.5, kernel=off(shape), loss="output", noise=noise)
    K = 2.0

    def ratio(model):
        return model.influence(K) / model.influence(1.0)

    assert learned.loss.name == "output"
    assert ratio(learned.material) == pytest.approx(ratio(true), abs=0.05)
    assert learned.material.mu == pytest.approx(true.mu, rel=2e-3)


@pytest.mark.parametrize("start", [1e-300, 1e-12, 1e-6])
def test_a_start_beside_zero_is_no_trap(start):
    def falling(r, a):
        return np.exp(-a * r**2)

    true = InfluenceFunction(falling, {"a": 0.28})
    points = manufactured(solid(true, 1.0), lattice(4, HORIZON), 2)
    learned = fit(points, horizon=HORIZON, kernel=true.at(np.array([start])))
    assert learned.influence is not None
    assert learned.influence.parameters["a"] == pytest.approx(0.28, rel=RECOVERED)


def test_a_start_that_leaves_its_domain_is_passed_over():
    def logarithm(r, a):
        with np.errstate(invalid="ignore"):
            return np.log(a - r)

    points = manufactured(solid(SHAPES["gaussian"], 1.0), lattice(4, HORIZON), 2)
    bad = InfluenceFunction(logarithm, {"a": 3.01})
    learned = fit(points, horizon=HORIZON, kernel=[bad, off(SHAPES["gaussian"])])
    assert list(learned.starts) == ["1 gaussian"]
    with pytest.raises(InputError, match="'logarithm': K is not finite"):
        fit(points, horizon=HORIZON, kernel=bad)


@pytest.mark.parametrize("moduli", [(-0.2, 0.7), "isotropic"])
def test_moduli_that_a_shape_cannot_have_are_no_result(moduli):
    shape = table([0.5, 3.0], [1.0, 0.1])
    points = manufactured(solid(shape, 1.0), lattice(4, HORIZON), 2)
    with pytest.raises(RuntimeError, match="moduli to be held missed by"):
        fit(points, horizon=HORIZON, kernel=shape, method=Optimum(moduli=moduli))


def test_a_fit_with_a_table_travels():
    shape = table([0.5, 1.5, 3.0], [1.0, 0.6, 0.1], learned=True)
    again = pickle.loads(pickle.dumps(shape))
    np.testing.assert_array_equal(again(LENGTHS), shape(LENGTHS))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kernel": SHAPES["gaussian"], "method": TwoStage()}, "learned by Optimum or Constr"),
        ({"kernel": gaussian}, r"f\(r, width\) is InfluenceFunction\(f, "),
        ({"kernel": "gaussian"}, "expected an InfluenceFunction or a list of them"),
        ({"kernel": [gaussian]}, "expected an InfluenceFunction or a list of them"),
        ({"kernel": []}, "expected Bernstein"),
    ],
)
def test_what_a_fit_refuses(options, message):
    points = manufactured(kernel("1/r", HORIZON), lattice(3, HORIZON), 1)
    with pytest.raises(InputError, match=message):
        fit(points, horizon=HORIZON, **options)


def test_scattered_points_are_refused():
    points = manufactured(kernel("1/r", HORIZON), lattice(3, HORIZON), 1)
    scattered = with_nodes(points, spacing=0.0)
    with pytest.raises(InputError, match="got scattered points; transfers.onto_lattice"):
        fit(scattered, horizon=HORIZON, kernel=SHAPES["gaussian"])


def test_several_starts_and_the_best_of_them():
    shape = SHAPES["gaussian"]
    points = manufactured(solid(shape, 1.0), lattice(4, HORIZON), 2)
    others = [SHAPES["exponential"], named("conical", HORIZON)]
    learned = fit(points, horizon=HORIZON, kernel=[others[0], off(shape), others[1]])
    assert learned.influence is not None
    assert learned.influence.name == "gaussian"
    assert list(learned.starts) == ["0 exponential", "1 gaussian", "2 conical"]
    assert learned.starts["1 gaussian"] < 1e-6 < learned.starts["2 conical"]


def test_a_width_is_found_from_far_off():
    """Of data of another kernel: from a width near the best, and from the horizon on."""
    made = manufactured(kernel("1/r", 12.5, spacing=5.0), lattice(8, 25.0, 5.0), 8, 0, 0.2)
    near, far = (
        fit(
            made,
            20.0,
            replace(named("gaussian", 20.0), parameters={"width": width}),
            loss="residual",
        )
        for width in (8.0, 20.0)
    )
    assert far.influence.parameters["width"] == pytest.approx(near.influence.parameters["width"])
    assert far.history[-1].loss[-1] == pytest.approx(near.history[-1].loss[-1], rel=1e-6)
