"""What tools/frozen.py holds: every material on fixed nodes and fields, and fits, by public names.

A case yields entries: name, class, value and, where the class has none for it, its limit.
"""

import hashlib
import itertools
import json
import shutil
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

import warp_peri
from warp_peri.points.mesh import make_mesh

wp: Any = warp_peri  # whose names may change type while they are held to their numbers

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "tests" / "frozen"
DATA, METRICS = ROOT / "data" / "graphene_0K.h5", ROOT / "runs" / "graphene_0K" / "metrics.json"
COPIES = tempfile.TemporaryDirectory(prefix="frozen")
DENSITY = 2000.0
Entries = Iterator[tuple[str, str, Any] | tuple[str, str, Any, float]]
CASES: dict[str, Callable[[], Entries]] = {}


class Absent(Exception):
    """Data that a case needs and that are not there."""


def nodes(material: Any, side: int, spacing: float = 1.0, axis: float = 0.0) -> Any:
    """side^d interior nodes and a collar of two horizons."""
    pad = int(np.ceil(2 * material.horizon / spacing - 1e-9))
    steps = np.array(list(itertools.product(range(-pad, side + pad), repeat=material.dimension)))
    inside = ((steps >= 0) & (steps < side)).all(axis=1)
    return wp.Points(spacing * steps, inside, spacing, axis=axis, units=material.units)


def waves(points: Any, samples: int, strain: float, seed: int = 0, shortest: int = 0) -> np.ndarray:
    """Sums of a few waves, periodic where the points are, with gradients of about `strain`.

    The longest ones, or with `shortest` any down to that part of the extent.
    """
    random, d = np.random.default_rng(seed), points.x.shape[1]
    extent = np.array(points.box) if points.box is not None else np.ptp(points.x, axis=0)
    u = np.zeros((samples, *points.x.shape))
    for one in u:
        long = np.array([*np.eye(d), np.ones(d), 2 * np.eye(d)[0] - np.eye(d)[1]])
        for k in random.integers(1, shortest + 1, (6, d)) if shortest else long:
            phase = 2 * np.pi * (points.x @ (k / extent) + random.random())
            one += np.sin(phase)[:, None] * random.normal(size=d) / np.linalg.norm(k)
    return strain * extent.max() / (4 * np.pi) * u


def rough(points: Any, seed: int = 1) -> np.ndarray:
    """Noise of the size of a spacing."""
    return (points.spacing or 1.0) * np.random.default_rng(seed).normal(size=points.x.shape)


def material(name: str) -> Any:
    """One that an earlier version saved, read from a copy that nothing was ever kept beside."""
    for path in FOLDER.glob(f"{name}.*"):
        shutil.copy(path, COPIES.name)
    return wp.load(Path(COPIES.name) / f"{name}.json")


def samples_of(op: Any, u: np.ndarray, part: float = 1.0) -> Any:
    """Fields, and the loads of a part of them, so that errors are of about 1 − part."""
    b = np.zeros_like(u)
    b[:, op.points.interior] = plain(op(part * u))
    return wp.Samples(op.points, u, b)


def plain(value: Any) -> Any:
    """An array of a tensor."""
    return value.detach().numpy() if isinstance(value, torch.Tensor) else value


