"""The step of a body that breaks: Warp's sweep against Numba's parallel loop, the same forces.

Both sum the force and the energy of every node over its unbroken bonds, compare each stretch with
its limit and break. The two alternate in one run, and the one that goes first changes from round to
round. What counts is the processor time of the process, of all its threads: other work on the
machine hardly changes it. The clock is printed beside it; on more threads than one it says
something only where nothing else runs.
"""

import json
import os

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # Numba's threads that wait burn nothing
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import warp as wp

from tools.options import Options
from warp_peri import Model
from warp_peri.damage import lattice_body, rectangle
from warp_peri.damage.operator import CutOperator
from warp_peri.errors import exit_status
from warp_peri.launch import floats, set_threads, zeros

SIZES = ((50, 40, 3.0), (100, 100, 3.0), (400, 160, 3.0), (400, 160, 4.0), (1000, 400, 3.0))
"""Nodes along x and y, and horizon over spacing."""


def rival():
    """The same sweeps as Numba loops over nodes, bond-based and state-based."""
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

    @numba.njit(parallel=True)
    def dilatation(u, xi, a, neighbour, theta):
        for i in numba.prange(len(u)):
            total = 0.0
            for b in range(len(a)):
                j = neighbour[i, b]
                if j >= 0:
                    d = xi[b, 0] * (u[j, 0] - u[i, 0]) + xi[b, 1] * (u[j, 1] - u[i, 1])
                    total += a[b] * d
            theta[i] = total

    @numba.njit(parallel=True)
    def pull(u, xi, k, limit, no_fail, neighbour, force, energy, lost, a, excess, theta):
        for i in numba.prange(len(u)):
            fx = fy = e = 0.0
            count = 0
            for b in range(len(limit)):
                j = neighbour[i, b]
                if j >= 0:
                    d = xi[b, 0] * (u[j, 0] - u[i, 0]) + xi[b, 1] * (u[j, 1] - u[i, 1])
                    s = k[b] * d
                    e += 0.25 * s * d
                    t = s + excess * a[b] * (theta[i] + theta[j])
                    fx += t * xi[b, 0]
                    fy += t * xi[b, 1]
                    if d > limit[b] and no_fail[i] + no_fail[j] == 0:
                        neighbour[i, b] = -1 - j
                        count += 1
            force[i, 0], force[i, 1], lost[i] = fx, fy, count
            energy[i] = e + 0.5 * excess * theta[i] ** 2

    def state_based(u, xi, k, limit, no_fail, neighbour, force, energy, lost, a, excess, theta):
        dilatation(u, xi, a, neighbour, theta)
        pull(u, xi, k, limit, no_fail, neighbour, force, energy, lost, a, excess, theta)

    return sweep, state_based


def compare(
    sides: tuple[int, int], ratio: float, rivals, repeats: int, lam: float = 1.0, scale=3e-3
) -> dict[str, object]:
    """Milliseconds of both, and the ratio Numba over Warp with its 10 and 90 % points; μ = 1."""
    body = lattice_body(rectangle(float(sides[0]), float(sides[1]), 1.0), 1.0, ratio)
    model = Model(lam=lam, mu=1.0, alpha=1.0, D=np.ones(1), horizon=ratio)
    limits = 0.02 * body.r**2
    operator = CutOperator(model, body, limits=limits)
    count, stiffness = len(body.x), operator.bonded[0]
    u = np.zeros((operator.places, 2))
    u[:count] = scale * np.random.default_rng(0).standard_normal((count, 2))
    field, links = floats(u.copy(), wp.vec2d), operator.links(body.neighbour)
    force, energy = zeros(operator.places, dtype=wp.vec2d), zeros(operator.places)
    theirs = (np.zeros((count, 2)), np.zeros(count), np.zeros(count, np.int32))
    table, no_fail = body.neighbour.copy(), np.zeros(count, np.uint8)
    inputs = (u[:count].copy(), body.xi, 2 * stiffness, limits, no_fail, table)
    sweep = rivals[lam != 1]
    more: tuple = ()
    if lam != 1:
        more = (operator.bonded[1], lam - 1, np.zeros(count))
    jobs = (
        lambda: operator.sweep(field, links, force, energy, breaking=True),
        lambda: sweep(*inputs, *theirs, *more),
    )
    processor, wall = alternating(jobs, repeats)
    same = np.array_equal(force.numpy()[:count], theirs[0])
    same &= np.array_equal(links.numpy()[: count * len(stiffness)], table.ravel())
    ratios = processor[1] / processor[0]
    return {
        "lambda": lam,
        "nodes": count,
        "bonds": len(stiffness),
        "warp_ms": float(np.median(processor[0])),
        "numba_ms": float(np.median(processor[1])),
        "ratio": float(np.median(ratios)),
        "ratios": [float(part) for part in np.quantile(ratios, (0.1, 0.9))],
        "ratio_by_the_clock": float(np.median(wall[1] / wall[0])),
        "same_bits": bool(same),
    }


def alternating(jobs, repeats: int) -> np.ndarray:
    """Milliseconds of jobs that take turns, by processor and by clock, shape [2, J, R].

    A turn is as many calls as last 20 ms.
    """
    for job in jobs:  # compiles, and breaks what is beyond its limit
        job()
    began = time.perf_counter()
    jobs[0]()
    calls = max(1, int(0.02 / (time.perf_counter() - began)))
    times = np.empty((2, len(jobs), repeats))
    for turn in range(repeats):
        for place in (0, 1) if turn % 2 else (1, 0):
            before = np.array([time.process_time(), time.perf_counter()])
            for _ in range(calls):
                jobs[place]()
            after = np.array([time.process_time(), time.perf_counter()])
            times[:, place, turn] = 1e3 * (after - before) / calls
    return times


def main(argv: list[str] | None = None) -> int:
    parser = Options(__doc__, json=True)
    parser.add("--threads", type=int, nargs="+", default=[1, 2])
    parser.add("--repeats", type=int, default=15)
    parser.add("--scale", type=float, default=3e-3, help="of the displacements")
    parser.add("--sizes", type=int, default=len(SIZES), help="how many of them")
    args = parser.parse_args(argv)
    import numba

    rivals, table = rival(), []
    for threads in args.threads:
        set_threads(threads)
        numba.set_num_threads(min(threads, os.cpu_count() or 1))
        for lam in (1.0, 2.0):
            for width, height, ratio in SIZES[: args.sizes]:
                row = compare((width, height), ratio, rivals, args.repeats, lam, args.scale)
                table.append({"threads": threads} | row)
                if not args.json:
                    print(table[-1], flush=True)
    if args.json:
        print(json.dumps({"sweeps": table}))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
