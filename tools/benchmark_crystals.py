"""What a crystal model costs in space: a force, a solve, a proof."""

import functools
import itertools
import json
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tools.crystals import force_constants
from warp_peri import Points
from warp_peri.core.proof import prove
from warp_peri.core.stencil import half_ball
from warp_peri.launch import set_threads
from warp_peri.materials.crystal import TensorOperator
from warp_peri.micromodulus import Crystal, from_phonons, transferred
from warp_peri.statics.solution import TOLERANCE

SIDES = (64, 128)
"""Grid along an edge of the cubes that are solved for."""
TURN = np.deg2rad(20.0)
PROGRAM = """import sys, json
sys.path[:0] = {path!r}
from tools.benchmark_crystals import Crystal, solved
print(json.dumps(solved(Crystal.of_content(json.load(sys.stdin)), {side})))"""
WITHOUT = np.array([np.eye(3), -np.eye(3)], dtype=int)


def cube(law: Crystal, side: int, d: int = 3) -> Points:
    """A cube, or square, of unknown nodes and the collar that their bonds reach."""
    reach = int(np.abs(law.steps).max())
    line = np.arange(-reach, side + reach)
    grid = np.stack(np.meshgrid(*d * [line], indexing="ij"), axis=-1).reshape(-1, d)
    inside = ((grid >= 0) & (grid < side)).all(axis=1)
    return Points(law.spacing * grid, np.asarray(inside), law.spacing)


def least(
    function: Callable[[], Any], rounds: int, clock: Callable[[], float] = time.perf_counter
) -> float:
    """Seconds of the quickest of several calls, after one that is not counted."""
    function()
    seconds = []
    for _ in range(rounds):
        start = clock()
        function()
        seconds.append(clock() - start)
    return min(seconds)


def numba_loop(operator: TensorOperator) -> Callable[[np.ndarray], np.ndarray] | None:
    """A plain loop of Numba over nodes and all their bonds, on one thread; None without Numba.

    Takes the planes of rows [1, 3, *shape] and gives theirs.
    """
    try:
        import numba
    except ImportError:
        print("Numba is not installed: pip install 'warp_peri[bench]'")
        return None
    shape = operator.nodes.shape
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    offset = np.concatenate([operator.steps, -operator.steps]) @ strides
    inputs = operator.nodes.interior, offset, np.tile(operator.tensors, (2, 1, 1))

    def pulled(
        unknown: np.ndarray, offset: np.ndarray, C: np.ndarray, u: np.ndarray, force: np.ndarray
    ) -> None:
        for i in unknown:
            f0 = f1 = f2 = 0.0
            for n in range(len(offset)):
                j = i + offset[n]
                e0, e1, e2 = u[i, 0] - u[j, 0], u[i, 1] - u[j, 1], u[i, 2] - u[j, 2]
                f0 += C[n, 0, 0] * e0 + C[n, 0, 1] * e1 + C[n, 0, 2] * e2
                f1 += C[n, 0, 1] * e0 + C[n, 1, 1] * e1 + C[n, 1, 2] * e2
                f2 += C[n, 0, 2] * e0 + C[n, 1, 2] * e1 + C[n, 2, 2] * e2
            force[i, 0], force[i, 1], force[i, 2] = f0, f1, f2

    compiled: Any = numba.njit(fastmath=True)(pulled)

    def product(planes: np.ndarray) -> np.ndarray:
        u = np.ascontiguousarray(planes[0].reshape(3, -1).T)
        force = np.zeros_like(u)
        compiled(*inputs, u, force)
        return force.T.reshape(planes.shape)

    return product


