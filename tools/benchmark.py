"""Speed and memory of the LPS operator beside other ways of computing it, all in one run.

    python tools/benchmark.py operator [--quick] [--threads 1]
    python tools/benchmark.py roofline [--quick]
    python tools/benchmark.py solve [--quick] [--model MODEL.json] [--out TABLE.json]
    python tools/benchmark.py crystals [--quick]
    python tools/benchmark.py broken [--quick] [--threads 1] --json
    python tools/benchmark.py ranks [--quick]
    python tools/benchmark.py gradient [--quick] [--long] [--json]
    python tools/benchmark.py choice [--quick] [--model MODEL.json] [--out TABLE.json]

Every candidate computes the same force (and the same gradients to u, D and α), checked against the
first. Rounds are interleaved, each timing follows an untimed call, and the best round counts (a
median folds in what else the machine does). On one thread the median of the processor's time counts
instead, which a shared machine disturbs less. Every candidate has the same number of threads. Bonds
are counted once from each end. What to read are the ratios: the times belong to the machine. Needs
the extra `bench` for Numba.
"""

import contextlib
import json
import os
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import torch
import warp as wp
from scipy.special import comb

from tools import (
    benchmark_crystals,
    benchmark_damage,
    benchmark_gradient,
    benchmark_ranks,
    numba_rival,
    numba_rows,
    rivals,
    roofline,
    solve_study,
    solver_choice,
)
from tools.options import Options
from warp_peri import Points
from warp_peri.atoms.calculators import LammpsError, lammps_class
from warp_peri.errors import exit_status
from warp_peri.kernels.lps.influence import influence
from warp_peri.launch import launch_slices, set_threads
from warp_peri.materials.lps_bonds import Bonds
from warp_peri.materials.lps_force import BLOCKS, lps_force
from warp_peri.methods import Solid
from warp_peri.points.families import families_of

HORIZON = 4.0
"""In spacings; 48 bonds a node on a lattice."""
MODEL: dict[str, Any] = {
    "alpha": 1.6,
    "D": np.array([1.0, 0.4, -0.35, 0.15, -0.1, 0.2, 0.1, 0.3, 0.1, 0.2, 0.05]),
    "lam": -0.2,
    "mu": 0.72,
}
QUICK = 40
"""Nodes along an edge for a look at whether all runs."""
PRECISIONS = "float64", "float32"
LARGE = 5_000_000
"""Bonds from which on rivals that store vectors bond by bond are left out."""
Candidates = dict[str, Callable[[], Any]]


def problem(kind: str, side: int) -> tuple[Points, tuple[float, float]]:
    """side × side periodic points: a lattice, or one perturbed by 0.3 spacings."""
    x = np.argwhere(np.ones((side, side))).astype(float)
    if kind == "scattered":
        x += np.random.default_rng(0).uniform(-0.3, 0.3, x.shape)
    box = (float(side), float(side))
    return Points(x, np.ones(len(x), bool), float(kind != "scattered"), box=box), box


def ours(bonds: Bonds, fields: np.ndarray, dtype: torch.dtype) -> tuple[Callable, Callable]:
    """The library: forward, and forward and backward to (u, D, α)."""
    u, g = (torch.as_tensor(field, dtype=dtype) for field in fields)
    lam, mu = MODEL["lam"], MODEL["mu"]
    alpha, D = (torch.as_tensor(MODEL[key], dtype=dtype) for key in ("alpha", "D"))

    def forward() -> np.ndarray:
        bonds.kept = None  # the rivals compute K every time
        return lps_force(bonds, u, Solid(lam, mu, alpha, D)).numpy()

    def both() -> list[np.ndarray]:
        bonds.kept = None
        leaves = [value.detach().requires_grad_() for value in (u, D, alpha)]
        Lu = lps_force(bonds, leaves[0], Solid(lam, mu, leaves[2], leaves[1]))
        return [gradient.numpy() for gradient in torch.autograd.grad(Lu, leaves, g)]

    return forward, both


def ours_kept(bonds: Bonds, u: np.ndarray, dtype: torch.dtype) -> Callable[[], np.ndarray]:
    """The library's differentiable forward pass while D and α stay as they are: K is kept."""
    field, solid = torch.as_tensor(u, dtype=dtype), Solid(**MODEL)
    return lambda: lps_force(bonds, field, solid).numpy()


def on_threads(count: int, function: Callable[[], Any]) -> Callable[[], Any]:
    """The function on another number of the library's threads."""

    def call() -> Any:
        set_threads(count)
        try:
            return function()
        finally:
            set_threads(THREADS)

    return call


