"""The step of a body that breaks: Warp's sweep against Numba's parallel loop, the same forces.

Both sum the force and the energy of every node over its unbroken bonds, compare each stretch with
its limit and break; the two alternate in one run.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np
import warp as wp

from warp_peri import Model, set_threads
from warp_peri.launch import floats, zeros
from warp_peri.operator.damage import CutOperator
from warp_peri.points.body import lattice_body, rectangle

SIZES = ((50, 40, 3.0), (100, 100, 3.0), (400, 160, 3.0), (400, 160, 4.0), (1000, 400, 3.0))
"""Nodes along x and y, and horizon over spacing."""


def rival():
    """The same sweep as a Numba loop over nodes, compiled for this machine."""
    import numba

    @numba.njit(parallel=True)
    def sweep(u, xi, stiffness, limit, no_fail, neighbour, force, energy, lost):
        for i in numba.prange(len(u)):
            fx = fy = e = 0.0
            count = 0
            for b in range(len(limit)):
                j = neighbour[i, b]
                if j >= 0:
                    d = xi[b, 0] * (u[j, 0] - u[i, 0]) + xi[b, 1] * (u[j, 1] - u[i, 1])
                    s = stiffness[b] * d
                    fx += s * xi[b, 0]
                    fy += s * xi[b, 1]
                    e += s * d
                    if d > limit[b] and no_fail[i] + no_fail[j] == 0:
                        neighbour[i, b] = -1 - j
                        count += 1
            force[i, 0], force[i, 1], energy[i], lost[i] = fx, fy, 0.25 * e, count

    return sweep


def compare(sides: tuple[int, int], ratio: float, sweep, repeats: int) -> dict[str, float]:
    """Milliseconds of both, medians and best, and the ratio Numba over Warp."""
    body = lattice_body(rectangle(float(sides[0]), float(sides[1]), 1.0), 1.0, ratio)
    model = Model(lam=1.0, mu=1.0, alpha=1.0, D=np.ones(1), horizon=ratio)
    limits = 0.02 * body.r**2
    operator = CutOperator(model, body, limits=limits)
    count, w = len(body.x), operator.weights
    u = np.zeros((operator.places, 2))
    u[:count] = 3e-3 * np.random.default_rng(0).standard_normal((count, 2))
    field, links = floats(u.copy(), wp.vec2d), operator.links(body.neighbour)
    force, energy = zeros(operator.places, dtype=wp.vec2d), zeros(operator.places)
    theirs = (np.zeros((count, 2)), np.zeros(count), np.zeros(count, np.int32))
    table, no_fail = body.neighbour.copy(), np.zeros(count, np.uint8)
    inputs = (u[:count].copy(), body.xi, 16 * w / body.r**2, limits, no_fail, table)
    times: list[list[float]] = [[], []]
    for repeat in range(repeats + 1):
        for place, job in enumerate(
            (
                lambda: operator.sweep(field, links, force, energy, breaking=True),
                lambda: sweep(*inputs, *theirs),
            )
        ):
            began = time.perf_counter()
            job()
            if repeat:  # the first compiles, and breaks what is beyond its limit
                times[place].append(1e3 * (time.perf_counter() - began))
    same = np.array_equal(force.numpy()[:count], theirs[0])
    same &= np.array_equal(links.numpy()[: count * len(w)], table.ravel())
    warp_ms, numba_ms = (float(np.median(part)) for part in times)
    best = min(times[1]) / min(times[0])
    return {
        "nodes": count,
        "bonds": len(w),
        "warp_ms": warp_ms,
        "numba_ms": numba_ms,
        "ratio": numba_ms / warp_ms,
        "ratio_of_best": best,
        "same_bits": bool(same),
    }


def main(argv: list[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--sizes", type=int, default=len(SIZES), help="how many of them")
    parser.add_argument("--json", action="store_true", help="print the numbers as one object")
    args = parser.parse_args(argv)
    import numba

    sweep, table = rival(), []
    for threads in args.threads:
        set_threads(threads)
        numba.set_num_threads(min(threads, os.cpu_count() or 1))
        for width, height, ratio in SIZES[: args.sizes]:
            row = {"threads": threads} | compare((width, height), ratio, sweep, args.repeats)
            table.append(row)
            if not args.json:
                print(row, flush=True)
    if args.json:
        print(json.dumps({"sweeps": table}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
