"""The neural operator: the printed force, its tangent, files, equilibria and training."""

import base64
import json
import lzma
from copy import deepcopy
from dataclasses import replace
from functools import partial
from io import BytesIO

import h5py
import numpy as np
import pytest
import torch
from numpy.linalg import norm
from numpy.random import default_rng

import warp_peri as wp
from tests.gradients.cases import assert_slopes
from tests.support import ROOT, approx, assert_refused, each_refused, of_json, parametrize, refused
from tests.support.problems import ell, everywhere, lattice, loaded, noise, normal, rotation
from warp_peri.core.record import content_hash
from warp_peri.files.atomic import locked
from warp_peri.files.checkpoint import ArrayFile
from warp_peri.neural import NeuralOperator, TrainingSettings, train, training
from warp_peri.neural.placed import EquilibriumSolver, evaluate, interpolated_force
from warp_peri.points.dataset import in_units
from warp_peri.points.points import Samples, grid_places
from warp_peri.testing import assert_near as near
from warp_peri.testing import check_product

HORIZON = 3.0
FORMS = {
    "isotropic": {},
    "anisotropic": {"anisotropic": True},
    "proportional": {"anisotropic": True, "proportional": True},
}
WEIGHTS = ROOT / "examples" / "neural_weights"


def small(form="isotropic", **other):
    return NeuralOperator(HORIZON, (6, 8), (10, 12), **FORMS[form], **other).double()


random_field = lambda points, size=0.05, seed=0: size * noise(points, seed=seed)


def slow_force(material, points, u):
    """(NO1)–(NO6) node by node, on a lattice without a box."""
    net = lambda layers, inputs: layers(torch.from_numpy(inputs)).detach().numpy()[..., 0]
    x, delta, strain = points.x, material.horizon, material.strain
    distance = norm(x[:, None] - x, axis=2)
    family = [np.flatnonzero((row > 0) & (row <= delta * (1 + 1e-6))) for row in distance]

    def bonds(i):
        xi = x[family[i]] - x[i]
        r = norm(xi, axis=1)
        along = xi @ rotation(np.radians(points.axis))  # directions are those of the material
        omega = net(material.influence, (along if material.anisotropic else r[:, None]) / delta)
        Y = xi + u[family[i]] - u[i]
        length = norm(Y, axis=1)
        return r, omega, length - r, Y / length[:, None]

    def states(i):
        r, omega, e, _ = bonds(i)
        theta = (omega * e * r).sum() / (omega * r**2).sum()
        stretch = e / (strain * r)
        inputs = np.stack([omega, np.full_like(r, theta / strain), stretch, r / delta], axis=1)
        t = material.scale * net(material.state, inputs)
        return t * stretch if material.proportional else t

    out = []
    for i in np.flatnonzero(points.interior):
        mine = states(i)
        back = [states(j)[list(family[j]).index(i)] for j in family[i]]
        out.append(-(points.spacing**2) * ((mine + back)[:, None] * bonds(i)[3]).sum(axis=0))
    return np.array(out)


@parametrize("form", FORMS)
def test_force_is_the_printed_one(form):
    material = small(form)
    for angle in (0.0, 0.4):
        points = lattice(ell()[:4, :4], HORIZON, angle=angle)
        placed, u = material.on(points), random_field(points)
        near(placed(u), slow_force(material, points, u), 1e-12)
    check_product(placed, u, step=1e-6, tolerance=1e-6)


def test_any_strain_has_a_force():
    """Stretched tenfold, folded, all nodes at one place."""
    points = lattice(3, HORIZON)
    placed, u = small("proportional").on(points), random_field(points, 0.3)
    for F in (10 * np.eye(2), np.diag([1.0, -0.5]), np.zeros((2, 2))):
        assert np.isfinite(placed(points.x @ F.T + u * F.any() - points.x)).all()


