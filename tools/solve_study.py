"""Dirichlet solves from 64² to 2000² nodes: time, iterations, memory, and the exponent of cost.

Run by `python tools/benchmark.py solve`. The model is the learned one that the repository ships,
or another file. Right-hand sides: a smooth load, a point load and noise, zero collar, the worst
counts.
"""

import resource
import time
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch

from tools import numba_rival, rivals
from warp_peri import InputError, Krylov, Model, Points, load
from warp_peri.core.grid import Grid
from warp_peri.files.atomic import write_json
from warp_peri.launch import set_threads
from warp_peri.materials.lps import lps_stencil
from warp_peri.materials.lps_bonds import Bonds
from warp_peri.materials.lps_force import lps_force
from warp_peri.materials.lps_operator import LPSOperator
from warp_peri.methods import Solid
from warp_peri.statics.linear import STIFF, Linear

SIDES = (64, 128, 250, 500, 1000, 2000)
QUICK = (24, 32)
TOLERANCE = 1e-8
TABLE = Path(__file__).resolve().parent / "solve_model.json"
"""The learned graphene model, δ = 20 Å at h = 5 Å."""


@dataclass(frozen=True)
class Row:
    """One solve; times in seconds, memory in MB."""

    shape: str
    side: int
    unknowns: int
    method: str
    material: str
    layout: float
    setup: float
    solve: float
    iterations: int
    residual: float
    peak_memory: float


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


def problem(mask: np.ndarray, horizon: float, spacing: float) -> Points:
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


def measure(model: Model, shape: str, side: int, method: str, material: str) -> Row:
    """The worst of three loads."""
    spacing = model.certified_on[0]
    points = problem(mask_of(shape, side), model.horizon, spacing)
    start = time.perf_counter()
    linear = LPSOperator(model, points).linear
    layout = time.perf_counter() - start
    start = time.perf_counter()
    linear.check_definite()
    linear.filter(method)
    setup = time.perf_counter() - start
    solves = []
    for force in loads(linear.grid).values():
        start = time.perf_counter()
        _, record = linear.inverse(force, TOLERANCE, method)
        solves.append((time.perf_counter() - start, record))
    return Row(
        shape,
        side,
        2 * len(linear.grid.interior),
        method,
        material,
        layout,
        setup,
        max(seconds for seconds, _ in solves),
        max(record.iterations for _, record in solves),
        max(record.residual for _, record in solves),
        resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    )


def exponent(rows: list[Row]) -> float | None:
    """Fitted power of the unknowns that the time of a solve grows with, from 250² on.

    None of fewer than two sizes.
    """
    large = [row for row in rows if row.side >= 250]
    if len(large) < 2:
        return None
    x, y = (np.log([getattr(row, key) for row in large]) for key in ("unknowns", "solve"))
    return float(np.polyfit(x, y, 1)[0])


def application(model: Model, side: int, rounds: int) -> dict[str, float]:
    """Least seconds of one product on a periodic lattice: stencil by FFT, sweeps, also Numba's."""
    x = np.argwhere(np.ones((side, side))).astype(float)
    points = Points(x, np.ones(side**2, bool), 1.0, box=(float(side), float(side)))
    horizon = model.horizon / model.certified_on[0]
    box = (float(side), float(side))
    bonds = Bonds(points, horizon)
    u = np.random.default_rng(1).normal(size=(side**2, 2))
    law: dict[str, Any] = {"alpha": model.alpha, "D": model.D, "lam": model.lam, "mu": model.mu}
    tables = rivals.tables(bonds, points.x, np.array(box), u, u, **law)
    scaled = replace(model, horizon=horizon, certified_on=(1.0,))
    whole = Linear(lps_stencil(scaled, 1.0), points, by="fft")
    solid = Solid(model.lam, model.mu, model.alpha, model.D)
    candidates = {
        "stencil by FFT": lambda: whole(u[None])[0],
        "warp_peri, two sweeps": lambda: lps_force(bonds, torch.from_numpy(u), solid).numpy(),
    }
    if find_spec("numba") is not None:
        import numba

        numba.set_num_threads(2)
        forward, _ = numba_rival.numba_parallel(tables, np.float64, fastmath=False)
        candidates["Numba, two sweeps"] = forward
    times: dict[str, list[float]] = {name: [] for name in candidates}
    expected = candidates["warp_peri, two sweeps"]().copy()
    for _ in range(rounds):
        for name, function in candidates.items():
            start = time.perf_counter()
            answer = function()
            times[name].append(time.perf_counter() - start)
            if not np.abs(answer - expected).max() <= 1e-9 * np.abs(expected).max():
                raise RuntimeError(f"{name} is wrong")
    return {name: min(values) for name, values in times.items()}


