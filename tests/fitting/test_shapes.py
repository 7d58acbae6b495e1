"""Fits of influence functions given as callables."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.linalg import norm

from tests.support import approx, each_refused, near, parametrize, refused
from tests.support.problems import kernel, lattice, manufactured
from tests.support.shapes import HORIZON, LENGTHS, SHAPES, off, solid
from tests.support.solving import fit
from warp_peri import LPSMaterial, evaluate
from warp_peri.influence import InfluenceFunction, gaussian, named, table
from warp_peri.methods import GaussNewton, TwoStage

RECOVERED = 1e-4
"""Parameters of a shape from data that are exactly in equilibrium: a fit ends at a relative
residual of about 1e-8 and two Gaussians of nearly one width are told apart by a part of that."""
made = lambda shape, count=2: manufactured(solid(shape, 1.0), lattice(4, HORIZON), count)
"""Samples in equilibrium with the solid of a shape."""


@parametrize("name", ["gaussian", "sign-changing", "table"])
def test_a_fit_gives_back_the_shape_that_made_the_data(name, tmp_path):
    shape = SHAPES[name]
    points = made(shape, 3)
    learned = fit(points, HORIZON, off(shape))
    model = learned.material
    value, expected = learned.influence.vector, shape.vector
    if name == "table":  # whose scale has no effect
        value, expected = value / norm(value), expected / norm(expected)
        value = value * np.sign(value @ expected)
    assert value == approx(expected, rel=RECOVERED, abs=0)
    assert (model.lam, model.mu) == approx((0.1, 0.7), rel=RECOVERED)
    assert model.certified_on == (1.0,)
    assert learned.certificate.symbol_bound >= 0.01
    assert evaluate(model, points)["E_u"] < 1e-6
    model.save(tmp_path / "model.json")
    again = LPSMaterial.load(tmp_path / "model.json")
    assert again.provenance["influence"]["function"] == shape.name
    near(again.influence(LENGTHS), model.influence(LENGTHS), 0)


def test_a_given_table_leaves_the_constants_to_learn_and_bounds_are_kept():
    shape = table([0.5, 1.5, 3.0], [1.0, 0.6, 0.1])
    learned = fit(made(shape), HORIZON, shape)
    assert learned.influence.parameters == {}
    assert (learned.material.lam, learned.material.mu) == approx((0.1, 0.7), rel=RECOVERED)
    bounded = InfluenceFunction(gaussian, {"width": 2.4}, {"width": (2.2, 3.0)})
    learned = fit(made(SHAPES["gaussian"]), HORIZON, bounded)
    assert learned.influence.parameters["width"] == approx(2.2, abs=1e-6)


def test_the_best_of_several_starts_is_taken_and_one_that_leaves_its_domain_passed_over():
    def logarithm(r, a):
        with np.errstate(invalid="ignore"):
            return np.log(a - r)

    points, bad = made(SHAPES["gaussian"]), InfluenceFunction(logarithm, {"a": 3.01})
    kernels = [bad, SHAPES["exponential"], off(SHAPES["gaussian"]), named("conical", HORIZON)]
    learned = fit(points, HORIZON, kernels)
    assert learned.influence.name == "gaussian"
    assert list(learned.starts) == ["1 exponential", "2 gaussian", "3 conical"]
    assert learned.starts["2 gaussian"] < 1e-6 < learned.starts["3 conical"]
    with refused("'logarithm': K is not finite"):
        fit(points, HORIZON, bad)


def test_what_a_fit_of_shapes_refuses():
    flat, shape = table([0.5, 3.0], [1.0, 0.1]), SHAPES["gaussian"]
    with pytest.raises(RuntimeError, match="moduli to be held missed by"):
        fit(made(flat), HORIZON, flat, method=GaussNewton(moduli=(-0.2, 0.7)))
    each_refused(lambda options: fit(made(shape, 1), HORIZON, **options), {
        "learned by GaussNewton or Aug": {"kernel": shape, "method": TwoStage()},
        r"f\(r, width\) is InfluenceFunction\(f, ": {"kernel": gaussian},
    })  # fmt: skip


def test_a_width_is_found_from_far_off():
    """Of data of another kernel: from a width near the best, and from the horizon on."""
    points = manufactured(kernel("1/r", 12.5, spacing=5.0), lattice(8, 25.0, 5.0), 8, 0, 0.2)
    shapes = [replace(named("gaussian", 20.0), parameters={"width": w}) for w in (8.0, 20.0)]
    near, far = (fit(points, 20.0, shape, loss="residual") for shape in shapes)
    assert far.influence.parameters["width"] == approx(near.influence.parameters["width"])
    assert far.history[-1].loss[-1] == approx(near.history[-1].loss[-1], rel=1e-6)