def test_gradients_to_the_force_state_with_interpolation():
    """The grid moves with its own values, which no gradient sees: not to the influence function."""
    points, material = lattice(2, HORIZON), small("anisotropic")
    placed, u = material.on(points), torch.tensor(random_field(points))[None]
    weight = torch.tensor(normal((1, 4, 2), 2))
    for part in material.state.parameters():

        def value(of, part=part):
            part.data = of["networks"].detach().view(part.shape)
            return (interpolated_force(placed, u) * weight).sum()

        assert_slopes(value, {"networks": part.detach().ravel()}, 1e-4, 1e-6, [part])


def test_interpolation_approaches_the_networks():
    """Rectifiers bend where they like: a cell with a kink is wrong by its width, others not."""
    points = lattice(3, HORIZON)
    u = torch.tensor(random_field(points, 0.02))[None]
    for form in ("isotropic", "proportional"):
        placed = small(form).on(points)
        with torch.no_grad():
            exact = placed(u)
            rough = (interpolated_force(placed, u, cells=n) for n in (4, 64))
            coarse, fine = ((one - exact).norm() for one in rough)
        assert fine < min(coarse / 16, 2e-3 * exact.norm())


def test_files_that_are_not_believed(tmp_path, monkeypatch):
    path = tmp_path / "m.json"
    small().save(path)
    content = of_json(path)
    weights, first = content["weights"], "state.0.weight"
    nan = base64.b64encode(np.full(small().state[0].weight.shape, np.nan).tobytes()).decode()
    for words, change in {
        "reshape": {"state": [10, 13]},
        "base64-encoded": {"weights": weights | {first: weights[first][:-3]}},
        "KeyError": {"weights": {}},
        "finite": {"weights": weights | {first: nan}},
    }.items():
        changed = content | change
        path.write_text(json.dumps(changed | {"sha256": content_hash(changed)}))
        with refused(words):
            wp.load(path)
    spoilt, own = small(), small()
    own.influence[1] = torch.nn.Tanh()
    with torch.no_grad():
        spoilt.state[0].weight[0, 0] = torch.nan
    assert_refused({
        "finite": lambda: spoilt.save(path),
        "with ReLU between": lambda: own.save(path),
        "json": lambda: small().save(tmp_path / "m.h5"),
    })  # fmt: skip
    monkeypatch.setattr("warp_peri.neural.material.FITS", 1000)
    with refused("at most 1000 bytes of weights"):
        small().save(path)


def test_shipped_networks_are_read_and_written_alike(tmp_path):
    """Of any scale and strain, in two systems of units; half of their digits are kept."""
    shipped = sorted(WEIGHTS.glob("*.json.xz"))
    assert len(shipped) == 5
    for path in shipped:
        kept = lzma.decompress(path.read_bytes())
        (tmp_path / "kept.json").write_bytes(kept)
        (found := wp.load(tmp_path / "kept.json")).save(tmp_path / "m.json")
        again, given = wp.load(tmp_path / "m.json"), json.loads(kept)["weights"]
        assert again.content() == found.content()
        for key, part in again.state_dict().items():
            near(part.ravel(), np.frombuffer(base64.b64decode(given[key]), "<f2"), 0)


def test_numbers_points_and_fields_that_are_refused():
    points = lattice(3, HORIZON)
    placed, u = small().on(points), random_field(points)
    cube = everywhere(grid_places((3, 3, 3)).astype(float))
    assert_refused({
        "lattice": lambda: small().on(replace(points, spacing=0.0)),
        "two": (lambda: NeuralOperator(3.0, (0, 3)), lambda: NeuralOperator(3.0, state=())),
        "expected a plane, got 3 dimensions": lambda: small().on(cube),
        r"w, on u: expected shape \[1, 9, 2\], got \[2": lambda: placed.vjp(u, np.ones((2, 9, 2))),
        "u, one field: expected": lambda: placed.interior_tangent(np.stack([u, u])),
        "or of float64, got {torch.float16}": small().half,
    })  # fmt: skip
    small().to_empty(device="cpu")


