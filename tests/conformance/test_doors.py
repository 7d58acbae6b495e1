"""Each argument of each verb, fed with twelve kinds of values that are none of it."""

import numpy as np
import pytest
import torch

import warp_peri as wp
from tests.conformance.test_laws import LAWS
from tests.support.bodies import solid
from tests.support.problems import kernel
from warp_peri.fe_coupling.body import Coupling
from warp_peri.fracture import Cracked, rectangle_nodes
from warp_peri.points.mesh import make_mesh
from warp_peri.points.outlines import Polygon, box, mesh_outline

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
        return wp.simulate(material, start, density=1.0, step=1e-9, steps=1, **have)

    try:
        moved("u", zero)
    except wp.InputError as error:
        pytest.skip(str(error))
    for which in given:
        good = np.ones(2) if which == "signal" else zero
        refuses(lambda value, which=which: moved(which, value), good, which)


def cracked(inner):
    x = rectangle_nodes(12.0, 12.0, 1.0)
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
        return wp.simulate(material, problem, **more) if options else wp.solve(material, problem)

    known = {"u": u, "cracks": cracks} | ({} if kind == "events" else {"b": zero})
    known |= {"v": zero} if kind in ("waves", "steps") else {}
    known |= {"grip": zero} if kind == "steps" else {}
    for which, good in known.items():
        said = "crack" if which == "cracks" else (which, "load") if kind == "steps" else which
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
            wp.simulate(solid(), Cracked(points, u=u), **how)
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
    moved = wp.simulate(solid().model, Cracked(points, u=u), **waves, steps=steps)
    np.testing.assert_array_equal(
        moved.u, wp.simulate(solid().model, Cracked(points, u=u), **waves, steps=3).u
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


WRONG_OPTIONS = {
    "parameters": (3, "mu", {3: 1.0}),
    "transfer": ("no", 3, None),
    "allow_uncertified": ("no", 3, None),
    "record": ("a", 1j, [0, 10**6], {"a": 1}, [[1], [2, 3]]),
    "series": ("", 3, True, b"", []),
    "checkpoint": ("", 3, True, b"", 1.5),
    "every": (1e300, 0, 1.5, "a", None, np.inf),
    "checkpoint_every": (1e300, "a"),
    "step": ("a", None, 1j, np.nan, True),
    "density": ("a", None, 1j, np.nan, True),
}


@pytest.mark.parametrize("option", WRONG_OPTIONS)
def test_options_of_a_motion(option):
    name = next(name for name in LAWS if name.startswith("LPS"))
    points, material = LAWS[name].points(5), LAWS[name].material()
    problem = wp.Dirichlet(points, None, 1e-4 * points.x)
    for bad in WRONG_OPTIONS[option]:
        given = {"density": 1.0, "step": 1e-9, "steps": 2} | {option: bad}
        with pytest.raises(wp.InputError, match=f"^{option}:"):
            wp.simulate(material, problem, **given)
        if option in ("parameters", "transfer", "allow_uncertified"):
            with pytest.raises(wp.InputError, match=f"^{option}:"):
                wp.solve(material, problem, **{option: bad})


WRONG_OF_BREAKING = {
    "count_cracks": ("no", 1),
    "ramp": (3.0, "a"),
    "watch": ({"a": 3}, 3, ["a"]),
    "regions": (3, ["a"], {"a": [1, [2]]}, {"a": [0, 1]}),
    "sections": (3, ["a"]),
    "every": (1e300, "a"),
    "checkpoint": (3, ""),
    "series": (3, ""),
}


@pytest.mark.parametrize("option", WRONG_OF_BREAKING)
def test_options_of_a_body_that_breaks(option):
    points, u, _ = cracked(7.0)
    for bad in WRONG_OF_BREAKING[option]:
        with pytest.raises(wp.InputError, match=f"^{option.rstrip('s')}"):
            wp.simulate(solid(), Cracked(points, u=u), **{"step": 1e-4, "steps": 2, option: bad})
    for bad in ("no", 1, None):
        with pytest.raises(wp.InputError, match="^corrected: expected True or False"):
            Cracked(points, u=u, corrected=bad)
    with pytest.raises(wp.InputError, match="expected options among .*, got allow_unstable"):
        wp.simulate(solid(), Cracked(points, u=u), step=1e-4, steps=2, allow_unstable="no")


def test_a_list_of_masked_rows_is_masked():
    name = next(name for name in LAWS if name.startswith("LPS"))
    points, material = LAWS[name].points(5), LAWS[name].material()
    hidden = [np.ma.masked_array(row, np.arange(len(row)) == 0) for row in points.x]
    with pytest.raises(wp.InputError, match="^u: expected float values, got masked entries"):
        material.on(points)(hidden)


@pytest.mark.parametrize("name", LAWS)
def test_positions_are_not_taken_for_points(name):
    x, material = LAWS[name].points(4).x, LAWS[name].material()
    for call in (lambda: material.on(x), lambda: wp.solve(material, wp.Dirichlet(x, None, 0 * x))):
        with pytest.raises(wp.InputError, match="^points: expected Points"):
            call()


@pytest.mark.parametrize("option", ["transfer", "allow_uncertified"])
def test_flags_of_an_evaluation(option):
    name = next(name for name in LAWS if name.startswith("LPS"))
    points, material = LAWS[name].points(4), LAWS[name].material()
    u = 1e-4 * points.x[None]
    for bad in ("no", 3, None):
        with pytest.raises(wp.InputError, match=f"^{option}: expected True or False"):
            wp.evaluate(material, wp.Samples(points, u, 0 * u), **{option: bad})
        with pytest.raises(wp.InputError, match=f"^{option}: expected True or False"):
            material.on(points, **{option: bad})
    for bad in (u, None, [wp.Samples(points, u)]):
        with pytest.raises(wp.InputError, match="^samples: expected Samples"):
            wp.evaluate(material, bad)


def test_an_edge_of_two_parts_has_one_displacement():
    x = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 9.0]])
    left = np.array([[3, 0]])
    mesh = make_mesh(x, [[0, 1, 2], [0, 2, 3]], {"left": left, "same": left})
    material = kernel("1/r", 2.0)
    held = {"left": (0.0, 0.0), "same": (0.1, 0.1)}
    with pytest.raises(wp.InputError, match="expected one displacement where both are"):
        wp.solve(material, wp.Body(mesh, held, coupling=Coupling(spacing=1.0)))


