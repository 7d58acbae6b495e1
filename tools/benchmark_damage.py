"""Bodies that break, by rows of the lattice, beside Numba's best loop on lists and LAMMPS.

`python tools/benchmark.py broken --json` prints it. Both sum the force and the energy of every node
over its unbroken bonds, compare each stretch with its limit and break. Numba's loop takes two nodes
at a time and contracts products and sums, which makes it a fifth faster than the plain one; gathers
of sixteen nodes, no branches, and lists by bond are slower. The two alternate in one run, and the
one that goes first changes from round to round. What counts is the processor time of all threads:
other work on the machine hardly changes it. The clock is printed too; on two threads it says
something only where nothing else runs.
"""

import time
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np

from tools.peri_lps import PeriLps
from warp_peri import InputError, Krylov, Model, Points, solve
from warp_peri.atoms.calculators import LammpsError
from warp_peri.damage import Cracked, box, lattice_body, penny
from warp_peri.fracture.bonds import CutOperator
from warp_peri.fracture.dynamics import BreakingBody, BrittleSolid, step
from warp_peri.launch import floats, set_threads, zeros

SIZES = ((400, 160, 3.0), (400, 160, 4.0), (1000, 400, 3.0))
"""Nodes along x and y, and horizon over spacing."""
SHARES = (0.0, 0.01, 0.05, 0.1, 0.2, 0.5, 0.8, 0.95)
"""Of bonds that are broken, at random."""
PAGE = 77e6
"""Bonds a second, counted from both ends, of LAMMPS's `bpm/peri` on its own page: one core, LPS."""


