"""Speed of the library beside other ways of computing the same, each table in one run.

    python tools/benchmark.py operator [--quick] [--threads 1]
    python tools/benchmark.py solve [--quick]
    python tools/benchmark.py breaking [--quick]
    python tools/benchmark.py front [--quick]

operator   a force of the linear solid and its gradient: Numba, SciPy, torch, LAMMPS's peri/lps
solve      static problems by size and shape, and the gradient through a solve
breaking   sweeps over a body whose bonds break: Numba
front      error against time of set-up and one load: models, elements, atoms; drawn with --draw

Each rival takes turns with the library, results are checked against the library's, and each
timing follows an untimed call. On one thread the processor's time counts, which a shared machine
disturbs least. What to read are ratios. Numba is in the extra `bench`, scikit-fem in `compare`.
"""

import json
import os
import platform
import re
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np
import torch

import warp_peri as wp
from examples.exact import relative_error
from examples.figures import panels, save_figure
from examples.prose import made_by
from examples.reproduce.neural import weights_of
from tools import rivals
from tools.elements import elastic_solver, local_solver
from tools.options import Options
from warp_peri import CG, LPSMaterial, Points, Samples
from warp_peri.atoms.calculators import LammpsError
from warp_peri.core.elastic import plane_isotropic
from warp_peri.core.stencil import Grid
from warp_peri.errors import exit_status
from warp_peri.files.atomic import write_json
from warp_peri.fracture import box_nodes, lattice_body
from warp_peri.fracture.bonds import CutOperator
from warp_peri.fracture.dynamics import BreakingBody, step
from warp_peri.fracture.materials import BrittleMaterial
from warp_peri.materials.lps_force import Bonds
from warp_peri.materials.lps_operator import LPSOperator, lps_force
from warp_peri.points.arguments import Count
from warp_peri.runtime import floats, set_num_threads, zeros

HORIZON = 4.0
"""In spacings; 48 bonds a node on a lattice."""
MODEL: dict[str, Any] = {
    "alpha": 1.6,
    "D": np.array([1.0, 0.4, -0.35, 0.15, -0.1, 0.2, 0.1, 0.3, 0.1, 0.2, 0.05]),
    "lam": -0.2,
    "mu": 0.72,
}
MODEL_FILE = Path(__file__).resolve().parent / "solve_model.json"
"""A learned graphene model, δ = 20 Å at h = 5 Å."""
SIDES = (64, 128, 250, 500, 1000)
TOLERANCE = 1e-8
Candidates = dict[str, Callable[[], Any]]
Solver = Callable[[np.ndarray, np.ndarray], np.ndarray]


def alternating(jobs: Sequence[Callable[[], Any]], repeats: int) -> np.ndarray:
    """Milliseconds of jobs that take turns, by processor and by clock, shape [2, J, R].

    A turn is as many calls as last 20 ms, and the first job changes from turn to turn.
    """
    for job in jobs:  # compiles
        job()
    began = time.perf_counter()
    jobs[0]()
    calls = max(1, int(0.02 / (time.perf_counter() - began)))
    times = np.empty((2, len(jobs), repeats))
    for turn in range(repeats):
        for place in range(len(jobs))[:: 1 if turn % 2 else -1]:
            time.sleep(0.02)  # until the threads of the one before stop spinning
            before = np.array([time.process_time(), time.perf_counter()])
            for _ in range(calls):
                jobs[place]()
            after = np.array([time.process_time(), time.perf_counter()])
            times[:, place, turn] = 1e3 * (after - before) / calls
    return times