def forces(law: Crystal, *, side: int, rounds: int) -> dict[str, float]:
    """Seconds of a force on a cube, on one thread and on two; CSR's scaled from half the side."""
    points = cube(law, side)
    u = np.random.default_rng(0).normal(size=points.x.shape)
    found = {}
    for threads, method in itertools.product((1, 2), ("rows", "fft")):
        set_threads(threads)
        operator = law.on(points, method=method)
        planes = operator.nodes.scatter(u[None])
        key = f"{method}, {threads} thread{'s'[: threads - 1]}"
        found[key] = least(functools.partial(operator.pull, planes), rounds)
        if method == "rows" and threads == 1 and (loop := numba_loop(operator)) is not None:
            off = np.abs(loop(planes) - operator.pull(planes)).max()
            assert off < 1e-12 * np.abs(operator.pull(planes)).max()
            found["plain Numba, 1 thread"] = least(functools.partial(loop, planes), rounds)
    small = cube(law, side // 2)
    matrix = law.on(small).matrix()
    v = np.random.default_rng(0).normal(size=small.x.size)
    found["SciPy CSR, 8 × that of half the side"] = 8 * least(lambda: matrix @ v, rounds)
    found["GB of CSR"] = 8 * (matrix.data.nbytes + matrix.indices.nbytes) / 1e9
    return found


def crossing(*, quick: bool) -> dict[str, list[tuple[int, float]]]:
    """Time of a force by FFT over that by rows, by processor in turns, one thread: by bonds."""
    found: dict[str, list[tuple[int, float]]] = {}
    set_threads(1)
    cases: list[tuple[int, int, list[float]]]
    rounds, cases = 5, [(2, 256, [3, 6, 8, 10, 14]), (3, 48, [2, 6**0.5, 3, 4, 5])]
    if quick:
        rounds, cases = 1, [(2, 32, [3]), (3, 12, [2])]
    for d, side, reaches in cases:
        found[f"{d} dimensions"] = rows = []
        for reach in reaches:
            steps = half_ball(reach, d)
            law = Crystal(1.0, steps, np.eye(d) / (steps**2).sum(axis=1)[:, None, None] ** 2)
            points = cube(law, side, d)
            ways = [law.on(points, method=method) for method in ("fft", "rows")]
            planes = ways[0].nodes.scatter(
                np.random.default_rng(0).normal(size=(1, *points.x.shape))
            )
            seconds: list[list[float]] = [[], []]
            for _ in range(rounds):
                for own, way in zip(seconds, ways):
                    start = time.process_time()
                    way.pull(planes)
                    own.append(time.process_time() - start)
            rows.append((law.bonds, min(seconds[0]) / min(seconds[1])))
            print(f"{d} dimensions, {law.bonds} bonds: FFT over rows {rows[-1][1]:.2f}", flush=True)
    return found


def solved(law: Crystal, side: int) -> dict[str, Any]:
    """A cube under smooth and rough loads with its collar held; run in a process of its own."""
    points = cube(law, side)
    rng = np.random.default_rng(1)
    operator = law.on(points)
    b = 1e-3 * rng.normal(size=points.x.shape)
    u = 0.01 * np.sin(2 * np.pi * points.x / (side * law.spacing))
    start = time.perf_counter()
    _, (record,) = operator.linear.solve(b[None], u[None], TOLERANCE)
    seconds = time.perf_counter() - start
    status = Path("/proc/self/status").read_text(encoding="ascii")
    peak = re.search(r"VmHWM:\s+(\d+) kB", status)  # of this program alone, whoever started it
    assert peak is not None
    return {"seconds": seconds, "GB": int(peak[1]) / 1e6, **vars(record)}


def crystals(*, quick: bool) -> dict[str, Any]:
    """Print and return all of it."""
    atoms = force_constants("Cu")
    a = float(atoms.cell[0, 0])
    laws = {
        n: from_phonons(atoms, a, a * r, symmetry="m-3m") for n, r in ((80, 6**0.5), (122, 3.0))
    }
    law = laws[122]
    side = 12 if quick else 64
    found: dict[str, Any] = {"force": forces(law, side=side, rounds=1 if quick else 3)}
    for name, value in found["force"].items():
        print(f"force, {side}³ nodes, 122 bonds, {name}: {value:.3f}", flush=True)
    found["FFT over rows"] = crossing(quick=quick)
    content = json.dumps(law.content())
    for side in (12,) if quick else SIDES:
        program = PROGRAM.format(path=sys.path, side=side)
        run = subprocess.run(
            [sys.executable, "-c", program],
            input=content,
            capture_output=True,
            text=True,
            check=True,
        )
        found[f"solve {side}"] = record = json.loads(run.stdout.splitlines()[-1])
        told = "{seconds:.1f} s, {iterations} iterations by {method}, {GB:.2f} GB"
        print(f"solve, {side}³ nodes: " + told.format(**record), flush=True)
    turn = np.array([[np.cos(TURN), -np.sin(TURN), 0], [np.sin(TURN), np.cos(TURN), 0], [0, 0, 1]])
    turned = transferred(laws[80], a, rotation=turn)
    cases = [
        (f"{n} bonds, {who}", laws[n], group)
        for n in laws
        for who, group in (("symmetry used", laws[n].group), ("full zone", WITHOUT))
    ]
    cases = (
        cases[:1] if quick else [*cases, ("80 bonds, turned by 20°, full zone", turned, WITHOUT)]
    )
    for name, one_law, group in cases:
        proof = prove(one_law.stencil, group)
        found[f"proof, {name}"] = proof.content()
        print(
            f"proof, {name}: {proof.proven / proof.sampled:.2f} of the sampled minimum, "
            f"{proof.seconds:.1f} s, {proof.cells} cells",
            flush=True,
        )
    return found
