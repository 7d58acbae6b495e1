"""What `solve` takes without a named solver, beside every solver by name: 80 to 40 000 nodes.

Run by `python tools/benchmark.py choice`. Rectangles, disks and L-shapes, one load and many, the
linear and the nonlinear solid. Set-up and solve count together: the processor's time on one thread,
least of several calls after an untimed one.
"""

import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from tools.solve_study import TABLE, mask_of, problem
from warp_peri import Direct, Dirichlet, Krylov, Points, load, solve
from warp_peri.core.elastic import from_voigt, plane_isotropic
from warp_peri.files.atomic import write_json
from warp_peri.launch import set_threads
from warp_peri.materials.crystal_fit import fit_symbol
from warp_peri.materials.third_order import Smoothing, ThirdOrderCrystal
from warp_peri.statics import linear
from warp_peri.statics.direct import RESIDUAL
from warp_peri.statics.linear import DIRECT
from warp_peri.statics.solution import TOLERANCE

SIDES = (10, 16, 24, 34, 48, 61, 100, 200)
SHAPES = {"rectangle": "square", "disk": "disk", "L": "L"}
MOST_LU = 61
"""Side from which a factorisation is too slow to be waited for."""
LOADS = (1, 2, 4, 8, 32)
"""At once; up to FEW beyond 34² nodes."""
FEW = 4
CONSTANTS = (-0.36, -5.6, 0.84)
"""t3, tq2 and q3 [TPa] as an energy form finds them in graphene."""


def fields(points: Points, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Smooth loads, and a collar strained by 1 to 2 %."""
    waves = np.random.default_rng(0).uniform(-0.06, 0.06, (count, 2, 2))
    phase = np.einsum("nd,sed->sne", points.x, waves)
    return 1e-4 * np.cos(phase), 0.2 * np.sin(phase)


def least(run: Callable[[], Any], rounds: int) -> float:
    """Seconds of the processor in the fastest of some calls; only one where it takes seconds."""
    best = np.inf
    for number in range(1 + rounds):
        start = time.process_time()
        run()
        seconds = time.process_time() - start
        best = min(best, seconds if number else np.inf)
        if seconds > 1:
            return seconds
    return best


def linear_rows(model: Any, rounds: int, quick: bool) -> Iterator[dict[str, Any]]:
    """Seconds of every way, for one load and for many."""
    for shape, kind in SHAPES.items():
        for side in SIDES[:2] if quick else SIDES:
            points = problem(mask_of(kind, side), model.horizon, model.certified_on[0])
            iterative = "sine" if shape == "rectangle" else "multigrid"
            few = np.count_nonzero(points.interior) <= DIRECT
            to = RESIDUAL / 10 if few else TOLERANCE  # as close as what is chosen is carried
            ways: dict[str | None, Any] = {None: None, iterative: Krylov(iterative, tolerance=to)}
            if side <= MOST_LU:
                ways["lu"] = Direct()
            for count in LOADS[:2] if quick else LOADS if side <= 34 else (1, FEW):
                given = Dirichlet(points, *fields(points, count))
                solved = solve(model, given)
                seconds = {
                    name or solved.method + ", chosen": least(
                        partial(solve, model, given, solver=way), rounds
                    )
                    for name, way in ways.items()
                }
                yield row("linear", shape, points, count, seconds)


@contextmanager
def only(method: str | None) -> Iterator[None]:
    """Linear solves inside a nonlinear one by one method."""
    chosen = vars(linear)["cheapest_method"]
    if method:
        vars(linear)["cheapest_method"] = lambda *nodes, **options: method
    try:
        yield
    finally:
        vars(linear)["cheapest_method"] = chosen


def nonlinear_rows(model: Any, rounds: int, quick: bool) -> Iterator[dict[str, Any]]:
    """The same for a third-order crystal of 28 bonds with the moduli of the model."""
    h = model.certified_on[0]
    tensor = from_voigt(plane_isotropic(model.lam, model.mu))

    def local(k: np.ndarray) -> np.ndarray:
        return np.asarray(np.einsum("ijkl,nj,nl->nik", tensor, k, k))

    bonds = fit_symbol(local, h, 3 * h, symmetry="isotropic", tensor=tensor)
    smoothing = Smoothing(2 * h, 0.2)
    solid = ThirdOrderCrystal(bonds, *CONSTANTS, smoothing, form="energy", reach=3 * h)
    for shape, kind in SHAPES.items():
        for side in (16,) if quick else (16, 24, 34, 61, 100):
            points = problem(mask_of(kind, side), model.horizon, model.certified_on[0])
            given = Dirichlet(points, *fields(points, 1))
            iterative = "sine" if shape == "rectangle" else "multigrid"
            seconds = {}
            for name in (None, iterative, "fft", *(["lu"] if side <= MOST_LU else [])):
                with only(name), warnings.catch_warnings(action="ignore"):
                    seconds[name or "chosen"] = least(partial(solve, solid, given), rounds)
            yield row("nonlinear", shape, points, 1, seconds)


def row(
    law: str, shape: str, points: Points, loads: int, seconds: dict[str, float]
) -> dict[str, Any]:
    """One line, printed as it comes; the first of the seconds is what was chosen, and again its
    own by name: the faster of the two counts."""
    first, chosen = next(iter(seconds.items()))
    over = min(chosen, seconds.get(first.split(",")[0], chosen)) / min(seconds.values())
    nodes = int(np.count_nonzero(points.interior))
    times = "  ".join(f"{name} {1e3 * value:.0f}" for name, value in seconds.items())
    print(f"{law:9s} {shape:9s} {nodes:6d} nodes {loads:3d} loads  {over:.2f}  {times}", flush=True)
    return {"law": law, "shape": shape, "nodes": nodes, "loads": loads, "over": over} | seconds


def solver_choice(*, quick: bool, model_file: Path | None, out: Path | None) -> None:
    """Print milliseconds of every way, and what was chosen over the best."""
    set_threads(1)
    torch.set_num_threads(1)
    solid, rounds = load(model_file or TABLE), 1 if quick else 3
    rows = [*linear_rows(solid, rounds, quick), *nonlinear_rows(solid, rounds, quick)]
    print(f"chosen over best: {max(row['over'] for row in rows):.2f} at most")
    if out:
        write_json(out, {"rows": rows})
