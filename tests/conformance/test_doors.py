"""Each argument of each verb, and of all that is public, fed with what is none: refused by name."""

import inspect
import os
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
import warp
from numpy import array, eye, inf, nan, ones, zeros
from numpy.linalg import norm
from numpy.testing import assert_allclose

import warp_peri as wp
from tests.support import filterwarnings, masked, parametrize
from tests.support.bodies import solid
from tests.support.clouds import plain
from tests.support.materials import LAWS, operator, placed
from tests.support.problems import OTHER, everywhere, kernel, lattice, noise, within
from tests.support.solving import solve
from tests.support.told import all_refused, assert_refused, each_refused, refused, warned
from warp_peri.atoms.dic import DICFrame
from warp_peri.fracture import Cracked, box_nodes, rectangle_nodes
from warp_peri.methods import Coupling, GaussNewton, LPSParameters, sweep
from warp_peri.mpi import gather
from warp_peri.neural import TrainingSettings
from warp_peri.points.arguments import check_arguments, kinds_of
from warp_peri.points.mesh import make_mesh
from warp_peri.points.outlines import box, mesh_outline
from warp_peri.points.points import grid_places

pytestmark = filterwarnings("ignore:strain:UserWarning", "ignore:crack")
moves = lambda name: name not in ("third order, filtered", "neural operator", "hyperelastic")
"""Whether waves of a law have a proven step."""
CHANGES = {
    "axis": lambda p: replace(p, axis=(p.axis or 0.0) + 30.0),
    "units": lambda p: replace(p, units=OTHER),
    "box": lambda p: replace(p, box=(1e3, 1e3)),
    "outside": lambda p: replace(p, outside=np.arange(len(p.x)) == 0),
    "x": lambda p: replace(p, x=p.x + 1.0),
}
WAVES = {"density": 2e3, "step": 1e-4, "steps": 2}
MOTIONS = {
    "at rest": (solid().model, 3.0, {}),
    "waves": (solid().model, 3.0, WAVES),
    "steps": (solid(), 7.0, {"step": 1e-4, "steps": 2}),
    "events": (solid(), 3.0, {"events": 1}),
}
FLAGS = dict.fromkeys(("transfer", "allow_uncertified"), ("no", 3, None))
WRONG_OPTIONS = FLAGS | {
    "parameters": (3, "mu", {3: 1.0}),
    "record": ("a", 1j, [3, -1], {"a": 1}, [[1], [2, 3]]),
    "series": ("", 3),
    "checkpoint": ("", 3, True, b""),
    "every": (1e300, 0, "a", None),
    "checkpoint_every": (1e300, "a"),
    **dict.fromkeys(("step", "density"), ("a", None, True)),
}
WRONG_OF_BREAKING = {
    "ramp": (3.0, "a", lambda: 1.0, lambda t: 1.0 / t,
             *(lambda t, value=value: value for value in (nan, "a", ones(2), 1j, None))),
    "watch": ({"a": 3}, 3, ["a"], {"a": lambda: 1.0}),
}  # fmt: skip
PLATE = mesh_outline(box(12, 12), size=3)
MODEL = kernel("1/r", 3.0, lam=0.5, mu=1.0)


def kinds(good, place=None):
    """Wrong kinds of an array, by name; of one entry, in the middle by default."""
    good = np.asarray(good, float)
    place = good.size // 2 if place is None else place
    wrong = {"masked": masked(good, place), "complex": good + 0j, "text": good.astype(str)}
    wrong["learns"] = warp.array(good, float, requires_grad=True)
    for name, value in (("nan", nan), ("infinite", inf), ("1e300", 1e300)):
        wrong[name] = good.copy()
        wrong[name].flat[place] = value
    return wrong | {
        "truth values": good.astype(bool),
        "objects": good.astype(object),
        "short": np.atleast_1d(good)[:-1] if good.ndim < 3 else good[0, :-1, :1],
        "flat": good.ravel() if good.ndim > 1 else good[None],
        "deep": good[None, None],
        "ragged": [[1.0, 2.0], [3.0]],
        "a word": "u",
    }


