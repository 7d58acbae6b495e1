"""What a law of micromodulus tensors costs in space: a force, a solve, a proof."""

from __future__ import annotations

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
from warp_peri.launch import set_threads
from warp_peri.micromodulus.certificate import certify
from warp_peri.micromodulus.law import Crystal
from warp_peri.micromodulus.learning import from_phonons, transferred
from warp_peri.micromodulus.statics import solve
from warp_peri.points.points import Points

SIDES = (64, 128)
"""Nodes along an edge of the cubes that are solved for."""
TURN = np.deg2rad(20.0)
PROGRAM = """import sys, json
sys.path[:0] = {path!r}
from tools.benchmark_crystals import Crystal, solved
print(json.dumps(solved(Crystal.of_content(json.load(sys.stdin)), {side})))"""
WITHOUT = np.array([np.eye(3), -np.eye(3)], dtype=int)


def cube(law: Crystal, side: int) -> Points:
    """A cube of unknown nodes and the collar that their bonds reach."""
    reach = int(np.abs(law.steps).max())
    line = np.arange(-reach, side + reach)
    grid = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = ((grid >= 0) & (grid < side)).all(axis=1)
    return Points(law.spacing * grid, np.asarray(inside), law.spacing)


def least(function: Callable[[], Any], rounds: int) -> float:
    """Seconds of the quickest of several calls, after one that is not counted."""
    function()
    seconds = []
    for _ in range(rounds):
        start = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def forces(law: Crystal, *, side: int, rounds: int) -> dict[str, float]:
    """Seconds of a force on a cube, on one thread and on two; CSR's scaled from half the side."""
    points = cube(law, side)
    u = np.random.default_rng(0).normal(size=points.x.shape)
    found = {}
    for threads, method in itertools.product((1, 2), ("rows", "fft")):
        set_threads(threads)
        operator = law.on(points, method=method)
        planes = operator.nodes.lay_out(u[None])
        key = f"{method}, {threads} thread{'s'[: threads - 1]}"
        found[key] = least(functools.partial(operator.pull, planes), rounds)
    small = cube(law, side // 2)
    matrix = law.on(small).matrix()
    v = np.random.default_rng(0).normal(size=small.x.size)
    found["SciPy CSR, 8 × that of half the side"] = 8 * least(lambda: matrix @ v, rounds)
    found["GB of CSR"] = 8 * (matrix.data.nbytes + matrix.indices.nbytes) / 1e9
    return found


def solved(law: Crystal, side: int) -> dict[str, Any]:
    """A cube under smooth and rough loads with its collar held; run in a process of its own."""
    points = cube(law, side)
    rng = np.random.default_rng(1)
    operator = law.on(points)
    b = 1e-3 * rng.normal(size=points.x.shape)
    u = 0.01 * np.sin(2 * np.pi * points.x / (side * law.spacing))
    start = time.perf_counter()
    _, record = solve(operator, b, u)
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
    found: dict[str, Any] = {"force": forces(law, side=32 if quick else 64, rounds=3)}
    for name, value in found["force"].items():
        print(f"force, {32 if quick else 64}³ nodes, 122 bonds, {name}: {value:.3f}", flush=True)
    content = json.dumps(law.content())
    for side in (32,) if quick else SIDES:
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
    cases.append(("80 bonds, turned by 20°, full zone", turned, WITHOUT))
    for name, one_law, group in cases:
        proof = certify(one_law.steps, one_law.tensors * one_law.spacing**2, group)
        found[f"proof, {name}"] = proof.content()
        print(
            f"proof, {name}: {proof.proven / proof.sampled:.2f} of the sampled minimum, "
            f"{proof.seconds:.1f} s, {proof.cells} cells",
            flush=True,
        )
    return found
