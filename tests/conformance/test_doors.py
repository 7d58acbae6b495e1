"""Each argument of each verb, fed with twelve kinds of values that are none of it."""

import numpy as np
import pytest
import torch

import warp_peri as wp
from tests.conformance.test_laws import LAWS
from tests.support.bodies import solid
from warp_peri.damage import Cracked, rectangle

pytestmark = pytest.mark.filterwarnings("ignore:strain:UserWarning", "ignore:crack")


def kinds(good):
    """Twelve wrong kinds of an array, by name."""
    good = np.asarray(good, float)
    middle = good.size // 2
    hidden = np.ma.masked_array(good, np.arange(good.size).reshape(good.shape) == middle)
    wrong = {"masked": hidden, "complex": good + 0j, "text": good.astype(str)}
    for name, value in (("nan", np.nan), ("infinite", np.inf), ("1e300", 1e300)):
        wrong[name] = good.copy()
        wrong[name].flat[middle] = value
    short = good[:-1] if good.ndim < 3 else good[0, :-1, :1]
    return wrong | {
        "truth values": good.astype(bool),
        "objects": good.astype(object),
        "short": short,
        "flat": good[None, None] if good.ndim == 1 else good.ravel(),
        "ragged": [[1.0, 2.0], [3.0]],
        "a word": "u",
    }


def refuses(call, good, name):
    """That a call takes what is good and says so of what is not, naming it."""
    call(good)
    for kind, bad in kinds(good).items():
        with pytest.raises(wp.InputError) as told:
            call(bad)
        assert str(told.value).startswith(name), kind


@pytest.mark.parametrize("name", LAWS)
def test_fields_of_a_motion(name):
    points, material = LAWS[name].points(5), LAWS[name].material()
    zero = np.zeros(points.x.shape)
    given = {"b": None, "u": zero, "v": zero, "signal": np.ones(2)}

    def moved(which, value):
        have = given | {which: value}
        start = wp.Dirichlet(points, have.pop("b"), have.pop("u"))
        return wp.move(material, start, density=1.0, step=1e-9, steps=1, **have)

    try:
        moved("u", zero)
    except wp.InputError as error:
        pytest.skip(str(error))
    for which in given:
        good = np.ones(2) if which == "signal" else zero
        refuses(lambda value, which=which: moved(which, value), good, which)


def cracked(inner):
    x = rectangle(12.0, 12.0, 1.0)
    points = wp.Points(x, (np.abs(x) < inner).all(axis=1), 1.0)
    return points, 1e-4 * x, [[[-6.5, 0.0], [0.0, 0.0]]]


MOTIONS = {
    "at rest": (solid().model, 3.0, {}),
    "waves": (solid().model, 3.0, {"density": 2e3, "step": 1e-4, "steps": 2}),
    "steps": (solid(), 7.0, {"step": 1e-4, "steps": 2}),
    "events": (solid(), 3.0, {"events": 1}),
}


@pytest.mark.parametrize("kind", MOTIONS)
def test_a_body_with_cracks(kind):
    material, inner, options = MOTIONS[kind]
    points, u, cracks = cracked(inner)
    zero, count = np.zeros(u.shape), len(u)
    fields = {"u": u, "cracks": cracks}

    def run(which, value):
        more = dict(options)
        where = more if which in ("v", "no_fail", "grip") else (given := dict(fields))
        given = dict(fields) if where is more else where
        where[which] = value
        problem = Cracked(points, **given)
        return wp.move(material, problem, **more) if options else wp.solve(material, problem)

    known = {"u": u, "cracks": cracks} | ({} if kind == "events" else {"b": zero})
    known |= {"v": zero} if kind in ("waves", "steps") else {}
    known |= {"grip": zero} if kind == "steps" else {}
    for which, good in known.items():
        said = (
            "crack" if which == "cracks" else "load" if which == "b" and kind == "steps" else which
        )
        refuses(lambda value, which=which: run(which, value), good, said)
    if kind in ("steps", "events"):
        for bad in (np.zeros(count), np.zeros(count, int), np.zeros(3, bool), ["no"], "no"):
            with pytest.raises(wp.InputError, match="^no_fail: expected"):
                run("no_fail", bad)


def test_a_ramp_a_pressure_and_a_crack_that_cuts_nothing():
    points, u, cracks = cracked(7.0)
    for value in (np.nan, "a", np.ones(2), 1j, None):
        how = {"step": 1e-4, "steps": 2, "ramp": lambda t, value=value: value}
        with pytest.raises(wp.InputError, match="ramp at t = 0: expected"):
            wp.move(solid(), Cracked(points, u=u), **how)
    points, u, cracks = cracked(3.0)
    for size in (1.0, 1e-12):
        skew = size * np.array([[1.0, 0.5], [0.0, 1.0]])
        with pytest.raises(wp.InputError, match="stress: expected a symmetric one"):
            wp.solve(solid().model, Cracked(points, u=u, cracks=cracks, pressure=skew))
    with pytest.warns(UserWarning, match="crack: cuts no bond"):
        wp.solve(solid().model, Cracked(points, u=u, cracks=[[(90.0, 0.0), (99.0, 0.0)]]))


@pytest.mark.parametrize("steps", [3.0, np.int64(3), np.float64(3)])
def test_whole_numbers_of_any_type_are_counts(steps):
    points, u, _ = cracked(3.0)
    waves = {"density": 2e3, "step": 1e-4}
    moved = wp.move(solid().model, Cracked(points, u=u), **waves, steps=steps)
    np.testing.assert_array_equal(
        moved.u, wp.move(solid().model, Cracked(points, u=u), **waves, steps=3).u
    )


@pytest.mark.parametrize("name", [name for name in LAWS if name.startswith(("LPS", "crystal"))])
def test_parameters_are_real_numbers_of_the_shape_that_they_have(name):
    points, material = LAWS[name].points(5), LAWS[name].material()
    operator = material.on(points)
    problem = wp.Dirichlet(points, None, 1e-4 * points.x)
    for which, own in operator.learnable.items():
        own = np.asarray(own, float)
        wrong = {"complex": own + 0j, "truth": own.astype(bool), "text": own.astype(str)}
        wrong |= {"nan": own * np.nan, "longer": np.append(own, 1.0)}
        wrong |= {"turned": own.T.copy()} if own.T.shape != own.shape else {}
        wrong |= {"tensor": torch.tensor(own + 0j), "bits": torch.tensor(own.astype(bool))}
        for kind, bad in wrong.items():
            with pytest.raises(wp.InputError) as told:
                wp.solve(operator, problem, parameters={which: bad})
            assert str(told.value).startswith((which, "parameters")), kind