def interleaved(candidates: Candidates, rounds: int, tolerance: float) -> dict[str, float]:
    """Least seconds of each candidate over the rounds, after a round that checks the results."""
    reference = None
    for name, function in candidates.items():
        results = function()
        results = results if isinstance(results, (list, tuple)) else [results]
        reference = results if reference is None else reference
        for result, other in zip(results, reference):
            error = np.abs(result - other).max() / np.abs(other).max()
            if not error <= tolerance:
                raise RuntimeError(f"{name} is wrong by {error:.1e}")
    times: dict[str, list[float]] = {name: [] for name in candidates}
    alone = THREADS > 1  # the clock on the wall needs an idle machine
    clock, typical = (time.perf_counter, min) if alone else (time.process_time, np.median)
    for _ in range(rounds):
        for name, function in candidates.items():
            time.sleep(0.02)  # until the threads of the one before stop spinning
            function()
            start = clock()
            function()
            times[name].append(clock() - start)
    return {name: typical(values) for name, values in times.items()}


def copy_bandwidth(*, quick: bool = False) -> float:
    """Bytes a second, read and written, of NumPy copying 256 MiB (quick: 8) on one thread."""
    source = np.ones(2**20 if quick else 2**25)
    target = np.empty_like(source)
    best = np.inf
    for _ in range(7):
        start = time.process_time()
        np.copyto(target, source)
        best = min(best, time.process_time() - start)
    return 2 * source.nbytes / best


def traffic(bonds: Bonds, nodes: int, count: int, size: int) -> int:
    """Bytes a forward pass must move if every array is read or written once a sweep."""
    fields = nodes * (2 * (2 * size + size) + 2 * size)  # u and θ in both sweeps, L u out
    if bonds.layout.in_rows:
        return fields
    if bonds.lattice:
        return 2 * 4 * count + fields
    return count * (2 * (4 + size) + 4 * size) + fields  # K: r, W in, K W out; volume: r, K W


def report(title: str, seconds: dict[str, float], bonds: int) -> None:
    first = next(iter(seconds.values()))
    print(f"  {title}")
    for name, value in seconds.items():
        speed = f"{bonds / value / 1e6:8.1f} Mbond/s {1e3 * value:9.1f} ms"
        print(f"    {name:24}{speed}   {value / first:6.2f} × the time of the first")


def measure(
    kind: str, side: int, precision: str, rounds: int, bandwidth: float, *, fastmath: bool = True
) -> dict[str, dict[str, float]]:
    """One table; returns the seconds of each candidate, forward, and forward and backward."""
    points, box = problem(kind, side)
    start = time.perf_counter()
    bonds = Bonds(points, HORIZON, precision=precision)
    built = time.perf_counter() - start
    count, nodes = len(bonds.families.neighbour), len(points.x)
    fields = np.random.default_rng(1).normal(size=(2, nodes, 2))
    dtype, size = getattr(torch, precision), np.dtype(precision).itemsize
    force, gradient = ours(bonds, fields, dtype)
    print(f"\n{kind}, {nodes} nodes, {count / nodes:.1f} bonds a node, {precision}")
    print(
        f"  families and weights {built:.2f} s; {memory(bonds, size) / count:.1f} bytes a bond"
        " all told"
    )
    forward: Candidates = {"warp_peri": force}
    both: Candidates = {"warp_peri": gradient}
    if THREADS > 1:
        forward["warp_peri, 1 thread"] = on_threads(1, force)
        both["warp_peri, 1 thread"] = on_threads(1, gradient)
    if kind == "scattered":
        forward["warp_peri, K kept"] = kept = ours_kept(bonds, fields[0], dtype)
        if THREADS > 1:
            forward["warp_peri, kept, 1 thr."] = on_threads(1, kept)
    t = rivals.tables(bonds, points.x, np.array(box), *fields, **MODEL)
    if count < LARGE:
        forward["torch scatter"], both["torch scatter"] = rivals.torch_scatter(t, dtype)
        if precision == "float64":
            forward["SciPy CSR, built before"] = rivals.scipy_csr(t)
    else:
        print("  torch and SciPy left out: their arrays bond by bond take 8 GB and more")
    add_numba(forward, both, t, precision, fastmath=fastmath)
    tolerance = 1e-8 if precision == "float64" else 5e-2  # sums of a million in single precision
    seconds = interleaved(forward, rounds, tolerance)
    report("forward", seconds, count)
    share = traffic(bonds, nodes, count, size) / seconds["warp_peri"] / bandwidth
    print(f"    of copy bandwidth: {100 * share:.0f} %")
    if bonds.layout.in_rows:
        lists = share + 2 * 4 * count / seconds["warp_peri"] / bandwidth
        print(f"    with the lists of neighbours that others read: {100 * lists:.0f} %")
    backward = interleaved(both, rounds, tolerance)
    report("forward and backward to u, D, α", backward, count)
    return {"forward": seconds, "forward and backward": backward}


