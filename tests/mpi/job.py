"""What tests start under mpiexec: python -m tests.mpi.job FOLDER [WORD …].

A crack that runs, with a checkpoint and files; with `rest` also sums, bodies at rest in the plane
and in space, and refusals; with `fail` at the end input that one rank alone cannot use. The first
rank prints JSON.
"""

import hashlib
import json
import os
import sys
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from time import sleep

import numpy as np

import warp_peri as wp
from tests.support.clouds import plain
from warp_peri.core import proof
from warp_peri.diffusion import DiffusionMaterial
from warp_peri.fracture import BrittleMaterial, Cracked, Injected, rectangle_nodes
from warp_peri.mpi import TimeSeriesWriter, gather, lattice, linear, partition, together
from warp_peri.mpi.processes import total, world
from warp_peri.points.points import grid_places

H = 0.5
SHAPE = {2: (52, 52), 3: (17, 17, 17)}
TOLERANCE = {2: 1e-10, 3: 1e-8}
SWING = {"density": 2000.0, "step": 1e-3, "every": 4}
held = lambda points: wp.Dirichlet(points, *fields(points.x))
digest = lambda values: hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()


def kept(folder, name, points, values):
    """A digest of values on all nodes, which the first rank writes down."""
    everywhere = points.gather(values)
    if points.comm.rank == 0:
        np.save(folder / f"{name}_{points.comm.size}.npy", everywhere)
    return digest(everywhere)


def uneven():
    """Numbers of many sizes and both signs, whose sum in floats depends on the order."""
    random = np.random.default_rng(0)
    return random.normal(size=(1000, 2)) * 10.0 ** random.integers(-8, 8, (1000, 2))


@cache
def solid(dimension):
    """A positive kernel, λ ≠ μ."""
    law = {"D": [1.0, 0.6, 0.3], "certified_on": (H,), "dimension": dimension}
    return plain({2: 2.5, 3: 2.0}[dimension] * H, 0.9, 0.4, **law)


def inside(x):
    """A thick L in the plane, a ball in space, with room for a collar."""
    away = x / H - (25 if x.shape[1] == 2 else 8)
    if x.shape[1] == 3:
        return (away**2).sum(axis=1) < 4.5**2
    return (np.abs(away) < 20).all(axis=1) & ~((away > 4).all(axis=1))


def fields(x):
    """A load and a displacement, from the positions alone."""
    waves = [np.sin(0.3 * x[:, 0] + a) * np.cos(0.2 * x[:, 1] - a) for a in range(x.shape[1])]
    u = np.stack(waves, axis=1)
    return 0.01 * u[:, ::-1], 0.1 * u


@cache
def swings(dimension):
    """What waves are of."""
    return solid(2) if dimension == 2 else wp.crystals.crystal_from_lps(solid(3), H)


def whole(dimension):
    """The problem of one process."""
    x = H * grid_places(SHAPE[dimension])
    return held(wp.Points(x, inside(x), H))


def proofs():
    """The bound of a symbol, and how many cells of it this rank looked at."""
    seen, looked = [], proof._symbol_slopes
    proof._symbol_slopes = lambda *given: seen.append(len(given[-1])) or looked(*given)
    try:
        return proved(solid(2)).symbol_bound, sum(seen)
    finally:
        proof._symbol_slopes = looked


def told_by(wrong):
    """What is said of wrong input; None where nothing is."""
    try:
        wrong()
    except wp.InputError as error:
        return str(error)


def waves(points, folder):
    """A solid that swings: 15 steps, or 25 of which others have taken some."""
    problem, d = held(points), points.dimension
    motion = wp.simulate(
        swings(d), problem, **SWING, v=problem.u[:, ::-1],
        steps=15 if points.comm.size == 2 else 25,
        checkpoint=folder / f"waves_{d}.h5", checkpoint_every=2, series=folder / f"waves_{d}",
    )  # fmt: skip
    end = kept(folder, f"waves_{d}", points, np.concatenate([motion.u, motion.v], axis=1))
    return {"end": end, "energy": motion.energy.tolist(), "drift": motion.drift}