def refuses(call, good, name, place=None, *, but=()):
    """That a call takes what is good and says so of what is not, naming it."""
    call(good)
    for kind, bad in kinds(good, place).items():
        if kind in but:
            continue
        with pytest.raises(wp.InputError) as told:
            call(bad)
        assert str(told.value).startswith(name), kind


@parametrize("name", LAWS)
def test_fields_of_a_solve_a_motion_and_an_operator(name):
    op, points = placed(name, 1)
    zero, x = 0 * points.x, points.x
    given = {"b": zero, "u": zero, "v": zero, "signal": ones(2)}

    def run(verb, which, value):
        have = given | {which: value}
        problem, options = wp.Dirichlet(points, have.pop("b"), have.pop("u")), {}
        if verb is wp.simulate:
            options = {"density": 1.0, "step": 1e-9, "steps": 1} | have
        return verb(op, problem, **options)

    for which, good in given.items():
        for verb in (wp.solve, wp.simulate)[which in ("v", "signal") : 1 + moves(name)]:
            place = 0 if (verb, which) == (wp.solve, "u") else None  # of the collar
            refuses(lambda value, a=verb, b=which: run(a, b, value), good, which, place)
    with refused("b: expected shape"):
        run(wp.solve, "b", zeros((3, *zero.shape)))
    assert run(wp.solve, "b", None).residual < 1e-6
    for place in (lambda: op.model.on(x), lambda: solve(op, x, None, zero)):
        with refused("^points: expected Points"):
            place()
    hidden = np.ma.masked_array(zero, np.repeat(points.interior[:, None], 2, axis=1))
    columns = zeros(len(zero), [("x", float), ("y", float)])
    wrong = hidden, list(hidden), zero * 1j, zero.astype(str), zero.astype(object), columns
    vjp = lambda bad: op.vjp(zero, np.ma.asanyarray(bad)[points.interior])
    inner, both = zero[points.interior], np.stack([zero, zero])
    reads = [op, op.rhs, op.stress, lambda bad: op.jvp(zero, bad), lambda bad: op.jvp(bad, zero)]
    reads.append(lambda bad: op.vjp(bad, inner))
    for read in [*reads, vjp] + [op.energy] * (op.energy(zero) is not None):
        all_refused(read, "expected (float )?values", wrong)
    all_refused(partial(op.vjp, zero), "expected ", (zeros(3), inner[:-1], inner[:, :1]))
    pairs = () if getattr(op, "is_linear", False) else ((zero, both), (both, zero))
    all_refused(op.jvp, "along u: expected shape", pairs)


@parametrize("name", [name for name, law in LAWS.items() if law.periodic])
def test_loads_of_a_period(name):
    points, material = LAWS[name].sheet(), LAWS[name].material()
    if hasattr(material.on(points), "solve_periodic"):
        zero, shapes = 0 * points.x, ("short", "flat", "deep")
        with refused("nodes on a collar"):
            solve(material, points, zero, zero)
        refuses(lambda b: wp.solve(material, wp.Periodic(points, b)), zero, "b", but=shapes)


@parametrize("name", [*LAWS, "conductor", "coupled"])
def test_an_operator_is_for_its_own_points(name):
    op = operator(name)
    for what, change in CHANGES.items():
        problem = wp.Dirichlet(change(op.points), None, zeros(op.shape))
        with refused(f"operator: expected one on the points.* in {what}"):
            wp.solve(op, problem)
    with refused("^solve: foo, mu: not among the options of a .*, which is on its points already"):
        wp.solve(op, wp.Dirichlet(op.points, None, zeros(op.shape)), mu=1.4, foo=3)