def add_numba(
    forward: Candidates, both: Candidates, t: rivals.Tables, precision: str, *, fastmath: bool
) -> None:
    """Numba's loops, compiled anew for every table; also with fastmath if asked."""
    try:
        import numba
    except ImportError:
        print("  Numba is not installed: pip install 'warp_peri[bench]'")
        return
    numba.set_num_threads(THREADS)
    kinds = (("Numba parallel", False), ("Numba parallel, fastmath", True))
    for name, fast in kinds[: 1 + fastmath]:
        dtype = getattr(np, precision)
        forward[name], both[name] = numba_rival.numba_parallel(t, dtype, fastmath=fast)
    if len(t.r) < len(t.neighbour):
        forward["Numba by rows"] = numba_rows.numba_rows(t, getattr(np, precision))


def memory(bonds: Bonds, size: int) -> int:
    """Bytes of all arrays of the operator, of one evaluation and of its gradient."""
    law, layout = bonds.law(*Solid(**MODEL).values()), bonds.layout
    planes = 2 * 3 * layout.places if layout.in_rows else 0  # u and θ, h and τ
    held = [*bonds.links, *bonds.tables, law.table.own, law.table.far, law.table.volumes]
    held += [value for value in vars(layout).values() if isinstance(value, wp.array)]
    total = sum({array.ptr: array.capacity for array in held}.values()) + size * planes
    count, classes, nodes = len(bonds.families.neighbour), len(bonds.families.r), bonds.nodes
    state = classes + nodes * (2 + 1 + 2)  # K W; u, θ, L u
    bars = len(bonds.families.pattern) or count / BLOCKS  # ∂/∂(K W), one block a thread
    gradient = THREADS * bars + nodes * (2 + 2 + 1 + 2)  # g, h, τ, ∂/∂u
    return total + round(size * (state + gradient))


def setting_up(side: int, forward: float) -> None:
    """Families and weights of a large lattice against one forward sweep with K inside."""
    points, _ = problem("lattice", side)
    seconds = []
    for _ in range(3):
        start = time.perf_counter()
        families = families_of(points, HORIZON)
        seconds.append(time.perf_counter() - start)
    bonds = len(families.neighbour)
    small = Bonds(*small_problem())
    part = 2_000_000  # K of so many bonds, each by itself
    r = np.resize(families.r[families.classes.bond_class], part)
    degree = len(MODEL["D"]) - 1
    known = comb(degree, np.arange(degree + 1)), r, np.log(r), np.ones(part)
    inputs = (small.scalar(HORIZON), *map(small.floats, known))
    alpha, D = small.floats(np.array([MODEL["alpha"]])), small.floats(MODEL["D"])
    kernel, out = influence(degree, small.scalar), small.zeros(part)
    times = []
    for _ in range(5):
        start = time.perf_counter()
        launch_slices(kernel, part, (*inputs, alpha, D), (out,))
        times.append(time.perf_counter() - start)
    inside = forward + float(np.median(times)) * bonds / part
    setup = float(np.median(seconds))
    print(f"\nfamilies and weights of {side}² lattice nodes: {setup:.2f} s, {setup / inside:.2f} ×")
    print("  one forward sweep that evaluates K once for every bond (5 × asked)")


def small_problem() -> tuple[Points, float]:
    """A small point set, for the kernels of its bonds."""
    points, _ = problem("lattice", 20)
    middle = np.abs(points.x - 9.5).max(axis=1) < 1
    return Points(points.x, middle, 1.0), HORIZON


def lammps(side: int, ours: float) -> None:
    """`peri/lps` of LAMMPS: three dimensions, with contact forces, one rank, forward only."""
    lines = f"""units si
        boundary p p p
        atom_style peri
        atom_modify map array
        neighbor 0.0001 bin
        lattice sc 0.0005
        region cell block 0 {side} 0 {side} 0 {side} units lattice
        create_box 1 cell
        create_atoms 1 box
        pair_style peri/lps
        pair_coeff * * 14.9e9 14.9e9 0.0015001 1e6 0.25
        set group all density 2200
        set group all volume 1.25e-10
        velocity all create 1e-6 1 dist uniform
        timestep 1e-9
        fix 1 all nve
        thermo 1000
        run 1 post no"""
    try:
        run = lammps_class()(cmdargs=["-log", "none", "-screen", "none", "-nocite"])
    except LammpsError as error:
        print(f"\nLAMMPS left out: {error}")
        return
    for line in lines.splitlines():
        run.command(line.strip())
    steps, seconds = 20, []
    for _ in range(3):
        start = time.perf_counter()
        run.command("run 0 post no")
        overhead = time.perf_counter() - start
        start = time.perf_counter()
        run.command(f"run {steps} post no")
        seconds.append((time.perf_counter() - start - overhead) / steps)
    r = np.linalg.norm(np.argwhere(np.ones((7, 7, 7))) - 3, axis=1)
    bonds = side**3 * (np.count_nonzero(r <= 3.0002) - 1)
    speed = bonds / np.median(seconds)
    run.close()
    print(f"\nLAMMPS peri/lps, {side}³ particles: {speed / 1e6:.1f} Mbond/s")
    print("  three dimensions, contact forces and time steps included, one rank;")
    print(f"  warp_peri forward, 200² lattice, float64: {ours / speed:.2f} × its bonds a second")