def rival() -> tuple[Any, Any]:
    """The same sweeps as Numba loops over pairs of nodes, bond-based and state-based."""
    import numba

    jit = numba.njit(parallel=True, fastmath=True, error_model="numpy")
    whole = numba.uint64

    @jit
    def sweep(u, xi, stiffness, limit, no_fail, neighbour, force, energy, lost):
        for t in numba.prange((len(u) + 1) // 2):
            p = whole(2 * t)
            q = whole(min(2 * t + 1, len(u) - 1))  # of an odd number the last one twice
            px, py, qx, qy = u[p, 0], u[p, 1], u[q, 0], u[q, 1]
            fx = fy = e = gx = gy = w = 0.0
            lost_p = lost_q = 0
            for b in range(len(limit)):
                x, y, k = xi[b, 0], xi[b, 1], stiffness[b]
                j = neighbour[p, b]
                if j >= 0:
                    far = whole(j)
                    d = x * (u[far, 0] - px) + y * (u[far, 1] - py)
                    fx += k * d * x
                    fy += k * d * y
                    e += k * d * d
                    if d > limit[b] and no_fail[p] + no_fail[far] == 0:
                        neighbour[p, b] = -1 - j
                        lost_p += 1
                j = neighbour[q, b]
                if j >= 0:
                    far = whole(j)
                    d = x * (u[far, 0] - qx) + y * (u[far, 1] - qy)
                    gx += k * d * x
                    gy += k * d * y
                    w += k * d * d
                    if d > limit[b] and no_fail[q] + no_fail[far] == 0:
                        neighbour[q, b] = -1 - j
                        lost_q += 1
            force[p, 0], force[p, 1], energy[p], lost[p] = fx, fy, 0.25 * e, lost_p
            force[q, 0], force[q, 1], energy[q], lost[q] = gx, gy, 0.25 * w, lost_q

    @jit
    def dilatation(u, xi, a, neighbour, theta):
        for t in numba.prange((len(u) + 1) // 2):
            p = whole(2 * t)
            q = whole(min(2 * t + 1, len(u) - 1))
            px, py, qx, qy = u[p, 0], u[p, 1], u[q, 0], u[q, 1]
            first = second = 0.0
            for b in range(len(a)):
                x, y = xi[b, 0], xi[b, 1]
                j = neighbour[p, b]
                if j >= 0:
                    far = whole(j)
                    first += a[b] * (x * (u[far, 0] - px) + y * (u[far, 1] - py))
                j = neighbour[q, b]
                if j >= 0:
                    far = whole(j)
                    second += a[b] * (x * (u[far, 0] - qx) + y * (u[far, 1] - qy))
            theta[p], theta[q] = first, second

    @jit
    def pull(u, xi, k, limit, no_fail, neighbour, force, energy, lost, a, excess, theta):
        for t in numba.prange((len(u) + 1) // 2):
            p = whole(2 * t)
            q = whole(min(2 * t + 1, len(u) - 1))
            px, py, qx, qy = u[p, 0], u[p, 1], u[q, 0], u[q, 1]
            fx = fy = e = gx = gy = w = 0.0
            lost_p = lost_q = 0
            for b in range(len(limit)):
                x, y, bulk = xi[b, 0], xi[b, 1], excess * a[b]
                j = neighbour[p, b]
                if j >= 0:
                    far = whole(j)
                    d = x * (u[far, 0] - px) + y * (u[far, 1] - py)
                    s = k[b] * d
                    e += 0.25 * s * d
                    s += bulk * (theta[p] + theta[far])
                    fx += s * x
                    fy += s * y
                    if d > limit[b] and no_fail[p] + no_fail[far] == 0:
                        neighbour[p, b] = -1 - j
                        lost_p += 1
                j = neighbour[q, b]
                if j >= 0:
                    far = whole(j)
                    d = x * (u[far, 0] - qx) + y * (u[far, 1] - qy)
                    s = k[b] * d
                    w += 0.25 * s * d
                    s += bulk * (theta[q] + theta[far])
                    gx += s * x
                    gy += s * y
                    if d > limit[b] and no_fail[q] + no_fail[far] == 0:
                        neighbour[q, b] = -1 - j
                        lost_q += 1
            force[p, 0], force[p, 1], lost[p] = fx, fy, lost_p
            energy[p] = e + 0.5 * excess * theta[p] ** 2
            force[q, 0], force[q, 1], lost[q] = gx, gy, lost_q
            energy[q] = w + 0.5 * excess * theta[q] ** 2

    def state_based(u, xi, k, limit, no_fail, neighbour, force, energy, lost, a, excess, theta):
        dilatation(u, xi, a, neighbour, theta)
        pull(u, xi, k, limit, no_fail, neighbour, force, energy, lost, a, excess, theta)

    return sweep, state_based


def compare(
    sides: tuple[int, int], ratio: float, rivals: Any, repeats: int, lam: float, share: float = 0.0
) -> dict[str, Any]:
    """Milliseconds of both, and the ratio Numba over Warp with its 10 and 90 % points; μ = 1.

    `share`: of bonds that are broken at the start, at random.
    """
    random = np.random.default_rng(0)
    body = lattice_body(box(sides, 1.0), 1.0, ratio)
    model = Model(lam=lam, mu=1.0, alpha=1.0, D=np.ones(1), horizon=ratio)
    limits = 0.02 * body.r**2
    operator = CutOperator(model, body, limits=limits)
    (stiffness, felt, _), table = operator.bonded, body.neighbour.copy()
    count = len(body.x)
    table[random.random(table.shape) < share] = -1
    u = 3e-3 * random.standard_normal((count, 2))
    field, links = floats(u.copy(), operator.vector), operator.links(table)
    force, energy = zeros(count, dtype=operator.vector), zeros(count)
    theirs = (np.zeros((count, 2)), np.zeros(count), np.zeros(count, np.int32))
    inputs = (u, body.xi, 2 * stiffness, limits, np.zeros(count, np.uint8), table)
    more = () if lam == 1 else (felt, lam - 1, np.zeros(count))
    jobs = (
        lambda: operator.sweep(field, links, force, energy, breaking=True),
        lambda: rivals[lam != 1](*inputs, *theirs, *more),
    )
    processor, wall = alternating(jobs, repeats)
    apart = np.abs(force.numpy() - theirs[0]).max() / np.abs(theirs[0]).max()
    if not (apart < 1e-12 and np.array_equal(operator.kept(links), table >= 0)):
        raise RuntimeError(f"the two differ by {apart:.1e}, or in what breaks")
    ratios = processor[1] / processor[0]
    return {
        "lambda": lam,
        "nodes": count,
        "bonds": len(felt),
        "broken": share,
        "ms": float(np.median(processor[0])),
        "Numba ms": float(np.median(processor[1])),
        "ratio": float(np.median(ratios)),
        "ratios": np.quantile(ratios, (0.1, 0.9)).round(3).tolist(),
        "ratio by the clock": float(np.median(wall[1] / wall[0])),
    }


def alternating(jobs: Sequence[Callable[[], Any]], repeats: int) -> np.ndarray:
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
        for place in range(len(jobs))[:: 1 if turn % 2 else -1]:
            time.sleep(0.02)  # until the threads of the one before stop spinning
            before = np.array([time.process_time(), time.perf_counter()])
            for _ in range(calls):
                jobs[place]()
            after = np.array([time.process_time(), time.perf_counter()])
            times[:, place, turn] = 1e3 * (after - before) / calls
    return times


def block(repeats: int, side: int = 16, ratio: float = 3.0) -> dict[str, Any]:
    """Millions of bonds a second in whole steps of a free block of an LPS that may break, one core.

    Bonds are those of the whole ball, counted from both ends, of every node. LAMMPS's `peri/lps`
    looks for contacts too.
    """
    set_threads(1)
    body = lattice_body(box(3 * (side,), 1.0), 1.0, ratio)
    model = Model(lam=2.0, mu=1.0, alpha=1.0, D=np.ones(1), horizon=ratio, dimension=3)
    moving = BreakingBody(BrittleSolid(model, 1.0, critical_stretch=0.02), body)
    begin = 1e-3 * np.random.default_rng(0).standard_normal(body.x.shape)
    state, dt = moving.start(v=begin), 0.5 * moving.longest_step
    jobs: list[Callable[[], Any]] = [lambda: step(moving, state, dt)]
    try:
        lammps = PeriLps(side, ratio)
        jobs.append(lambda: lammps.march(1))
    except LammpsError:
        pass
    bonds = len(body.x) * moving.operator.bonds
    speed = bonds / 1e3 / np.median(alternating(jobs, repeats)[0], axis=1)
    found = {"nodes": len(body.x), "bonds": moving.operator.bonds, "Mbond/s": float(speed[0])}
    found["times the page of bpm/peri"] = 1e6 * found["Mbond/s"] / PAGE
    if len(jobs) > 1:
        found |= {"peri/lps Mbond/s": float(speed[1]), "times it": float(speed[0] / speed[1])}
    return found


def search(side: int = 28) -> dict[str, float]:
    """A penny in a block by conjugate gradients, one thread: processor seconds of the solve, and
    nanoseconds a node of a product by rows, of one by the matrix, and of assembling that."""
    set_threads(1)
    x = box(3 * (side,), 1.0)
    points = Points(x, np.abs(x).max(axis=1) < side / 2 - 2, 1.0)
    model = Model(lam=2.0, mu=1.0, alpha=1.0, D=np.ones(1), horizon=2.0, dimension=3)
    problem = Cracked(points, u=0.01 * x * (0, 1, 0), cracks=[penny(side / 5)])

    def spent(job: Callable[[], Any]) -> float:
        began = time.process_time()
        job()
        return time.process_time() - began

    def solved() -> Any:
        return solve(model, problem, solver=Krylov())

    cut, fields = solved().operator, 1e-3 * np.random.default_rng(0).normal(size=(1, *x.shape))
    found = {"nodes": len(x), "solve s": spent(solved)}
    found["assemble ns"] = 1e9 * spent(lambda: cut.matrix) / len(x)
    ways = {"rows ns": lambda: cut.times(fields), "matrix ns": lambda: cut.matrix @ fields.ravel()}
    return found | {
        name: 1e9 * min(spent(way) for _ in range(9)) / len(x) for name, way in ways.items()
    }


def broken(*, quick: bool, threads: tuple[int, ...] = (1, 2)) -> dict[str, Any]:
    """Sweeps of plates, shares of broken bonds, and the block."""
    if find_spec("numba") is None:
        raise InputError("broken: needs Numba; pip install 'warp_peri[bench]'")
    import numba

    rivals, repeats, sizes = rival(), 1 if quick else 15, ((60, 24, 3.0),) if quick else SIZES
    found: dict[str, Any] = {"sweeps": [], "shares": []}
    found["block"] = block(repeats, 8 if quick else 16)
    found["search"] = search(14 if quick else 28)
    for count in threads:
        set_threads(count)
        numba.set_num_threads(count)
        for lam in (1.0, 2.0):
            for width, height, ratio in sizes:
                row = compare((width, height), ratio, rivals, repeats, lam)
                found["sweeps"].append({"threads": count} | row)
    set_threads(1)
    numba.set_num_threads(1)
    for share in SHARES[::4] if quick else SHARES:
        found["shares"].append(compare(sizes[0][:2], 3.0, rivals, repeats, 1.0, share))
    return found