def report(title: str, candidates: Candidates, rounds: int, threads: int, bound: float) -> None:
    """Check results against the first candidate's; each other takes turns with it alone, for what a
    rival leaves in caches and memory slows whoever comes next."""
    reference = None
    for name, function in candidates.items():
        results = function()
        results = results if isinstance(results, list | tuple) else [results]
        reference = [np.array(one) for one in results] if reference is None else reference
        for result, other in zip(results, reference):
            error = np.abs(result - other).max() / np.abs(other).max()
            if not error <= bound:
                raise RuntimeError(f"{name} is wrong by {error:.1e}")
    print(f"  {title}")
    (name, first), *others = candidates.items()
    for told, rival in others:
        times = np.median(alternating([first, rival], rounds)[int(threads > 1)], axis=1)
        ratio = f"{times[1] / times[0]:8.2f} × {name}, {times[0]:.2f} ms beside it"
        print(f"    {told:26}{times[1]:9.2f} ms {ratio}")


# The operator


def periodic(kind: str, side: int) -> tuple[Points, tuple[float, float]]:
    """side × side periodic points: a lattice, or one perturbed by 0.3 spacings."""
    x = np.argwhere(np.ones((side, side))).astype(float)
    if kind == "scattered":
        x += np.random.default_rng(0).uniform(-0.3, 0.3, x.shape)
    sides = (float(side), float(side))
    return Points(x, np.ones(len(x), bool), float(kind != "scattered"), box=sides), sides


def ours(bonds: Bonds, fields: np.ndarray) -> tuple[Callable, Callable]:
    """The library: forward, and forward and backward to (u, D, α)."""
    u, g = map(torch.from_numpy, fields)
    lam, mu = MODEL["lam"], MODEL["mu"]
    alpha, D = (torch.as_tensor(MODEL[key], dtype=torch.float64) for key in ("alpha", "D"))

    def forward() -> np.ndarray:
        bonds.kept = None  # the rivals compute K every time
        return lps_force(bonds, u, lam, mu, alpha, D).numpy()

    def both() -> list[np.ndarray]:
        bonds.kept = None
        leaves = [value.detach().requires_grad_() for value in (u, D, alpha)]
        Lu = lps_force(bonds, leaves[0], lam, mu, leaves[2], leaves[1])
        return [gradient.numpy() for gradient in torch.autograd.grad(Lu, leaves, g)]

    return forward, both


def operator(*, quick: bool, threads: int) -> None:
    """Forces and gradients on a lattice and on scattered points, and LAMMPS in space."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    threads = min(threads, cores or 1)  # what a process is bound to, Numba insists on
    set_num_threads(threads)
    torch.set_num_threads(threads)
    side, rounds = (20, 1) if quick else (200, 15)
    for kind in ("lattice", "scattered"):
        points, sides = periodic(kind, side)
        bonds = Bonds(points, HORIZON)
        fields = np.random.default_rng(1).normal(size=(2, len(points.x), 2))
        count = len(bonds.families.neighbour)
        print(f"\n{kind}, {len(points.x)} nodes, {count} bonds, {threads} threads")
        t = rivals.tables(bonds, points.x, sides, *fields, **MODEL)
        pairs = zip(ours(bonds, fields), rivals.torch_scatter(t))
        forward, both = ({"warp_peri": a, "torch scatter": b} for a, b in pairs)
        forward["SciPy CSR, built before"] = rivals.scipy_csr(t)
        by_numba(t, threads, forward, both)
        report("force", forward, rounds, threads, 1e-8)
        report("force and gradient to u, D, α", both, rounds, threads, 1e-8)
    print("\na block in space that may break:", json.dumps(block(rounds, 8 if quick else 16)))


def by_numba(t: rivals.Tables, threads: int, forward: Candidates, both: Candidates) -> None:
    """Add Numba's loops to the candidates, none where it is not installed."""
    if find_spec("numba") is None:
        print("  Numba is not installed: pip install 'warp_peri[bench]'")
        return
    from tools import rivals_numba

    rivals_numba.numba.set_num_threads(threads)
    forward["Numba by lists"], both["Numba by lists"] = rivals_numba.lists(t)
    if len(t.r) < len(t.neighbour):
        forward["Numba by rows"] = rivals_numba.rows(t)