def rest(folder):
    comm, found = world(), {}
    linear.WHOLE = 100  # several levels of multigrid are spread
    found["proof"], seen = proofs()
    found["shared"] = comm.allgather(seen)
    found["sums"] = total(comm, uneven()[comm.rank :: comm.size]).tolist()
    for d, shape in SHAPE.items():
        points = lattice(shape, H, inside)
        solution = wp.solve(solid(d), held(points), solver=wp.CG(tolerance=TOLERANCE[d]))
        name = f"{d}-D"
        found[name] = {"u": kept(folder, name, points, solution.u),
                       "iterations": solution.iterations[0], "residual": solution.residual,
                       "waves": waves(points, folder)}  # fmt: skip
    sheet = lattice(SHAPE[2], H, inside, axis=0.0)
    if comm.size == 2:
        files, own = TimeSeriesWriter(folder / "own", sheet), [*zip("bu", fields(sheet.x))]
        files.write(1, 0.5, dict(reversed(own) if comm.rank else own))
        found |= {"door": at_the_door(sheet, files), "refused": refusals(sheet, points, files)}
    return found


def refusals(sheet, ball, files):
    """What is said of what no rank takes, or nothing; none of it waits for torch."""
    law, laid, rank = solid(2), partial(lattice, SHAPE[2], H), world().rank
    full, brittle = laid(lambda x: x[:, 0] >= 0), BrittleMaterial(law, 2500.0, toughness=1.0)
    breaks = partial(wp.simulate, brittle, step=1e-3, steps=1)
    flat, every = held(sheet), whole(2).points
    mixed = np.zeros(len(sheet.x), (bool, int)[rank])
    altered = replace(sheet, spacing=2 * H) if rank else sheet
    hidden = np.ma.masked_array(0 * sheet.x, sheet.x > 0)
    solution, far = wp.solve(law, flat, transfer=True), plain(1.25, 0.9, certified_on=(1.0,))
    cut = wp.Samples(every, every.x[None])
    return [told_by(wrong) for wrong in (
        lambda: solid(3).on(ball)(0 * ball.x),
        lambda: wp.solve(law, held(full)),
        lambda: wp.simulate(law, flat, **SWING | {"step": 1.0}, steps=1),
        lambda: laid(lambda x: x[:, 0] < 0),
        lambda: wp.simulate(DiffusionMaterial(1.0, 1.0), flat),  # before its options
        lambda: wp.solve(law, flat, parameters={"mu": 0.4}),
        lambda: wp.solve(law, flat, comm=1),
        lambda: partition(replace(every, spacing=0.0)),
        lambda: breaks(wp.Cracked(sheet, pressure=np.eye(2))),
        lambda: lattice((8, 52), H, inside),
        lambda: breaks(wp.Cracked(sheet), no_fail=mixed),
        lambda: breaks(wp.Cracked(sheet, hidden)),
        lambda: laid(lambda x: np.ma.masked_array(x[:, 0] > 0, True)),
        lambda: wp.simulate(law, replace(flat, points=altered), **SWING, steps=1),
        lambda: wp.Samples(sheet, sheet.x[None]),
        lambda: wp.crystals.crystal_from_lps(law, H).on(sheet),
        solution.stress,
        solution.plot,
        lambda: solution.operator.energy(solution.u),
        lambda: partition(None if rank else cut),
        lambda: partition(cut),
        lambda: sheet.gather(hidden if rank else 0 * sheet.x),
        lambda: Injected(sheet, [3.0]),
        lambda: breaks(wp.Cracked(sheet), progress=bool(rank)),
        lambda: wp.solve(far, flat, transfer=False),
        lambda: TimeSeriesWriter(files.path.parent, sheet).write(2, 1.0, {}),
        lambda: files.write(2.5 if rank else 2, 1.0, {}),
        lambda: files.write(2, np.nan if rank else 1.0, {}),
        lambda: files.write(2, 1.0, {"a": sheet.x[rank:]}),
        lambda: files.write(2, 1.0, {"a": hidden if rank else sheet.x}),
        lambda: files.write(2, 1.0, {"a<b": sheet.x}),
    )]  # fmt: skip


def proved(law):
    with together():
        return wp.certify(law, spacing=H)