def test_a_node_outside_pulls_nothing_of_a_coupled_solid():
    points, coupled = replace(lattice(5, 3.0), axis=None), operator("coupled").model
    outside = zeros(len(points.x), bool)
    outside[np.argmin(norm(points.x - [-1, 2], axis=1))] = True
    op = coupled.on(replace(points, outside=outside))
    u = np.column_stack([noise(points), noise(points)[:, 0]])
    assert np.array_equal(op(u + 100.0 * outside[:, None]), op(u))
    with refused("box: a coupled solid is for a body that does not"):
        coupled.on(wp.Points.sheet((14, 14), 1.0))


def cracked(inner):
    x = rectangle_nodes(12.0, 12.0, 1.0)
    return within(x, inner), 1e-4 * x, [[[-6.5, 0.0], [0.0, 0.0]]]


@parametrize("name", ["third order, energy", "crystal"])
def test_no_crack_is_solved_by_a_part_of_a_material(name):
    points, u, cracks = cracked(4.0)
    with refused(r"Cracked"):
        wp.solve(LAWS[name].material(), Cracked(points, u=u, cracks=cracks))


@parametrize("kind", MOTIONS)
def test_a_body_with_cracks(kind):
    material, inner, options = MOTIONS[kind]
    points, u, cracks = cracked(inner)
    zero, count = 0 * u, len(u)

    def run(which, value):
        have = {"u": u, "cracks": cracks, which: value}
        more = {name: have.pop(name) for name in ("v", "no_fail", "grip") if name in have}
        problem = Cracked(points, **have)
        if options:
            return wp.simulate(material, problem, **options, **more)
        return wp.solve(material, problem)

    known = {"u": u, "cracks": cracks} | ({} if kind == "events" else {"b": zero})
    known |= {"v": zero} if kind in ("waves", "steps") else {}
    known |= {"grip": zero} if kind == "steps" else {}
    for which, good in known.items():
        said = "crack" if which == "cracks" else (which, "load") if kind == "steps" else which
        refuses(lambda value, which=which: run(which, value), good, said)
    if kind in ("steps", "events"):
        wrong = zeros(count), zeros(count, int), zeros(3, bool), ["no"], "no"
        all_refused(partial(run, "no_fail"), "^no_fail: expected", wrong)


def test_a_pressure_and_a_crack_that_cuts_nothing():
    points, u, cracks = cracked(3.0)
    for size in (1.0, 1e-12):
        skew = size * array([[1.0, 0.5], [0.0, 1.0]])
        with refused("pressure: expected symmetric"):
            wp.solve(solid().model, Cracked(points, u=u, cracks=cracks, pressure=skew))
    far = Cracked(points, u=u, cracks=[[(90.0, 0.0), (99.0, 0.0)]], corrected=array(False))
    with warned("crack: cuts no bond"):
        wp.solve(solid().model, far)


@parametrize("name", [n for n in (*LAWS, "conductor", "coupled", "cut") if n[:6] != "neural"])
def test_numbers_are_real_and_of_their_names_and_shapes(name):
    op, shapes = operator(name), ("flat", "deep")
    solve_by = partial(op.solve_torch, *zeros((2, *op.shape)), None)
    for which, own in op.learnable.items():
        own = np.asarray(own, float)
        said = which, which.removeprefix("conductor_"), "parameters", "conductivity"
        refuses(lambda bad, n=which: op.at({n: bad}), own, said, but=("short", *shapes))
        refuses(lambda bad, n=which: solve_by({n: bad}), own, said, but=shapes * (not own.ndim))
    all_refused(op.at, "^(parameters|numbers): expected", ({"foo": 1.0}, 3))