def test_rounding_of_single_precision_is_an_equilibrium():
    """Its residual stays above the default tolerance, and is that of the numbers themselves."""
    points, b = lattice(4, HORIZON), np.zeros((16, 2))
    kinds, u = (torch.double, torch.float), random_field(points, 0.03, 1)
    exact, placed = (small("proportional").to(kind).on(points) for kind in kinds)
    u[points.interior] = 0
    expected, _ = EquilibriumSolver(exact).solve_from(b, u, 1e-8)
    found, record = EquilibriumSolver(placed).solve_from(b, u, 1e-8)
    assert record.converged
    near(found, expected, 1e-5)
    near(placed.solve(np.zeros_like(u), u).u, expected, 1e-8)


def test_a_sheet_without_a_collar_is_not_solved_for():
    """Its displacement is known up to a motion; its residual is told alone."""
    points = everywhere(grid_places((7, 7)).astype(float), box=(7, 7))
    material, u = small(), 0.03 * np.sin(2 * np.pi * points.x / 7)[None]
    errors = evaluate(material, Samples(points, u, 1.1 * material.on(points)(u)))
    assert errors["E_res"] == approx(1 / 11)
    assert "E_u" not in errors
    with refused("expected a collar"):
        material.on(points).solve(0 * u, u)


def waves(points, seed, count):
    random = default_rng(seed)
    k, phase = random.uniform(-1, 1, (count, 2, 2)), random.uniform(0, 6, (count, 2))
    return 0.03 * np.sin(points.x @ k.transpose(0, 2, 1) + phase[:, None])


def truth():
    """A material to learn: its force state pulls back, and hardens."""
    return NeuralOperator(2.5, (6, 8), (10, 12), proportional=True, seed=5).double()


def loads(seed):
    points = lattice(4, 2.5)
    return loaded(truth().on(points), waves(points, seed, 6))


def frames(seed):
    points = lattice(3, 2.5)
    search, fields = EquilibriumSolver(truth().on(points)), waves(points, seed, 3)
    none = np.zeros((points.interior.sum(), 2))
    return Samples(points, np.array([search.solve_from(none, u, 1e-8)[0] for u in fields]))


def student(horizon=2.5, **other):
    widths = (8, 8), (16, 16)
    return NeuralOperator(horizon, *widths, strain=0.2, **{"seed": 1} | other).double()


def test_forces_are_learned():
    material, settings = student(), TrainingSettings(epochs=60, rate=1e-2, batch=2, cells=12)
    history = train(material, loads(0), loads(1), settings, progress=False)
    assert history.best > 20
    assert history.curve[-1][1] < 0.2 * history.curve[0][1]
    samples = loads(2)
    errors = evaluate(material, samples)
    assert errors["E_res"] < 0.25
    assert errors["E_u"] < 0.15
    assert errors["converged"] == 1
    samples.u[0] = samples.b[0] = 0
    assert evaluate(material, samples, solve=False)["E_res_samples"][0] is None
    assert evaluate(material, samples)["E_u_samples"][0] is None


def test_loads_in_metres_are_learned_as_those_in_angstrom():
    """In single precision, which holds no square of a load in Pa/m."""
    settings, seen, errors = TrainingSettings(epochs=9, batch=2), (loads(0), loads(1)), []
    far = [in_units(one, ("m", "Pa")) for one in seen]
    soft = [replace(one, b=1e-40 * one.b) for one in far]
    for sets, size in (seen, 2.5), (far, 2.5e-10), (soft, 2.5e-10):
        start = student(units=sets[0].units, horizon=size).float()
        with torch.no_grad():  # whatever the user does with his
            fit = start.learn(sets[0], validation=sets[1], training=settings, progress=False)
        errors.append(evaluate(fit.material, sets[1])["E_u"])
    assert errors[1:] == 2 * [approx(errors[0], rel=1e-3)]
    with refused("units: the model is in m and Pa"):
        start.learn(sets[0], validation=seen[1])


def test_displacements_are_learned():
    material, settings = student(proportional=True), TrainingSettings(epochs=20, rate=1e-2, batch=3)
    before = evaluate(material, frames(4))["E_u"]
    history = train(material, frames(3), frames(4), settings, progress=False)
    assert history.curve[-1][2] < 0.5 * before
    assert evaluate(material, frames(5))["E_u"] < 0.6 * before