def longest(law):
    with together():
        return wp.certificates.critical_time_step(law, spacing=H, density=1.0)


def at_the_door(sheet, files):
    """What is said where rank 1 was given something else than the others, by what it was."""
    one, (b, u) = int(world().rank == 1), fields(sheet.x)
    problem, law = wp.Dirichlet(sheet, b, u), replace(solid(2), mu=0.4 + 1e-9 * one)
    other, how = wp.Dirichlet(sheet, None if one else b, u), SWING | {"steps": 4}
    far = lattice(SHAPE[2], H, inside, origin=(0.0, 9.0)), sheet
    brittle = BrittleMaterial(solid(2), 2500.0, toughness=1.0)
    return {name: told_by(case) for name, case in {
        "points": lambda: wp.solve(solid(2), wp.Dirichlet(far[one], b, u)),
        "proof": lambda: longest(law),
        "ramp": lambda: wp.simulate(
            brittle, wp.Cracked(sheet, b), ramp=lambda _: 1.0 + one, step=1e-3, steps=1
        ),
        "material": lambda: wp.solve(law, problem),
        "problem": lambda: wp.simulate(solid(2), other, **how),
        "step": lambda: wp.simulate(solid(2), problem, **how | {"step": 1e-3 / (1 + one)}),
        "shape": lambda: lattice((52 + one, 52), H, inside),
        "values": lambda: sheet.gather(u[:, one:]),
        "fields": lambda: files.write(2, 1.0, {"ab"[one]: u}),
    }.items()}  # fmt: skip


def notched(horizon, lam, corrected=False):
    """A notched plate that is pulled at its ends, and its glass."""
    x = rectangle_nodes(40.0, 20.0, 1.0)
    points = partition(wp.Points(x, np.ones(len(x), bool), 1.0, units=("mm", "GPa")))
    pull = np.where(np.abs(points.x[:, 1:]) > 9, np.sign(points.x) * (0.0, 0.01), 0.0)
    glass = BrittleMaterial(plain(horizon, lam, 0.4, units=("mm", "GPa")), 2500.0, toughness=1e-4)
    return glass, Cracked(points, pull, cracks=[[(-20.5, 0.0), (-5.0, 0.0)]], corrected=corrected)


def crack(folder, steps="60", pause="0"):
    glass, plate = notched(2.5, 0.3)
    points, x = plate.points, plate.points.x
    os.environ["HELD"] = int(pause) * str(folder / "state.h5")  # no part of what a run is known by
    if pause != "0":
        print("pids", *points.comm.allgather(os.getpid()), flush=True)
    motion = wp.simulate(
        glass, plate, step=0.5 * glass.longest_step(1.0), steps=int(steps), every=20,
        no_fail=np.abs(x[:, 1]) > 7,
        watch={"worst": lambda phi:
               sleep(1e6 * os.path.isfile(os.environ["HELD"])) or phi.max()},
        checkpoint=folder / "state.h5", checkpoint_every=1, series=folder / "series",
    )  # fmt: skip
    names = "elastic", "work", "worst"
    phi = gather(points, motion.details.damage)
    return {
        "u": digest(gather(points, motion.u)), "damage": digest(phi), "worst": phi.max(),
        "records": digest(np.concatenate([np.ravel(motion[name]) for name in names])),
        "ledger": motion.missing,
    }  # fmt: skip


def corrected():
    """A plate that breaks, its missing bonds made up for."""
    glass, plate = notched(3.0, 0.4, corrected=True)
    motion = wp.simulate(glass, plate, step=0.5 * glass.longest_step(1.0), steps=60)
    return [digest(gather(plate.points, one)) for one in (motion.u, motion.details.damage)]


if __name__ == "__main__":
    folder, steps, pause, *more = sys.argv[1:]
    found = {"crack": crack(Path(folder), steps, pause)}
    if pause == "0":
        found["corrected"] = corrected()
    if "rest" in more:
        found |= rest(Path(folder))
    print(json.dumps(found), flush=True)
    if "fail" in more:
        pieces = held(lattice(SHAPE[2], H, inside))
        wp.solve(solid(2), pieces if world().rank else whole(2))