def test_options_of_a_solve_and_a_motion():
    points, material = LAWS["LPS"].points(1), LAWS["LPS"].material()
    problem = wp.Dirichlet(points, None, 1e-4 * points.x)
    for option, values in WRONG_OPTIONS.items():
        for bad in values:
            given = {"density": 1.0, "step": 1e-9, "steps": 2} | {option: bad}
            given |= {"checkpoint": "a.h5"} if option == "checkpoint_every" else {}
            calls = [lambda given=given: wp.simulate(material, problem, **given)]
            if option in ("parameters", *FLAGS):
                calls.append(lambda one={option: bad}: wp.solve(material, problem, **one))
            for call in calls:
                with refused(f"^{option}:"):
                    call()
    for option, value in {"signal": ones(3), "ramp": np.sum, "checkpoint_every": 2}.items():
        with refused(f"^{option}: expected .* beside it"):
            wp.simulate(material, problem, **WAVES, **{option: value})


def test_options_of_a_body_that_breaks():
    points, u, _ = cracked(7.0)
    run = partial(wp.simulate, solid(), Cracked(points, 0 * u, u), step=1e-4, steps=2)
    for option, values in WRONG_OF_BREAKING.items():
        call = lambda bad, option=option: run(**{option: bad})
        all_refused(call, f"^{option.rstrip('s')}", values)
    with refused("expected options among .*, got allow_unstable"):
        run(allow_unstable="no")


def plate(displacement=(0, 0), traction=(5e-3, 0), **given):
    parts = {"left": displacement}, {"right": traction}
    return wp.Body(PLATE, *parts, coupling=Coupling(spacing=1.0), **given)


@filterwarnings("ignore:mesh")
def test_vectors_of_a_body():
    hidden = masked([1.0, 0.0])
    functions = lambda x: 1j * x, lambda x, n: 1j * n
    bad = [(value, value) for value in ((1j, 0), ("0", "0"), hidden, [[1.0], [2.0, 3.0]])]
    for held, pulled in (*bad, ((inf, 0), (inf, 0)), functions):
        with refused("part 'left': expected"):
            wp.solve(MODEL, plate(held))
        with refused("part 'right': expected"):
            wp.solve(MODEL, plate(traction=pulled))
    half = wp.Body(PLATE, {"left": (0, nan), "right": (0, 0)}, {"left": (5e-3, 0)})
    assert wp.solve(MODEL, half).residual < 1e-8
    assert_refused({
        "part 'left': expected it held or pulled, got both":
            lambda: wp.solve(MODEL, wp.Body(PLATE, {"left": (0, 0)}, {"left": (5e-3, 0)})),
        "displacement: expected values by": lambda: wp.solve(MODEL, wp.Body(PLATE, None)),
        "model: nothing is proven of it on 1 Å":
            lambda: wp.solve(plain(3.0, D=[1.0, -0.9, 0.3]), plate()),
    })  # fmt: skip


@filterwarnings("ignore:mesh")
@parametrize("other", ["same", "low"])
@parametrize("size", [1.0, 1e-12])
def test_an_edge_or_a_corner_of_two_parts_has_one_displacement(other, size):
    x, left = array([[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 9.0]]), array([[3, 0]])
    mesh = make_mesh(x, [[0, 1, 2], [0, 2, 3]], {"left": left, "same": left, "low": [[0, 1]]})

    def solved(off):
        held = {"left": (size, size), other: (size, (1 + off) * size)}
        wp.solve(kernel("1/r", 2.0), wp.Body(mesh, held, coupling=Coupling(spacing=1.0)))

    solved(1e-12)  # as rounding may leave it
    with refused(f"parts 'left', '{other}': expected one displacement .* differ by 1e-"):
        solved(1e-8)


@parametrize("wrong", [lambda x, y: x, lambda x: 1.0 if x < 0 else 2.0, lambda x: x.norm()])
def test_functions_that_fail_at_places_are_refused_by_name(wrong):
    points, K = LAWS["LPS"].points(1), wp.influence.InfluenceFunction
    assert_refused({
        "^lam: expected a function of positions": lambda: MODEL.spread(points, wrong, None),
        "^kappa: expected a function of positions":
            lambda: operator("conductor").model.on(points, kappa=wrong),
        "^b: expected a function of positions": lambda: wp.solve(MODEL, plate(b=wrong)),
        "^(influence '<lambda>'|parameters): expected .* function": lambda: K(wrong)([1.0, 2.0]),
    })  # fmt: skip


