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
    table, inside = evaluate(MODEL, points), points.interior
    force = np.array([reference.operator(points.x, inside, MODEL, u) for u in points.u])
    off = (solve(MODEL, points, points.b, points.u) - points.u)[:, inside]
    u, b = points.u[:, inside], points.b[:, inside]
    residual, load, wrong, size = (np.sqrt((f**2).sum(axis=(1, 2))) for f in (force - b, b, off, u))
    expected = {"E_res": residual / load, "E_res_abs": residual, "E_u": wrong / size}
    for key, values in expected.items():
        assert table[f"{key}_samples"] == pytest.approx(values, rel=1e-9), key
        assert table[key] == pytest.approx(values.mean(), rel=1e-9), key
    assert table["E_res"] > 0.01


def test_sets_that_have_no_error_to_speak_of_are_refused(points):
    with pytest.raises(InputError, match="the set has no samples"):
        evaluate(MODEL, points[:0])
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
    first, _, last = every["E_res_samples"]
    assert some["E_res_samples"] == [pytest.approx(first), None, pytest.approx(last)]
    assert some["E_res"] == pytest.approx((first + last) / 2)
    assert some["E_u_samples"][0] == pytest.approx(every["E_u_samples"][0])
    none = evaluate(MODEL, replace(points, b=np.full_like(b, level)))
    assert none["E_res"] is None
    assert min(none["E_res_abs"], none["E_u"]) > 0


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