def test_a_data_set_is_checked_when_it_is_made():
    x = np.argwhere(np.ones((4, 4))).astype(float)
    points = wp.Points(x, np.ones(16, bool), 1.0)
    with pytest.raises(wp.InputError, match="u: expected an array"):
        wp.Samples(points, torch.zeros(1, 16, 2, device="meta"))
    sets = {"train": wp.Samples(points, np.zeros((1, 16, 2)))}
    for kind, words in (
        ({"provenance": {"rate": np.nan}}, "provenance: expected plain JSON"),
        ({"provenance": {"rate": object()}}, "provenance: expected plain JSON"),
        ({"density": 1e300}, "density: expected a number > 0"),
        ({"thickness": 1e300}, "thickness: expected a number > 0"),
    ):
        with pytest.raises(wp.InputError, match=words):
            wp.Dataset(sets, **{"thickness": 1.0, "density": 1.0} | kind)


def test_arguments_of_bodies_and_tables():
    hidden = np.ma.masked_array([1.0, 99.0, 0.2], mask=[0, 1, 0])
    for call, words in (
        (lambda: wp.Points.disk("a", 1.0, 2.0), "radius"),
        (lambda: wp.Points.disk(2.0, 1.0, 2.0, dimension=5), "dimension"),
        (lambda: wp.influence.table([1, 2, 3], hidden), "K"),
        (lambda: wp.influence.table([1, 2, 3], [3, 2, 1], learned="no"), "learned"),
        (lambda: wp.fracture.penny_corners(1.0, 1), "corners"),
        (lambda: wp.Points.block([], 1.0, 2.0), "lengths"),
        (lambda: wp.Points.sheet((4,), 1.0), "sides"),
        (lambda: wp.fracture.box_nodes((), 1.0), "sides"),
        (lambda: box(0.0, 20.0), "width"),
        (lambda: mesh_outline(Polygon(((0, 0), (1, 0), (2, 0))), size=1.0), "polygon"),
        (lambda: wp.Crystal(-1.5), "horizon"),
        (lambda: wp.influence.gaussian(np.ones(2), 0.0), "width"),
        (lambda: wp.fracture.continuum_stretch(kernel("1/r", 3.0), -1.0), "toughness"),
        (lambda: wp.load("a\0b"), "path"),
        (lambda: wp.runtime.set_num_threads(10**400), "count"),
        (lambda: wp.fracture.point_force(np.eye(2), 1.0, (0, 0), hidden[:2]), "force"),
        (lambda: wp.fracture.box_nodes((1.0, "a"), 1.0), "sides"),
        (lambda: wp.fracture.lattice_body("a", 1.0, 2.0), "x"),
        (lambda: wp.methods.GaussNewton(rounds=0), "rounds"),
    ):
        with pytest.raises(wp.InputError, match=f"^{words}: expected"):
            call()
    points = wp.Points.disk(2.0, 1.0, 2.0)
    op = wp.LPSMaterial(1.0, 1.0, 1.0, [1.0], 2.0, certified_on=(1.0,)).on(points)
    with pytest.raises(wp.InputError, match="^w: expected shape"):
        op.vjp(np.zeros(points.x.shape), np.zeros(points.x.shape))
    assert wp.Points.sheet((4, 4), 1.0, units="reduced").units[0] == "sigma"