def test_arguments_of_bodies_solids_and_tables():
    """What their kind, which is looked at below, does not tell."""
    hidden = masked([1.0, 99.0, 0.2], 1)
    points, sixteen = wp.Points.disk(2.0, 1.0, 2.0), everywhere(1.0 * grid_places((4, 4)))
    sets = {"train": wp.Samples(sixteen, zeros((1, 16, 2)))}
    data = lambda rate: wp.Dataset(sets, 1.0, 1.0, provenance={"rate": rate})
    op = kernel("1/r", 2.0, lam=1.0, mu=1.0).on(points)
    shape, flat = wp.influence.InfluenceFunction, lambda r, w=0: r
    K, crystal = shape(flat, {"w": 1.0}), LAWS["crystal"].material()
    held = Cracked(points, u=points.x, free=points.x > 99)
    own = partial(K.model, lam=0.3, mu=0.7, horizon=3.0)
    bounds = (("0", "2"), (False, True), (2.0, 1.0))
    assert_refused({
        "^K: expected": lambda: wp.influence.table([1, 2, 3], hidden),
        "^r: expected": (
            lambda: wp.influence.gaussian(hidden, 1.0), lambda: K(hidden),
            lambda: K(1j * hidden.data),
            *(
                lambda bad=bad: MODEL.influence(bad)
                for bad in ([0.0, 1.0], [3.1], -1.0, nan, 1j, hidden)
            ),
        ),
        "^influence '<lambda>': expected": (
            lambda: shape(lambda r: r > 0)(1.0), lambda: shape(lambda r: hidden)(hidden.data),
        ),
        "^parameters: expected": lambda: shape(flat, {"a": 1.0}),
        "^bounds of w: expected": tuple(
            lambda ends=ends: shape(flat, {"w": 1.0}, {"w": ends}) for ends in bounds
        ),
        "^vector: expected": (lambda: K.at(zeros(0)), lambda: K.at(zeros(2))),
        "^lengths: expected": (
            lambda: wp.Points.block([], 1.0, 2.0), lambda: K.coefficients([], 3.0),
            lambda: own(spacings=[]), lambda: wp.Points.block((-99.0, 9.0), 1.0, 2.0),
        ),
        "^spacings: expected": lambda: own(spacings=["a"]),
        "^moduli: expected": tuple(
            lambda one=one: GaussNewton(moduli=(one, one)) for one in ("0.4", True, LEARNS)
        ),
        "^degree: expected": lambda: wp.Bernstein(10**15),
        "^axis: expected": lambda: replace(points, axis=LEARNS),
        "^horizons: expected": lambda: sweep(*2 * [sets["train"]], "none", horizons=("2",)),
        "^seed: expected .*, got 4294967296$": partial(TrainingSettings, seed=2**32),
        "^shortest wave: expected": lambda: wp.prediction.mixed_waves(points.x, (9, 9), 1e-3),
        "^spacing: expected": lambda: LAWS["third order, energy"].material().proven_strain(-5),
        "^free: expected": lambda: wp.solve(MODEL, held),
        "^k: expected": (
            *(lambda k=k: crystal.symbol(k) for k in ([1j, 0], hidden[:2], zeros(3), 1.0)),
            *(lambda k=k: wp.methods.Smoothing(1.0).root(k) for k in (True, nan, hidden)),
            lambda: wp.methods.Smoothing(1.0).root([True, 0]),
        ),
        "^u: expected": (
            lambda: solve(op, points, None, [[1.0], [1.0, 2.0]]),
            lambda: wp.Samples(sixteen, torch.zeros(1, 16, 2, device="meta")),
        ),
        "^sides: expected": (
            lambda: wp.Points.sheet((4,), 1.0), lambda: wp.Points.sheet((10**6, 10**6), 1.0),
            lambda: box_nodes((), 1.0), lambda: box_nodes((1e99, 1.0), 1e-99),
            lambda: box_nodes((1.0, "a"), 1.0),
        ),
        "^terms: expected": tuple(
            lambda terms=terms: wp.hyperelastic.Hyperelastic(terms=terms)
            for terms in (["neo_hookean"], (ones(2), ones(2)))
        ),
        "^path: expected": lambda: wp.load("a\0b"),
        "^header: expected": lambda: wp.atoms.check_box("a", (1, 1), "a", 1e-3),
        "^length: expected": lambda: DICFrame(points.x, points.x, "a", [1]),
        "^count: expected": lambda: wp.runtime.set_num_threads(10**400),
        "^force: expected": lambda: wp.fracture.point_force(eye(2), 1.0, (0, 0), hidden[:2]),
        "^values: expected": lambda: gather(points, points.x[1:]),
        "^provenance: expected": (lambda: data(nan), lambda: data(object())),
    })  # fmt: skip
    many, none = torch.full((225,), 0.5), (1j, masked([0.5]), nan, "0.5", None, True)
    numbers = {"lam": 0.4, "mu": 0.5, "alpha": 1.0, "D": [1.0, 0.7, 0.4]}
    for name, more in {"lam": many, "mu": many, "alpha": many, "D": []}.items():
        call = lambda value, name=name: LPSParameters(**numbers | {name: value})
        wrong = *none, more, *[3.0] * (name == "alpha")
        all_refused(call, f"^{name}: expected", wrong)
    assert wp.Points.sheet((4, 4), 1.0, units="reduced").units[0] == "sigma"