THREADS = 2


def operator(*, quick: bool, threads: int = 2) -> None:
    """The benchmark of the operator."""
    global THREADS
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    THREADS = min(threads, cores or 1)  # what a process is bound to, Numba insists on
    set_threads(THREADS)
    torch.set_num_threads(THREADS)
    bandwidth = copy_bandwidth(quick=quick)
    print(f"{THREADS} threads; copying moves {bandwidth / 1e9:.1f} GB/s on one thread")
    side, rounds = (QUICK, 1) if quick else (200, 15)
    speed = 0.0
    for kind in ("lattice", "scattered"):
        for precision in PRECISIONS[: 1 if quick else 2]:
            seconds = measure(kind, side, precision, rounds, bandwidth, fastmath=not quick)
            if kind == "lattice" and precision == "float64":
                speed = 48 * side**2 / seconds["forward"]["warp_peri"]
    if not quick:
        lammps(24, speed)
        forward = measure("lattice", 1000, "float64", 3, bandwidth)
        measure("lattice", 1000, "float32", 3, bandwidth)
        setting_up(1000, forward["forward"]["warp_peri"])


def ceilings(*, quick: bool) -> None:
    """The rooflines of the lattice, on one core."""
    set_threads(1)
    bandwidth = copy_bandwidth(quick=quick)
    for side in (QUICK,) if quick else (200, 1000):
        points, _ = problem("lattice", side)
        u = np.random.default_rng(1).normal(size=points.x.shape)
        for precision in PRECISIONS[: 1 if quick else 2]:
            bonds = Bonds(points, HORIZON, precision=precision)
            roofline.roofline(bonds, Solid(**MODEL), u, bandwidth)


def broken(*, quick: bool, threads: int = 2) -> None:
    """Bodies that break, the lattice's force and scattered points beside their rivals, as JSON."""
    global THREADS
    found = benchmark_damage.broken(quick=quick, threads=tuple(range(1, threads + 1)))
    THREADS = threads
    set_threads(THREADS)
    torch.set_num_threads(THREADS)
    (side, rounds), bandwidth = (QUICK, 1) if quick else (200, 15), copy_bandwidth(quick=quick)
    rivals_of = {"lattice": "Numba by rows", "scattered": "Numba parallel"}
    for kind, rival in rivals_of.items():
        for precision in PRECISIONS[: 1 if quick else 2]:
            with contextlib.redirect_stdout(sys.stderr):
                tables = measure(kind, side, precision, rounds, bandwidth, fastmath=False)
            for what, seconds in tables.items():
                best = {name: 1e3 * value for name, value in seconds.items() if "Numba" in name}
                row: dict[str, Any] = {
                    "kind": kind,
                    "precision": precision,
                    "threads": threads,
                    "what": what,
                }
                row |= {"ms": 1e3 * seconds["warp_peri"], "Numba ms": best}
                if rival in seconds:
                    row["ratio"] = seconds[rival] / seconds["warp_peri"]
                found.setdefault("forces", []).append(row)
    print(json.dumps(found, indent=1))


KINDS = (*("operator", "roofline", "solve", "crystals", "ranks", "choice"), *("gradient", "broken"))


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__)
    parser.add("what", choices=KINDS)
    parser.add(
        "--quick",
        action="store_true",
        help="all of it in seconds, on few nodes; its times say nothing",
    )
    parser.add("--threads", type=int, default=2, help="operator, broken: of every candidate")
    parser.add("--json", action="store_true", help="gradient, broken: print JSON")
    parser.add("--long", action="store_true", help="gradient: motions of 100 000 steps too")
    parser.add("--model", type=Path, help="of solve and choice (default: learned)")
    parser.add("--out", type=Path, help="solve, choice: write the table as JSON")
    given = parser.parse_args(arguments)
    files = {"model_file": given.model, "out": given.out}
    work: dict[str, Callable[..., Any]] = {
        "operator": partial(operator, threads=given.threads),
        "roofline": ceilings,
        "solve": partial(solve_study.solve_study, **files),
        "crystals": benchmark_crystals.crystals,
        "broken": partial(broken, threads=given.threads),
        "ranks": benchmark_ranks.ranks,
        "gradient": partial(benchmark_gradient.gradient, long=given.long, as_json=given.json),
        "choice": partial(solver_choice.solver_choice, **files),
    }
    work[given.what](quick=given.quick)
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