@parametrize("seen", [loads, frames])
def test_an_interrupted_training_goes_on_from_its_last_epoch(tmp_path, monkeypatch, seen):
    samples, val, settings = seen(0), seen(1), TrainingSettings(epochs=9, batch=2)
    whole, part, fresh = (student(proportional=seen is frames) for _ in range(3))
    path, epoch = tmp_path / "run.ckpt", training._Run.epoch
    train(whole, samples, val, settings, progress=False)

    def stops(run):
        if run.history.epochs == 3:  # before the first look
            with refused("another job"), locked(path):
                pass
            raise KeyboardInterrupt
        return epoch(run)

    monkeypatch.setattr(training, "SAVED", 0.0)
    with monkeypatch.context() as patched:
        patched.setattr(training._Run, "epoch", stops)
        with pytest.raises(KeyboardInterrupt):
            train(part, samples, val, settings, checkpoint=path, progress=False)
    train(fresh, samples, val, settings, checkpoint=path, progress=False)
    gap = 0 if seen is loads else 1e-7  # starts and factors of a search are not kept
    torch.testing.assert_close(whole.state_dict(), fresh.state_dict(), rtol=0, atol=gap)


def test_checkpoints_of_other_trainings(tmp_path):
    path, settings = tmp_path / "run.ckpt", TrainingSettings(epochs=1, batch=2)
    given = {"samples": loads(0), "val": loads(1), "training": settings}
    resumed = partial(train, checkpoint=path, progress=False)
    resumed(student(), **given)
    resumed(student(), **given | {"val": replace(loads(1), arrays={"unread": loads(1).u})})
    student().float().save(tmp_path / "start.json")
    for start in (student().float(), wp.load(tmp_path / "start.json")):  # of the same precision
        resumed(start, **given, checkpoint=tmp_path / "float.ckpt")
    moved, scaled, frozen = loads(0), student(), student()
    frozen.influence.requires_grad_(False)
    moved = replace(moved, points=replace(moved.points, x=moved.x + 1.0))
    scaled.scale *= 2
    with locked(path), refused("another job"):  # before it is read
        resumed(frozen, **given)
    assert frozen.scale == student().scale
    for change in (
        {"training": TrainingSettings(epochs=2, batch=3)},
        {"samples": moved},
        {"val": loads(2)},
        *({"material": other} for other in (student().float(), scaled, frozen, student(seed=7))),
    ):
        with refused("the checkpoint of another training"):
            resumed(**{"material": student(), **given} | change)
    f = h5py.File(path)
    told = torch.load(BytesIO(f["state"][()]), weights_only=True)
    mended, before = ArrayFile(path, f.attrs["key"], ""), deepcopy((mine := student()).state_dict())
    for change in ({"history": {"epochs": -3}}, *({name: None} for name in told)):
        torch.save(told | change, stream := BytesIO())
        mended.write({"state": np.frombuffer(stream.getvalue(), np.uint8)})
        if change != {"kept": None}:  # as of no epochs yet
            with refused("not a readable checkpoint|epochs: expected"):
                resumed(mine, **given)
    torch.testing.assert_close(mine.state_dict(), before, rtol=0, atol=0)


def test_what_nothing_is_learned_from():
    """Without samples, or with a norm of zero below the line, there is no error to lower."""
    one, unseen, bare = loads(0), loads(1), Samples(loads(0).points, loads(0).u)
    one.b[1] = 0
    settings = TrainingSettings(epochs=1)
    with refused("expected weights to learn"):
        train(student().requires_grad_(False), loads(0), unseen, settings)
    diverges = TrainingSettings(epochs=2, rate=1e99, cells=0)
    each_refused(lambda *given: train(student(), *given, progress=False), {
        "expected a load in every sample": (one, unseen, settings),
        "expected at least one, got none": (unseen[:0], unseen, settings),
        "validation: expected loads": (unseen, bare, settings),
        "validation: expected no loads": (bare, unseen, settings),
        "expected every frame displaced": (*2 * [Samples(bare.points, 0 * bare.u)], settings),
        "no look found a finite error": (loads(0), unseen, diverges),
    })  # fmt: skip