def watched(name, watch):
    body = Cracked(everywhere(rectangle_nodes(8.0, 8.0, 1.0)))
    return wp.simulate(solid(), body, step=1e-6, steps=2, every=1, watch={name: watch})


def test_what_watches_damage_is_named_once_gives_numbers_and_changes_nothing():
    sizes, run = iter((1, 2, 1, 2)), watched("b", lambda phi: phi.sum())
    assert run["b"].shape == (2,)
    each_refused(watched, {
        "watch: expected functions, none named time, work": ("work", np.sum),
        "watch b: expected float values": ("b", lambda phi: 1j),
        r"watch b: expected shape \[1\], got \[2\]": ("b", lambda phi: zeros(next(sizes))),
    })  # fmt: skip
    with refused("watch b: expected shape") as told:
        watched("b", lambda phi: zeros(next(sizes)))
    assert told.value.motion["b"].shape == (1, 1)  # what was recorded until then
    assert not watched("b", lambda phi: phi.fill(1) or phi.sum()).details.damage.any()


def test_tensors_beside_a_pressure_and_numbers_of_no_dimension():
    x, pressure = rectangle_nodes(8.0, 8.0, 1.0), 1e-3 * eye(2)
    points = within(x, 3)
    body = Cracked(points, torch.zeros(x.shape), 0 * x, [[(-2, 0), (2, 0)]], pressure=pressure)
    both = (wp.solve(solid().model, one).u for one in (body, replace(body, b=None)))
    assert_allclose(*map(np.asarray, both), atol=1e-12)
    loaded = lambda b: wp.solve(solid().model, replace(body, b=b))
    wrong = torch.tensor(1e-4), torch.ones(2), torch.ones(len(x), 1), torch.ones(x.shape) > 0
    all_refused(loaded, "b: expected (shape|real numbers)", wrong)
    points, u = lattice(3, 2.0), noise(lattice(3, 2.0))
    model, how = kernel("positive", 2.0), {"density": torch.tensor(2.0), "steps": np.float64(1)}
    run = wp.simulate(model, wp.Dirichlet(points, None, u), step=torch.tensor(1e-9), **how)
    assert run.u.shape == u.shape
    assert replace(model, certified_on=torch.tensor([5.0])).certified_on == (5.0,)
    assert wp.mpi.lattice((4.0, 4), torch.tensor(1.0), lambda x: x[:, 0] > 1).spacing == 1
    turned = np.ascontiguousarray(u[::-1])[::-1]
    mu = {"mu": torch.tensor(model.mu, requires_grad=True)}
    assert solve(model, points, 0 * turned, turned, parameters=mu).requires_grad
    assert wp.TorchModule(model, points)(turned).requires_grad