def saved(given: Any) -> str:
    """Hash of the bytes that a material's file has."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frozen.json"
        wp.save(path, given)
        return hashlib.sha256(path.read_bytes()).hexdigest()


def transposed(op: Any, u: np.ndarray) -> np.ndarray:
    """The transposed product with a rough field, by torch."""
    leaf = torch.tensor(u, requires_grad=True)
    weight = torch.from_numpy(rough(op.points, seed=2)[op.points.interior])
    return torch.autograd.grad(op(leaf), leaf, weight)[0].numpy()


def lattice(name: str, side: int, spacing: float, axis: float, strain: float, can: str) -> Entries:
    """A saved material; `can` says what it has beside force, product and stress."""
    law = material(name)
    points = nodes(law, side, spacing, axis)
    how = {"allow_uncertified": True} if "uncertified" in can else {}
    op, two, noise = law.on(points, **how), waves(points, 2, strain), rough(points)
    yield "file", "moved", saved(law)
    yield "file in other units", "moved", saved(law.in_units(("nm", "GPa")))
    yield "force", "resummed", plain(op(two))
    calm = 0.02 if name == "tissue" else 1.0  # a sheet that folds has no digits to compare
    yield "force of noise", "resummed", plain(op(calm * noise))
    yield "product", "resummed", plain(op.jvp(two[0], noise))
    yield "stress", "resummed", op.stress(two)
    if "energy" in can:
        yield "energy", "resummed", op.energy(two)
    if "torch" in can:
        yield "transposed product", "resummed", transposed(op, two[0])
    made = samples_of(op, two)
    problem = wp.Dirichlet(points, made.b, made.u * ~points.interior[:, None])
    solution = wp.solve(op, problem)
    yield "solve", "resolved", solution.u
    yield "solve: residual", "residual", solution.residual, 1e-8
    yield "solve: stress", "resolved", solution.stress(), 1e-6
    yield "solve: what is proven", "moved", str(solution.proven)
    if "energy" in can:
        yield "solve: energy", "resolved", solution.energy()
    errors = wp.evaluate(op, samples_of(op, two, 0.98))
    yield "evaluate: E_res", "resummed", errors["E_res"], 1e-10
    yield "evaluate: E_u", "resolved", errors["E_u"], 5e-6
    for kind in ("sine", "multigrid") if "krylov" in can else ():
        solution = wp.solve(op, problem, solver=wp.CG(kind, tolerance=1e-10))
        yield f"{kind} solve", "resolved", solution.u, 1e-9
        yield f"{kind} solve: residual", "residual", solution.residual, 1e-10
    if "moves" in can:
        step = wp.certificates.critical_time_step(law, spacing=spacing, density=DENSITY, **how)
        yield "critical time step", "proven", step
        start = wp.Dirichlet(points, None, two[0])
        motion = wp.simulate(op, start, density=DENSITY, step=0.5 * step, steps=20)
        yield "motion", "resummed", motion.u, 1e-10
        yield "motion: energy", "resummed", motion.energy, 1e-10
    if "certify" in can:
        certificate = wp.certify(law, spacing=spacing)
        yield "proven constant", "proven", certificate.symbol_bound
        yield "smallest of the zone", "proven", certificate.symbol_min
    if "proof" in can:
        certificate = law.certified().certificate
        yield "proven constant", "proven", certificate.proven
        yield "statement", "moved", certificate.statement
    if "strain" in can:
        yield "proven strain", "proven", law.proven_strain(spacing)
    if "sheet" in can:
        box = wp.Points.sheet((14, 16, 12)[: law.dimension], spacing, units=law.units, axis=axis)
        cell, wave = law.on(box, **how), waves(box, 1, strain, seed=4)[0]
        yield "periodic force", "resummed", plain(cell(wave))
        if "periodic" in can:
            solution = wp.solve(cell, wp.Periodic(box, cell(wave)))
            yield "periodic solve", "resolved", solution.u


LPS = "energy torch krylov moves certify sheet periodic"
TENSORS = "energy krylov moves proof sheet periodic"
for row in (
    ("lps", 16, 1.0, 17.0, 0.02, LPS),
    ("lps_bond_based", 16, 1.0, 17.0, 0.02, LPS),
    ("lps_fitted", 36, 5.0, 0.0, 0.02, LPS),
    ("lps_in_space", 5, 1.0, 0.0, 0.02, "energy torch moves sheet uncertified"),
    ("crystal_third_order_energy", 16, 5.0, 0.0, 0.02, "energy strain sheet"),
    ("crystal_third_order_filtered", 16, 5.0, 0.0, 0.02, "strain sheet"),
    ("crystal", 16, 1.0, 0.0, 0.02, TENSORS),
    ("crystal_fitted", 36, 5.0, 0.0, 0.02, TENSORS),
    ("crystal_in_space", 8, 1.5, 0.0, 0.02, TENSORS),
    ("tissue", 12, 0.1, 0.0, 0.05, "energy"),
    ("neural", 12, 1.0, 0.0, 0.02, "torch"),
    ("family", 12, 5.0, 0.0, 0.02, "sheet"),
):
    CASES[row[0]] = partial(lattice, *row)


def lps_elsewhere() -> Entries:
    """The LPS as tensors in space, on scattered points, on another lattice; its adjoint."""
    law = wp.crystals.crystal_from_lps(material("lps_in_space"), 1.0)
    points = nodes(law, 6)
    problem = wp.Dirichlet(points, rough(points), 0 * points.x)
    yield "in space, as tensors: proven constant", "proven", law.certificate.proven
    yield "in space, as tensors: force", "resummed", law.on(points)(rough(points))
    yield "in space, as tensors: solve", "resolved", wp.solve(law, problem).u
    law = material("lps")
    even = nodes(law, 20)
    x = even.x + np.random.default_rng(5).uniform(-0.2, 0.2, even.x.shape)
    points = wp.Points(x, (np.abs(x - 9.5) < 7.0).all(axis=1), 0.0, units=law.units)
    op, u = law.on(points, allow_uncertified=True), waves(points, 1, 0.02)[0]
    solution = wp.solve(op, wp.Dirichlet(points, 1e-3 * np.cos(0.3 * x), u))
    yield "scattered: force", "resummed", op(u)
    yield "scattered: solve", "resolved", solution.u
    law = wp.transfers.on_lattice(material("lps_fitted"), spacing=4.0)
    points = nodes(law, 12, 4.0)
    yield "other lattice: moduli", "refitted", [law.lam, law.mu]
    yield "other lattice: force", "refitted", law.on(points)(waves(points, 1, 0.02)[0])
    law = material("lps")
    points = nodes(law, 8)
    numbers = {n: getattr(law, n) for n in ("lam", "mu", "alpha", "D")}
    leaves = [torch.tensor(v, dtype=torch.double, requires_grad=True) for v in numbers.values()]
    load = torch.from_numpy(rough(points, seed=6)).requires_grad_()
    given = wp.Dirichlet(points, load, torch.from_numpy(waves(points, 1, 0.02)[0]))
    u = wp.solve(law, given, solver=wp.Direct(), parameters=dict(zip(numbers, leaves))).u
    slopes = torch.autograd.grad((u**2).sum(), [*leaves, load])
    for name, slope in zip([*numbers, "load"], slopes):
        yield f"slope of an answer by {name}", "resolved", slope.numpy(), 1e-9


def bodies() -> Entries:
    """Free edges; an answer with its error."""
    n, size = 9, 160.0
    at = np.arange(n * n).reshape(n, n)
    low, right, up, far = (a.ravel() for a in (at[:-1, :-1], at[1:, :-1], at[:-1, 1:], at[1:, 1:]))
    both = [np.stack([low, right, far], axis=1), np.stack([low, far, up], axis=1)]
    sides = dict(zip(("left", "right", "lower", "upper"), (at[0], at[-1], at[:, 0], at[:, -1])))
    edges = {side: np.stack([line[:-1], line[1:]], axis=1) for side, line in sides.items()}
    mesh = make_mesh(size / (n - 1) * np.argwhere(at >= 0), np.concatenate(both), edges)
    problem = wp.Body(mesh, {"left": (0.0, 0.0)}, {"right": (1e-3, 2e-3)})
    for name in ("lps_fitted", "crystal_fitted"):
        solution = wp.solve(material(name), problem)
        yield f"free edges, {name}", "resolved", solution.u, 1e-6
        yield f"free edges, {name}: stress", "resolved", solution.stress(), 1e-5
    family = material("family")
    points = nodes(family, 14, 5.0)
    u = waves(points, 1, 0.02)[0] * ~points.interior[:, None]
    for tolerance in (0.1, 0.01):
        answer = wp.predict(family, wp.Dirichlet(points, 0 * u, u), tolerance)
        yield f"predict to {tolerance}", "resolved", answer.u, 1e-6
        yield f"predict to {tolerance}: error", "resolved", answer.error, 1e-3


def broken(name: str, sides: tuple[int, ...]) -> Entries:
    """A cracked plate or block: at rest, event by event, pulled slowly or in motion."""
    law, x, whole = material(name), wp.fracture.box_nodes(sides, 1.0), np.ones(np.prod(sides), bool)
    points = wp.Points(x, np.abs(x[:, 1]) < sides[1] / 2 - 1, 1.0, units=law.units)
    pull = 1e-3 * x * np.eye(law.dimension)[1]
    crack = np.array([(-20, 0.1, -20), (-20, 0.1, 20), (0.2, 0.1, 20), (0.2, 0.1, -20)])
    crack = crack[1:3, :2] if law.dimension == 2 else crack
    problem = wp.Cracked(points, u=pull, cracks=[crack])
    solution = wp.solve(law, problem)
    yield "file", "moved", saved(law)
    yield "solve", "resolved", solution.u, 1e-10
    yield "solve: energy", "resolved", solution.energy(), 1e-10
    yield "force", "resummed", solution.operator(rough(points))
    yield "slow growth", "resolved", wp.simulate(law, problem, events=4).u, 1e-10
    if name == "soft":
        run = wp.simulate(law, problem, loads=np.linspace(10, 60, 8), line=[[-50, 0], [50, 0]])
        yield "pulled: force", "resolved", run["force"], 1e-6
        yield "pulled: broken", "moved", run["broken"]
        return
    step = law.longest_step(1.0)
    yield "longest step", "proven", step
    free = wp.Cracked(wp.Points(x, whole, 1.0, units=law.units), cracks=[crack])
    run = wp.simulate(
        law, free, step=0.4 * step, steps=20, every=5, v=6**law.dimension / 3 * pull / step
    )
    yield "motion", "resummed", run.u, 1e-10
    yield "motion: damage", "moved", run.details.damage
    yield "motion: dissipated", "resummed", run["dissipated"], 1e-10


def diffusing(name: str, components: tuple[int, ...]) -> Entries:
    """A conductor, or a solid with one: steady, and in steps."""
    law = material(name)
    points, random = nodes(law, 16), np.random.default_rng(7)
    b, u = random.normal(size=(2, len(nodes(law, 16).x), *components))
    op, problem = law.on(points), wp.Dirichlet(points, b, u)
    yield "file", "moved", saved(law)
    yield "force", "resummed", op(u)
    yield "solve", "resolved", wp.solve(law, problem).u, 1e-9
    yield "motion", "resolved", wp.simulate(law, problem, step=0.1, steps=5).u, 1e-9
    if not components:
        yield "energy", "resummed", op.energy(u)
        yield ("transposed product", "resummed", op.vjp(u, rough(points)[points.interior, 0]))


def errors(found: Any, sets: dict[str, Any]) -> Iterator[tuple[str, str, float]]:
    """E_res and E_u of a learned material by set."""
    for role, samples in sets.items():
        table = wp.evaluate(found, samples)
        for error in ("E_res", "E_u"):
            yield f"{error} {role}", "refitted", table[error]


def fits() -> Entries:
    """Small fits of fields that a richer or a noisy material made."""
    B, methods = wp.Bernstein, wp.methods
    op = material("crystal").on(nodes(material("crystal"), 12))
    given = samples_of(op, waves(op.points, 8, 0.02, 1, shortest=6))
    other = {"other": samples_of(op, waves(op.points, 2, 0.02))}
    noise = wp.Samples(
        op.points, 3e-3 * np.array([rough(op.points, s) for s in range(8)]), 0 * given.u
    )
    noisy = wp.Samples(op.points, given.u + noise.u, given.b)
    for name, law, samples, how in (
        ("LPS", wp.LPS(3.0, B(3)), given, {}),
        ("LPS, moduli held", wp.LPS(3.0, B(3), method=methods.GaussNewton("isotropic")), given, {}),
        ("LPS, normalised", wp.LPS(3.0, B(3), normalise=True), given, {}),
        ("LPS, corrected", wp.LPS(3.0, B(3), loss="corrected"), noisy, {"noise": noise}),
        ("LPS, output", wp.LPS(3.0, B(3), loss="output"), noisy, {"noise": noise}),
    ):
        found = wp.fit(samples, law, progress=False, **how)
        yield f"{name}: moduli", "refitted", [found.material.lam, found.material.mu]
        yield f"{name}: proven constant", "proven", found.certificate.symbol_bound, 2e-4
        yield f"{name}: loss", "refitted", found.history[-1].E_res_train
        for error, kind, value in errors(found.material, other):
            yield f"{name}: {error}", kind, value
    found = wp.fit(given, wp.Crystal(2.5, "4mm", moduli=None), progress=False)
    yield "Crystal: proven constant", "proven", found.certificate.proven, 2e-4
    for error, kind, value in errors(found.material, other):
        yield f"Crystal: {error}", kind, value
    law = material("lps_in_space")
    op = law.on(nodes(law, 8), allow_uncertified=True)
    found = wp.fit(samples_of(op, waves(op.points, 3, 0.02, 1, shortest=4)), wp.LPS(2.0, B(1)))
    yield "LPS in space: moduli", "refitted", [found.material.lam, found.material.mu]
    yield "LPS in space: loss", "refitted", found.history[-1].loss[-1] ** 0.5
    yield "LPS in space: proven constant", "proven", found.certificate.symbol_bound, 2e-4
    law = material("tissue")
    op = law.on(nodes(law, 10, 0.1))
    found = wp.fit(samples_of(op, waves(op.points, 4, 0.1), 0.97), law.dictionary)
    yield "tissue: coefficients", "refitted", found.material.coefficients
    yield "tissue: loss", "refitted", found.residual
    law = material("neural")
    op = law.on(nodes(law, 8))
    training = wp.neural.TrainingSettings(epochs=3, batch=2)
    start = wp.neural.NeuralOperator(3.0, (6, 8), (10, 12), seed=2).double()
    learned, unseen = (samples_of(op, waves(op.points, n, 0.02, n)) for n in (4, 2))
    found = wp.fit(learned, start, validation=unseen, training=training, progress=False)
    yield "neural: curve", "refitted", np.array(found.history.curve)


ROWS = {
    "this library": "linear peridynamic solid (LPS)",
    "symbol > 0": "LPS, positive symbol alone",
    "tensors on 20 bonds": "crystal model, 20 bonds",
}
"""Rows of docs/record/graphene.json that the entries are about."""


def graphene() -> Entries:
    """What docs/record/graphene.json has, from the data, and the other laws on them."""
    if not DATA.exists():
        raise Absent("data/graphene_0K.h5 is not there; make graphene makes it")
    data = wp.load(DATA)
    sets = {role: data[role] for role in ("train", "val", "test")}
    B, smoothing = wp.Bernstein, wp.methods.Smoothing
    printed = dict.fromkeys(ROWS, "")
    for name, law in (
        ("this library", wp.LPS(20.0, B(10), conditions=wp.methods.StabilityConditions("paper"))),
        ("symbol > 0", wp.LPS(20.0, B(10))),
        ("tensors on 20 bonds", wp.Crystal(12.5)),
        ("ten lines", wp.LPS(12.5, B(4))),
        ("third order on tensors", wp.ThirdOrder(wp.Crystal(15.0), smoothing(10.0))),
    ):
        found = wp.fit(data["train"], law, progress=False)
        table = {}
        for error, kind, value in errors(found.material, sets):
            table[error] = f"{100 * value:.2f}"
            yield f"{name}: {error}", kind, value
        if name in printed:
            row = ("E_res train", "E_res val", "E_u train", "E_u val", "E_u test")
            printed[name] = " ".join(table[error] for error in row)
        law = found.material
        if hasattr(law, "proven_strain"):
            yield f"{name}: proven strain", "proven", law.proven_strain(5.0)
            yield f"{name}: constants", "refitted", [law.t3, law.tq2, law.q3]
        elif found.loss.reason:
            certificate = found.certificate
            yield f"{name}: moduli", "refitted", [law.lam, law.mu, *found.moduli[0].values()]
            yield f"{name}: loss", "refitted", found.history[-1].E_res_train
            yield f"{name}: proven constant", "proven", certificate.symbol_bound
            yield f"{name}: dense conditions", "refitted", certificate.gamma_min
        else:
            yield f"{name}: proven constant", "proven", found.certificate.proven
    record = json.loads((ROOT / "docs" / "record" / "graphene.json").read_text(encoding="utf-8"))
    shown = {name: " ".join(f"{n:.2f}" for n in row if n) for name, *row in record["rows"]}
    for name, numbers in printed.items():
        printed_row = shown.get(ROWS[name])
        yield f"{name}: row of the record", "moved", f"{numbers}, printed {printed_row}"
    if not METRICS.exists():
        raise Absent("runs/graphene_0K/metrics.json is not there; make graphene makes it")
    run = json.loads(METRICS.read_text(encoding="utf-8"))  # whatever code it ran
    for role, error in itertools.product(sets, ("E_res", "E_u")):
        yield f"main job: {error} {role}", "refitted", run[error][role]


CASES |= {
    "lps_elsewhere": lps_elsewhere,
    "bodies": bodies,
    "brittle": partial(broken, "brittle", (24, 16)),
    "brittle_in_space": partial(broken, "brittle_in_space", (8, 6, 5)),
    "soft": partial(broken, "soft", (20, 14)),
    "conductor": partial(diffusing, "conductor", ()),
    "coupled": partial(diffusing, "coupled", (3,)),
    "fits": fits,
    "graphene": graphene,
}