# Solves


def mask_of(shape: str, n: int) -> np.ndarray:
    """Unknown nodes in an n × n box: a square, a disk, an L, or an L with a hole."""
    i, j = np.mgrid[:n, :n] - (n - 1) / 2
    if shape == "disk":
        return i**2 + j**2 <= (n / 2) ** 2
    mask = np.ones((n, n), bool)
    if shape.startswith("L"):
        mask[n // 2 :, n // 2 :] = False
    if shape == "L with a hole":
        mask[(i + n / 4) ** 2 + (j + n / 4) ** 2 < (n / 10) ** 2] = False
    return mask


def lattice_of(mask: np.ndarray, horizon: float, spacing: float) -> Points:
    """A lattice around the mask, with the collar that the horizon needs."""
    pad = 2 * int(np.floor(horizon / spacing + 1e-6))
    mask = np.pad(mask, pad)
    return Points(spacing * np.argwhere(np.ones_like(mask)).astype(float), mask.ravel(), spacing)


def loads(grid: Grid) -> dict[str, np.ndarray]:
    """A smooth load, a point load and noise on the unknown nodes, shape [I, 2]."""
    n, m = (size - 2 * grid.reach for size in grid.shape)
    x, y = (np.arange(size) / size for size in (n, m))
    smooth = np.stack([np.sin(3 * x)[:, None] * np.cos(2 * y), np.ones((n, m))])
    point = np.zeros((2, n, m))
    point[0, n // 3, m // 4] = 1
    fields = {"smooth": smooth, "point": point}
    fields["noise"] = np.random.default_rng(0).normal(size=(2, n, m))
    around = [(0, 0), *[(grid.reach, grid.reach)] * 2]
    return {name: grid.gather(np.pad(f, around)[None])[0] for name, f in fields.items()}


def one_solve(model: LPSMaterial, shape: str, side: int, method: str) -> tuple[int, list[float]]:
    """Unknowns; seconds of layout, set-up and the slowest of three loads; iterations, residual."""
    points = lattice_of(mask_of(shape, side), model.horizon, model.certified_on[0])
    times = [time.perf_counter()]
    linear = LPSOperator(model, points).linear
    times.append(time.perf_counter())
    linear.check_definite()
    linear.filter(method)
    times.append(time.perf_counter())
    solves = []
    for force in loads(linear.grid).values():
        start = time.perf_counter()
        _, record = linear.inverse(force, TOLERANCE, method)
        solves.append((time.perf_counter() - start, record.iterations, record.residual))
    return 2 * len(linear.grid.interior), [*np.diff(times), *map(max, zip(*solves))]


def gradient_over_solve(model: LPSMaterial, side: int) -> float:
    """Time of the gradient of a solve to load, λ, μ, α and D over that of the solve."""
    points = lattice_of(mask_of("square", side), model.horizon, model.certified_on[0])
    noise = torch.from_numpy(np.random.default_rng(0).normal(size=(1, len(points.x), 2)))
    inside = torch.tensor(points.interior)[:, None]
    values = {"lam": model.lam, "mu": model.mu, "alpha": model.alpha, "D": model.D}
    parameters = {
        name: torch.tensor(value, dtype=torch.float64, requires_grad=True)
        for name, value in values.items()
    }
    b, ratios = (noise * inside).requires_grad_(), []
    for _ in range(3):
        start = time.perf_counter()
        given = wp.Dirichlet(points, b, noise * ~inside)
        u = wp.solve(model, given, solver=CG("sine"), parameters=parameters).u
        middle = time.perf_counter()
        torch.autograd.grad((u * u).sum(), [b, *parameters.values()], allow_unused=True)
        ratios.append((time.perf_counter() - middle) / (middle - start))
    return float(np.median(ratios))


def solves(*, quick: bool, threads: int) -> None:
    """Time, iterations and the exponent of cost; the gradient of a solve."""
    set_num_threads(threads)
    torch.set_num_threads(threads)
    model, sides = wp.load(MODEL_FILE), (24, 32) if quick else SIDES
    print("shape          unknowns   layout  set-up   solve  iterations  residual")
    for shape in ("square", "disk", "L with a hole"):
        method, seconds = "sine" if shape == "square" else "multigrid", {}
        for side in sides:
            unknowns, (layout, setup, solve, iterations, residual) = one_solve(
                model, shape, side, method
            )
            seconds[unknowns] = solve
            print(
                f"{shape:14} {unknowns:8} {layout:8.2f}{setup:8.2f}{solve:8.2f} {iterations:10.0f}"
                f"   {residual:.1e}", flush=True,
            )  # fmt: skip
        sizes, times = np.log([*seconds]), np.log([*seconds.values()])
        power = np.polyfit(sizes, times, 1)[0]
        print(f"{shape:14} time of a solve grows with unknowns to the power {power:.2f}")
    ratio = gradient_over_solve(model, sides[-1] if quick else 500)
    print(f"gradient to load, λ, μ, α, D: {ratio:.2f} × the solve")


# Bodies that break


def sweeps(sides: tuple[int, int], ratio: float, repeats: int, share: float) -> dict[str, float]:
    """Milliseconds of a sweep that breaks bonds, here and by Numba, λ = 2μ.

    `share`: of bonds that are broken at the start, at random.
    """
    random, body = np.random.default_rng(0), lattice_body(box_nodes(sides, 1.0), 1.0, ratio)
    model = LPSMaterial(lam=2.0, mu=1.0, alpha=1.0, D=np.ones(1), horizon=ratio)
    limits = 0.02 * body.r**2
    cut = CutOperator(model, body, limits=limits)
    (stiffness, felt, _), table, count = cut.bonded, body.neighbour.copy(), len(body.x)
    table[random.random(table.shape) < share] = -1
    u = 3e-3 * random.standard_normal((count, 2))
    field, links = floats(u.copy(), cut.vector), cut.links(table)
    force, energy = zeros(count, dtype=cut.vector), zeros(count)
    inputs = (u, body.xi, 2 * stiffness, limits, np.zeros(count, np.uint8), table)
    theirs = (np.zeros((count, 2)), np.zeros(count), np.zeros(count, np.int32))
    from tools.rivals_numba import breaking as rival

    more = felt, 1.0, np.zeros(count)
    jobs = (
        lambda: cut.sweep(field, links, force, energy, breaking=True),
        lambda: rival(*inputs, *theirs, *more),
    )
    times = alternating(jobs, repeats)[0]
    apart = np.abs(force.numpy() - theirs[0]).max() / np.abs(theirs[0]).max()
    if not (apart < 1e-12 and np.array_equal(cut.kept(links), table >= 0)):
        raise RuntimeError(f"the two differ by {apart:.1e}, or in what breaks")
    ms, numba_ms = np.median(times, axis=1)
    return {"nodes": count, "broken": share, "ms": ms, "Numba over it": numba_ms / ms}


def block(repeats: int, side: int, ratio: float = 3.0) -> dict[str, float]:
    """Millions of bonds a second in whole steps of a free block that may break, one core.

    Bonds are those of the whole ball of every node. LAMMPS's `peri/lps` looks for contacts too.
    """
    set_num_threads(1)
    body = lattice_body(box_nodes(3 * (side,), 1.0), 1.0, ratio)
    model = LPSMaterial(lam=2.0, mu=1.0, alpha=1.0, D=np.ones(1), horizon=ratio, dimension=3)
    moving = BreakingBody(BrittleMaterial(model, 1.0, critical_stretch=0.02), body)
    begin = 1e-3 * np.random.default_rng(0).standard_normal(body.x.shape)
    state, dt = moving.start(v=begin), 0.5 * moving.longest_step
    jobs: dict[str, Callable[[], Any]] = {"warp_peri": lambda: step(moving, state, dt)}
    try:
        lammps = rivals.PeriLps(side, ratio)
        jobs["LAMMPS peri/lps"] = lambda: lammps.march(1)
    except LammpsError as error:
        print(f"LAMMPS left out: {error}")
    bonds = len(body.x) * moving.operator.bonds
    speed = bonds / 1e3 / np.median(alternating([*jobs.values()], repeats)[0], axis=1)
    return {f"{name}, Mbond/s": round(value, 1) for name, value in zip(jobs, speed)}


def breaking(*, quick: bool, threads: int) -> None:
    """Plates by size and share of broken bonds, and the block."""
    if find_spec("numba") is None:
        raise wp.InputError("breaking: needs Numba; pip install 'warp_peri[bench]'")
    from tools.rivals_numba import numba

    set_num_threads(threads)
    numba.set_num_threads(threads)
    plates = ((60, 24, 3.0),) if quick else ((400, 160, 3.0), (400, 160, 4.0), (1000, 400, 3.0))
    for width, height, ratio in plates:
        for share in (0.0, 0.1, 0.5)[: 1 if quick else 3]:
            print(json.dumps(sweeps((width, height), ratio, 1 if quick else 15, share)), flush=True)
    print(json.dumps(block(1 if quick else 15, 8 if quick else 16)))


# Error against time

FRONT = ROOT / "docs" / "record" / "front.json"
PAPER = (6.75, 0.035)
"""Error on disks of You et al. (2021) as printed [%], and the seconds of the same solid here."""


def waves(points: Samples) -> np.ndarray:
    """Wave numbers (p, q) of the periodic samples, shape [S, 2], from their load ids."""
    ids = [str(load) for load in points.arrays["load_id"]]
    return np.array([[int(n) for n in re.findall(r"\d+", load)[-2:]] for load in ids])


def split(train: Samples) -> tuple[Samples, np.ndarray]:
    """The waves with even p + q, to fit to; of the others the shorter half, by number."""
    size, out = np.hypot(*waves(train).T), waves(train).sum(axis=1) % 2 == 1
    seen = Samples(train.points, train.u[~out], train.loads[~out])
    return seen, np.flatnonzero(out & (size >= np.median(size[out])))


def timed(prepare: Callable[[Samples], Solver], samples: Samples, some: Any) -> list[float]:
    """Seconds of set-up and of one load, the least of three, and the mean error of u."""
    setup, each, inside = [], [], samples.interior
    errors: dict[int, float] = {}
    for _ in range(3):
        start = time.process_time()
        solver = prepare(samples)
        setup.append(time.process_time() - start)
        for s in some:
            start = time.process_time()
            u, exact = solver(samples.loads[s], samples.u[s]), samples.u[s][inside]
            each.append(time.process_time() - start)
            errors[s] = relative_error(u, exact)
    return [min(setup), min(each), float(np.mean([*errors.values()]))]


def by_rest(material: Any) -> Callable[[Samples], Solver]:
    """A material placed once, and its own equilibrium."""

    def prepare(samples: Samples) -> Solver:
        operator = material.on(samples.points)
        return lambda b, u: np.asarray(operator.solve(b, u).u)[samples.interior]

    return prepare


def by_predict(family: Any) -> Callable[[Samples], Solver]:
    """Answers of an ensemble within 1 %."""

    def prepare(samples: Samples) -> Solver:
        placed: Any = family.ensemble_on(samples.points)
        answer: Any = partial(wp.predict, placed, tolerance=0.01)
        return lambda b, u: answer(wp.Dirichlet(samples.points, b, u)).u[samples.interior]

    return prepare


def candidates(data: wp.Dataset, seen: Samples, third: list[float]) -> dict[str, tuple[str, Any]]:
    """Nodes and solver by name: models that are fitted here, and elements with true constants."""

    def learned(law: Any, **options: Any) -> Any:
        return wp.fit(seen, law, progress=False, **options).material

    rich = wp.ThirdOrder(wp.Crystal(15.0), wp.methods.Smoothing(10.0))
    truth = data.provenance["truth"]
    C = plane_isotropic(truth["lambda"], truth["mu"])
    found: dict[str, tuple[str, Any]] = {
        "LPS": ("", by_rest(learned(wp.LPS(20.0)))),
        "crystal": ("", by_rest(learned(wp.Crystal(12.5)))),
        "third order on a crystal": ("", by_rest(learned(rich))),
        "prediction at 1 %": (
            "", by_predict(learned(wp.prediction.Ensemble(rich), validation=data["val"]))
        ),
        "neural operator": ("", by_rest(weights_of("graphene"))),
    }  # fmt: skip
    for end, h in (("_ten", "10 Å"), ("", "5 Å"), ("_fine", "2.5 Å")):
        local = partial(elastic_solver, order=1, C=C)
        found[f"local, {h}"] = (end, local)
        found[f"local third order, {h}"] = (end, partial(local, third=third))
    fine = partial(local_solver, C=C, third=third)
    return found | {"local third order, quadratic, 2.5 Å": ("", fine)}


def atoms() -> list[float]:
    """Seconds of the atoms on the disk: relaxing and factorising once, then one load."""
    from tools import make_graphene as making

    _, disk = making.graphene_bodies()
    seconds = []
    for some in (making.TEST[:1], making.TEST[1:4]):  # a process sets a body up once
        with tempfile.TemporaryDirectory() as folder:
            start = time.process_time()
            making.solve_samples(disk, list(some), Path(folder))
            seconds.append(time.process_time() - start)
    return [max(seconds[0] - seconds[1] / 3, 0.0), seconds[1] / 3]


def front(*, quick: bool, threads: int) -> None:
    """Measure every candidate on free disks and short waves; write the record."""
    from tools import make_graphene as making
    from tools.elastic import cubic_constants
    from tools.graphene import bond_length

    set_num_threads(1)
    torch.set_num_threads(1)
    file = ROOT / "data" / "graphene_0K.h5"
    data = wp.load(file)
    seen, short = split(data["train"])
    constants, rows = cubic_constants(bond_length()), []
    third = [constants[name] for name in ("t3", "tq2", "q3")]
    sets = {name: data[name] for name in ("test", "train", "test_fine", "train_fine")}
    told: Any = zip(("train", "test"), making.graphene_bodies(), (making.TRAINING, making.TEST))
    for name, body, loads in told:
        solved = making.solve_all({body: loads}, file.with_suffix(".cache"), 1, True)[body]
        sets[f"{name}_ten"] = making.point_set(body, loads, solved, spacing=10.0)
    with warnings.catch_warnings(action="ignore"):
        told = candidates(data, data["train"], third), candidates(data, seen, third)
        for (name, (end, prepare)), (_, half) in zip(told[0].items(), told[1].values()):
            if quick and end:
                continue
            disks = timed(prepare, sets[f"test{end}"], range(1 if quick else 4))
            rough = timed(half, sets[f"train{end}"], short[: 1 if quick else None])
            row = [1e3 * disks[0], 1e3 * disks[1], 100 * disks[2], 100 * rough[2]]
            rows.append([name, *(float(f"{value:.3g}") for value in row)])
            print(rows[-1], flush=True)
    if quick:
        return
    rows.append(["atoms (LAMMPS)", *(float(f"{1e3 * s:.3g}") for s in atoms()), 0.0, 0.0])
    table = made_by("python tools/benchmark.py front")
    table["caption"] = (
        "Free disks of graphene, after fits to all 70 loads; waves of 16 to 24 Å, after fits to 34 "
        "of these loads, other waves."
    )
    table["columns"] = ["model", "set-up [ms]", "one load [ms]", "disks [%]", "short waves [%]"]
    machine = f"{platform.machine()}, {os.cpu_count()} cores"
    write_json(FRONT, {"machine": machine, "tables": {"front": table | {"rows": rows}}})


PLACES = {
    "LPS": ((7, 1), (6, 3)),
    "crystal": ((2, -12), (2, -12)),
    "local, 10 Å": ((0, 7), (0, 6)),
    "local, 5 Å": ((7, -5), (-6, -3)),
    "local, 2.5 Å": ((6, 3), (-6, -3)),
    "local third order, 10 Å": ((6, 3), (6, -3)),
    "local third order, 5 Å": ((6, 3), (6, -3)),
    "local third order, 2.5 Å": ((0, -13), (6, 5)),
    "local third order, quadratic, 2.5 Å": ((0, 6), (0, -13)),
    "prediction at 1 %": ((-6, -3), (-6, -10)),
    "third order on a crystal": ((-6, -3), (6, -10)),
    "neural operator": ((-6, 4), (-6, 5)),
}
"""Shifts of the names in the two panels [points]."""


def draw(path: Path = ROOT / "docs" / "pictures" / "front.png") -> None:
    """The record as a picture: error over the time of set-up and one load; the front as a line."""
    rows = json.loads(FRONT.read_text("utf-8"))["tables"]["front"]["rows"]
    figure, axes = panels(9.6, 4.4, count=2, sharey=True)
    for ax, column, title in zip(axes, (3, 4), ("Free disks, strain 2 %", "Waves of 16 to 24 Å")):
        places = {row[0]: (row[1] + row[2], row[column]) for row in rows if row[column] > 0}
        if column == 3:
            places["LPS as printed†"] = (1e3 * PAPER[1], PAPER[0])
        best: list[tuple[float, float]] = []
        for at in sorted(places.values()):
            if not best or at[1] < best[-1][1]:
                best.append(at)
        exact = next(row[1] + row[2] for row in rows if row[column] == 0)
        ax.step(*np.transpose([*best, (exact, best[-1][1])]), color="0.6", lw=1, where="post")
        ax.axvline(exact, color="k", ls="--", lw=1)
        ax.annotate("atoms: exact", (exact, 25), (-3, 0), textcoords="offset points", ha="right")
        for name, at in places.items():
            own = not name.startswith(("local", "neural", "LPS as"))
            color = "#1f4e79" if own else "#b5382a"
            ax.plot(*at, "o", color=color, ms=5)
            shift = PLACES.get(name, ((6, 3),) * 2)[column - 3]
            side = "left" if shift[0] >= 0 else "right"
            text = name.replace("local third order, quadratic", "quadratic third order")
            ax.annotate(text, at, shift, color=color, size=8, ha=side, textcoords="offset points")
        ax.set(xscale="log", yscale="log", xlabel="set-up and one load [ms]", title=title)
    axes[0].set(ylabel="error of displacement [%]", ylim=(0.04, 60))
    axes[0].set_yticks([0.1, 0.2, 0.5, 1, 2, 5, 10], ["0.1", "0.2", "0.5", "1", "2", "5", "10"])
    save_figure(figure, path)


KINDS = {"operator": operator, "solve": solves, "breaking": breaking, "front": front}


def main(arguments: list[str] | None = None) -> int:
    options = {
        "quick": (False, "all of it in seconds; its times say nothing"),
        "threads": (2, "of every candidate", Count),
        "draw": (False, "front: draw the record, and measure nothing"),
    }
    parser = Options(__doc__, options=options)
    parser.add_argument("what", choices=KINDS)
    given = parser.parse_args(arguments)
    if given.draw and given.what != "front":
        parser.error(f"--draw: expected with front, got {given.what}")
    if given.draw:
        draw()
    else:
        KINDS[given.what](quick=given.quick, threads=given.threads)
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