MODULES = [getattr(wp, name) for name in dir(wp) if inspect.ismodule(getattr(wp, name))]
PUBLIC = {
    f"{value.__module__}.{value.__qualname__}": value
    for module in (wp, *MODULES)
    for value in (getattr(module, name) for name in getattr(module, "__all__", ()))
    if callable(value)
}


def doors():
    """What users call by name: functions, classes and their own public methods."""
    for name, value in PUBLIC.items():
        if not isinstance(value, type):
            yield name, value
        else:
            for own, method in {**vars(value), "__init__": value.__init__}.items():
                method = getattr(method, "__func__", method)
                if inspect.isfunction(method) and (own == "__init__" or own[0] != "_"):
                    yield f"{name}.{own}", method


TYPED = {name: call.__wrapped__ for name, call in doors() if hasattr(call, "__wrapped__")}
LEARNS = torch.ones((), requires_grad=True)
WRONG = {
    float: ("a", nan, np.float32(-inf), 1e300, 1j, [1.0, 2.0], LEARNS),
    int: ("a", nan, 1.5, True, [1, 2], LEARNS),
    bool: ("no", 1, 0.0),
    str: (5, ["a"]),
    os.PathLike: (5, 1.5),
    np.ndarray: ("a", [None], {}),
    Mapping: ([], "a"),
    dict: ([], "a"),
}
BEYOND = {"a number > 0": 0.0, "a number ≥ 0": -1.0, "a number between 0 and 1": 1.0,
          "a whole number ≥ 1": 0, "a whole number ≥ 0": -1}  # fmt: skip
UNTYPED = {"load_mpi_library", "fit", "solve", "simulate"}
"""Without arguments, or whose options are checked where they are taken."""


def test_arguments_of_another_kind_are_refused_by_name():
    for call in filter(kinds_of, TYPED.values()):
        for argument, (kinds, default, bound) in kinds_of(call).items():
            wrong = WRONG.get(kinds[0], ("a", 5, LEARNS) if kinds[0] not in (tuple, list) else (5,))
            beyond = () if bound is None else (BEYOND.get(bound.words, "none of them"),)
            for value in (*wrong, *beyond):
                if any(isinstance(value, kind) for kind in kinds[1:]) or value is default:
                    continue
                with refused(f"^{argument}: expected"):
                    check_arguments(call, {argument: value})
            check_arguments(call, {argument: default})
    for two in 2, np.int64(2):  # and of whole numbers of 32 bits it is no factor
        assert str(check_arguments(wp.atoms.read_mat, {"positions": two})) == "{'positions': 2.0}"


def test_every_function_that_users_call_is_typed_and_calls_go_through_the_door():
    functions = {name for name, value in PUBLIC.items() if not isinstance(value, type)}
    assert {name.split(".")[-1] for name in functions - {*TYPED}} <= UNTYPED
    assert len(TYPED) > 230
    assert_refused({
        "^(horizon|spacing): expected": (
            lambda: wp.LPS("a"),
            lambda: wp.Points.disk(1e99, 5.0, 9.0), lambda: wp.Points.disk(9.0, 1e-300, 9.0),
        )
    })  # fmt: skip