def adjoint_ratio(model: Model, side: int) -> float:
    """Time of the gradient of a solve to load, λ, μ, α and D over that of the solve."""
    points = problem(mask_of("square", side), model.horizon, model.certified_on[0])
    operator = model.on(points)
    noise = torch.from_numpy(np.random.default_rng(0).normal(size=(1, len(points.x), 2)))
    inside = torch.from_numpy(points.interior)[:, None]
    law = Solid(
        *(
            torch.tensor(value, dtype=torch.float64).reshape(-1).requires_grad_()
            for value in model.learnable.values()
        )
    )
    b = (noise * inside).requires_grad_()
    ratios = []
    for _ in range(3):
        start = time.perf_counter()
        u = operator.rest(b, noise * ~inside, Krylov("sine"), parameters=law).u
        middle = time.perf_counter()
        torch.autograd.grad((u * u).sum(), [b, *law.values()], allow_unused=True)
        ratios.append((time.perf_counter() - middle) / (middle - start))
    return float(np.median(ratios))


def solve_study(*, quick: bool, model_file: Path | None = None, out: Path | None = None) -> None:
    """Measure, print, and with `out` write the table as JSON."""
    set_threads(2)
    torch.set_num_threads(2)
    model = load(model_file or TABLE)
    sides = QUICK if quick else SIDES
    cases = [
        (model, shape, side, "sine" if shape == "square" else "multigrid", "learned")
        for side in sides
        for shape in ("square", "disk", "L with a hole")
    ]
    side = sides[1]
    for material, ratio in (("λ = 3μ", 3.0), ("λ = 1000μ", 1000.0)):
        stiff = replace(model, lam=ratio * model.mu)
        for shape, usual in (("square", "sine"), ("disk", "multigrid")):
            cases.append((stiff, shape, side, "strip" if ratio > STIFF else usual, material))
    rows = []
    print(
        "shape          side  method     material    layout  set-up   solve  iterations  residual"
        "  MB"
    )
    for case in cases:
        try:
            row = measure(*case)
        except InputError as error:
            print(f"{case[1]:14} {case[2]:4}  {case[3]:9}  {case[4]:10}  {error}")
            continue
        rows.append(row)
        print(
            f"{row.shape:14} {row.side:4}  {row.method:9}  {row.material:10} {row.layout:7.2f} "
            f"{row.setup:7.2f} {row.solve:7.2f} {row.iterations:11} {row.residual:9.1e} "
            f"{row.peak_memory:6.0f}",
            flush=True,
        )
    powers = {}
    for shape in ("square", "disk", "L with a hole"):
        power = exponent([r for r in rows if r.shape == shape and r.material == "learned"])
        if power is not None:
            powers[shape] = power
            print(f"time of a solve grows with unknowns to the power {power:.2f} ({shape})")
    gradient = adjoint_ratio(model, sides[-1] if quick else 500)
    print(f"implicit gradient: {gradient:.2f} × the solve")
    product = application(model, 32 if quick else 1000, 1 if quick else 7)
    for name, seconds in product.items():
        print(f"{name:24}{1e3 * seconds:9.1f} ms   {seconds / product['stencil by FFT']:6.2f} ×")
    if out is not None:
        table = {"rows": [asdict(row) for row in rows], "exponents": powers}
        write_json(out, table | {"gradient_over_solve": gradient, "application": product})
