"""Errors of a model on data, against their definitions."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support import reference
from tests.support.problems import kernel, lattice, manufactured
from tests.support.solving import solve
from warp_peri import InputError, LPSMaterial, Points, Samples, evaluate

HORIZON = 3.0
MODEL = kernel("sign-changing", HORIZON)
OTHER = kernel("positive", HORIZON)


@pytest.fixture(scope="module")
def points():
    """Three samples in equilibrium with another model."""
    return manufactured(OTHER, lattice(3, HORIZON), 3)


def test_numbers_are_their_definitions(points):
    table = evaluate(MODEL, points)
    inside = points.interior
    residual, load, wrong, size = [], [], [], []
    for u, b in zip(points.u, points.b):
        Lu = reference.operator(points.x, inside, MODEL, u)
        residual.append(np.sqrt(((Lu - b[inside]) ** 2).sum()))
        load.append(np.sqrt((b[inside] ** 2).sum()))
        solved = solve(MODEL, points, b, u)
        wrong.append(np.sqrt(((solved - u)[inside] ** 2).sum()))
        size.append(np.sqrt((u[inside] ** 2).sum()))
    residual, load, wrong, size = map(np.array, (residual, load, wrong, size))
    expected = {
        "E_res": np.mean(residual / load),
        "E_res_abs": np.mean(residual),
        "E_u": np.mean(wrong / size),
        "E_res_samples": residual / load,
        "E_res_abs_samples": residual,
        "E_u_samples": wrong / size,
    }
    assert set(table) >= set(expected)
    for key, value in expected.items():
        assert table[key] == pytest.approx(value, rel=1e-9), key
    assert table["E_res"] > 0.01


def test_the_true_model_has_no_error_whatever_loads_the_collar_bears(points):
    b = points.b.copy()
    b[:, ~points.interior] = 1e9
    table = evaluate(OTHER, replace(points, b=b))
    assert max(table["E_res"], table["E_u"]) < 1e-12


def test_sets_that_have_no_error_to_speak_of_are_refused(points):
    none = np.empty((0, *points.u.shape[1:]))
    with pytest.raises(InputError, match="the set has no samples"):
        evaluate(MODEL, replace(points, u=none, b=none))
    zero = points.u.copy()
    zero[1, points.interior] = 0
    with pytest.raises(InputError, match="u: sample 1 is zero on the interior"):
        evaluate(MODEL, replace(points, u=zero))


@pytest.mark.parametrize("level", [0.0, 1e-16])
def test_without_load_there_is_no_residual_to_be_relative_to(points, level):
    """Displacement is solved for as ever: only the sample's E_res is left out."""
    b = points.b.copy()
    b[1, points.interior] = level
    some, every = evaluate(MODEL, replace(points, b=b)), evaluate(MODEL, points)
    assert some["E_res_samples"][1] is None
    rest = [error for s, error in enumerate(every["E_res_samples"]) if s != 1]
    assert some["E_res"] == pytest.approx(np.mean(rest))
    assert some["E_u_samples"][0] == pytest.approx(every["E_u_samples"][0])
    assert np.isfinite(some["E_u"])
    none = evaluate(MODEL, replace(points, b=np.full_like(b, level)))
    assert none["E_res"] is None
    assert none["E_res_abs"] > 0
    assert none["E_u"] > 0


def test_the_error_of_shape_does_not_see_rigid_motion(points):
    plain = evaluate(MODEL, points)
    turn = 0.5 * np.stack([-points.x[:, 1], points.x[:, 0]], axis=1)
    moved = evaluate(MODEL, replace(points, u=points.u + 100.0 + turn))
    assert moved["E_u"] < 0.1 * plain["E_u"]
    assert moved["E_shape"] == pytest.approx(plain["E_shape"], rel=1e-6)
    assert plain["E_shape"] > plain["E_u"]


def test_where_a_periodic_body_lies_is_no_error():
    x = np.argwhere(np.ones((12, 12))).astype(float)
    points = Points(x, np.ones(len(x), bool), 1.0, box=(12.0, 12.0))
    solid = LPSMaterial(0.3, 0.3, 1.0, np.ones(1), horizon=2.5, certified_on=(1.0,))
    u = 0.1 * np.cos(x @ [[np.pi / 6, 0], [np.pi / 6, np.pi / 3]])
    b = solid.on(points)(u)
    for moved in (0.0, 0.3):
        errors = evaluate(solid, Samples(points, u[None] + moved, b[None]))
        assert errors["E_u"] < 1e-9
        assert errors["E_shape"] < 1e-9
