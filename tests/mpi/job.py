"""What tests start under mpiexec: python -m tests.mpi.job FOLDER [WORD …].

A crack that runs, with a checkpoint and files; with `rest` also sums, bodies at rest in the plane
and in space, and refusals; with `fail` at the end input that one rank alone cannot use. The first
rank prints JSON.
"""

import hashlib
import json
import os
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import torch

import warp_peri as wp
from tests.support.nonlinear import solid as third_order
from warp_peri.certificates import prove_uniqueness
from warp_peri.core import proof
from warp_peri.fracture import BrittleMaterial, Cracked, box_nodes, rectangle_nodes
from warp_peri.mpi import gather, lattice, partition, together
from warp_peri.mpi.processes import total, world

H = 0.5


def digest(values):
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()


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


def solid(dimension):
    """A positive kernel, λ ≠ μ."""
    D = np.array([1.0, 0.6, 0.3])
    return wp.LPSMaterial(0.9, 0.4, 1.0, D, horizon=(2.5 if dimension == 2 else 2) * H,
                    certified_on=(H,), dimension=dimension)  # fmt: skip


def nonlinear():
    return third_order("energy", 2.5 * H, H)


def inside(x):
    """A thick L in the plane, a ball in space, with room for a collar."""
    away = (x - CENTRE[x.shape[1]]) / H
    if x.shape[1] == 3:
        return (away**2).sum(axis=1) < 8**2
    return (np.abs(away) < 20).all(axis=1) & ~((away > 4).all(axis=1))


TILE = {2: (32, 16), 3: (24, 8)}
"""Of these two ranks cut a box along the first axis, three along the second."""
CENTRE = {2: np.array([12.5, 12.5]), 3: np.array([6.0, 6.0, 6.0])}


def fields(x):
    """A load and a displacement, from the positions alone."""
    waves = [np.sin(0.3 * x[:, 0] + a) * np.cos(0.2 * x[:, 1] - a) for a in range(x.shape[1])]
    u = np.stack(waves, axis=1)
    return 0.01 * u[:, ::-1], 0.1 * u


def small(x):
    """Of these the gradients reach 2 %."""
    return tuple(0.4 * field for field in fields(x))


def proofs():
    """Of three symbols, and how many cells of them this rank looked at."""
    seen, looked = [], proof._symbol_slopes
    proof._symbol_slopes = lambda *given: seen.append(len(given[-1])) or looked(*given)
    try:
        with together():
            own = wp.certificates.certify(solid(2), spacing=H).symbol_bound
            bent = prove_uniqueness(nonlinear(), spacing=H).strain
            crystal = wp.crystals.crystal_from_lps(solid(3), H).certificate
    finally:
        proof._symbol_slopes = looked
    return [own, bent, crystal.proven, crystal.sampled, crystal.cells], sum(seen)


def from_file(comm, folder):
    """Whether nodes and fields of a file are those of the functions that made it."""
    x = H * np.argwhere(np.ones((52, 52)))
    if comm.rank == 0:
        with h5py.File(folder / f"plate_{comm.size}.h5", "w") as file:
            file["interior"], file["b"] = inside(x), fields(x)[0]
    comm.Barrier()
    points = lattice((52, 52), H, folder / f"plate_{comm.size}.h5")
    same = np.array_equal(points.interior, inside(points.x))
    b = points.read(folder / f"plate_{comm.size}.h5", "b")
    return comm.allgather(bool(same and np.array_equal(b, fields(points.x)[0])))


def going_on(points, folder, share):
    """Solves that go on from what is kept, to a share of the digits that a fresh one has."""
    found = {}
    law, tolerance, path = solid(2), 10.0 ** (-10 / share), folder / "Model.h5"
    solver, problem = wp.CG(tolerance=tolerance), wp.Dirichlet(points, *small(points.x))
    solution = wp.solve(law, problem, solver=solver, checkpoint=path)
    u, fresh = points.gather(solution.u), wp.solve(law, problem, solver=solver)
    far = np.abs(u - points.gather(fresh.u)).max() / np.abs(u).max()
    found["LPSMaterial"] = {"far": far, "residual": solution.residual, "tolerance": tolerance,
                      "took": [solution.iterations[0], fresh.iterations[0]]}  # fmt: skip
    other = wp.Dirichlet(points, *fields(points.x))
    found["other"] = told_by(lambda: wp.solve(solid(2), other, checkpoint=path))
    return found


def told_by(wrong):
    """What is said of wrong input; None where nothing is."""
    try:
        wrong()
    except wp.InputError as error:
        return str(error)


def unfit(checkpoint):
    """Of what no number of processes may take, what each is told; None where it is solved."""
    x = H * np.argwhere(np.ones((52, 52)))
    away = np.abs(x - 8)
    law, turned = solid(2), wp.crystals.crystal_from_lps(solid(2), H)
    near = fields(x)
    wild = np.where(np.arange(len(x))[:, None], near[1], np.nan)
    whole = np.ones(len(x), bool)
    cases = {
        "missing": (law, away.max(axis=1) > H / 2, *near),
        "slot": (law, ~((away[:, 0] < H / 2) & (away[:, 1] < 2)), *near),
        "hole": (turned, (away**2).sum(axis=1) > (4 * H) ** 2, *near),
        "doubled": (law, np.append(np.arange(len(x)), 400), *near),
        "load": (law, whole, np.where(inside(x)[:, None], np.nan, near[0]), near[1]),
        "displacement": (law, whole, near[0], wild),
        "masked": (turned, whole, np.ma.array(near[0], mask=True), near[1]),
        "complex": (law, whole, near[0], 1j * near[1]),
        "uncertified": (replace(law, D=np.array([1.0, -3.0, 3.0]), certified_on=()), whole, *near),
        "axis": (turned, whole, *near),
        "tolerance": (law, whole, *near),
    }

    def solve(name, material, there, b, u):
        axis = 17.0 if name == "axis" else 0.0
        points = partition(wp.Points(x[there], inside(x[there]), H, axis=axis))
        mine = points.number if hasattr(points, "number") else slice(None)
        problem = wp.Dirichlet(points, b[there][mine], u[there][mine])
        at = {"solver": wp.CG(tolerance=1e-17)} if name == "tolerance" else {}
        kept_at = {"checkpoint": checkpoint} if at and hasattr(points, "number") else {}
        wp.solve(material, problem, **at, **kept_at)

    return {name: told_by(partial(solve, name, *case)) for name, case in cases.items()}


def transferred():
    """A solid on a lattice other than its own, and which material has no rows on ranks."""
    points = partition(wp.Points(x := H * np.argwhere(np.ones((52, 52))), inside(x), H))
    law = wp.LPSMaterial(0.9, 0.4, 1.0, np.ones(1), horizon=1.5, certified_on=(0.6,))
    return gather(points, wp.solve(law, wp.Dirichlet(points, *fields(points.x))).u)


def waves(points, folder):
    """A solid that swings: 15 steps, or 25 of which others have taken some."""
    b, u = fields(points.x)
    d = points.dimension
    law = solid(2) if d == 2 else wp.crystals.crystal_from_lps(solid(3), H)
    problem, last = wp.Dirichlet(points, b, u), 15 if points.comm.size == 2 else 25
    motion = wp.simulate(
        law, problem, **SWING, v=u[:, ::-1], steps=last,
        checkpoint=folder / f"waves_{d}.h5", checkpoint_every=2, series=folder / f"waves_{d}",
    )  # fmt: skip
    end = kept(folder, f"waves_{d}", points, np.concatenate([motion.u, motion.v], axis=1))
    return {"end": end, "energy": motion.energy.tolist(), "drift": motion.drift}


SWING = {"density": 2000.0, "step": 1e-3, "every": 4}


def rest(folder):
    comm, found = world(), {}
    found["proofs"], seen = proofs()
    found["shared"] = comm.allgather(seen)
    found["sums"] = total(comm, uneven()[comm.rank :: comm.size]).tolist()
    for shape in ((52, 52), (25, 25, 25)):
        points = lattice(shape, H, inside, block=TILE[len(shape)])
        b, u = fields(points.x)
        tolerance = 1e-10 if len(shape) == 2 else 1e-8
        solver = wp.CG(tolerance=tolerance)
        solution = wp.solve(solid(len(shape)), wp.Dirichlet(points, b, u), solver=solver)
        left = points.gather(np.abs(solution.operator(solution.u) - solution.load).max(initial=0)
                             * np.ones(len(points.x)))  # fmt: skip
        name = f"{len(shape)}-D"
        found[name] = {"u": kept(folder, name, points, solution.u), "left": left.max(),
                       "iterations": solution.iterations[0], "residual": solution.residual,
                       "waves": waves(points, folder)}  # fmt: skip
    sheet = lattice((52, 52), H, inside, axis=0.0)
    found["file"] = from_file(comm, folder)
    found["kept"] = going_on(sheet, folder, 2 if comm.size == 2 else 1)
    found["grid"] = points.tiles.grid
    found["unfit"] = unfit(folder / "unfit.h5")
    found["door"] = at_the_door() if comm.size > 1 else {}
    kept(folder, "transferred", SimpleNamespace(comm=comm, gather=np.asarray), transferred())
    full = lattice((52, 52), H, lambda x: x[:, 0] >= 0)
    everywhere = H * np.argwhere(np.ones((52, 52)))
    found["refused"] = [told_by(wrong) for wrong in (
        lambda: solid(3).on(points)(u),
        lambda: wp.solve(solid(2), wp.Dirichlet(full, *fields(full.x))),
        lambda: wp.simulate(
            solid(2), wp.Dirichlet(sheet, *fields(sheet.x)), **SWING | {"step": 1.0}, steps=1
        ),
        lambda: lattice((52, 52), H, lambda x: x[:, 0] < 0),
        lambda: wp.solve(nonlinear(), wp.Dirichlet(sheet, *fields(sheet.x))),
        lambda: wp.solve(solid(2), wp.Dirichlet(sheet, *map(torch.tensor, fields(sheet.x))),
                         parameters={"mu": torch.tensor(0.4, requires_grad=True)}),
        lambda: partition(wp.Points(everywhere, inside(everywhere), 0.0)),
        lambda: wp.simulate(BrittleMaterial(solid(2), 2500.0, toughness=1.0),
                        wp.Cracked(sheet, pressure=np.eye(2)), step=0.1, steps=1),
        lambda: lattice((8, 52), H, inside, block=8) if comm.size > 1 else partition(1, by="hue"),
    )]  # fmt: skip
    return found


def at_the_door():
    """What is said where rank 1 was given something else than the others, by what it was."""
    one = int(world().rank == 1)
    x = H * np.argwhere(np.ones((52, 52)))
    sheet, plate = partition(wp.Points(x, inside(x), H)), rectangle_nodes(20.0, 20.0, 1.0)
    plate = partition(wp.Points(plate, np.ones(len(plate), bool), 1.0))
    b, u = fields(sheet.x)
    law = replace(solid(2), mu=0.4 + 1e-9 * one)

    def moved(material=None, problem=None, **options):
        problem = problem or wp.Dirichlet(sheet, b, u)
        wp.simulate(material or solid(2), problem, **SWING | {"steps": 4} | options)

    def broken(at=-5.0, toughness=1e-4, watched=1.0, **options):
        glass = BrittleMaterial(replace(solid(2), horizon=2.5, certified_on=()), 2500.0, toughness)
        body = Cracked(plate, cracks=[[(-10.5, 0.0), (at, 0.0)]])
        watch = {"some": lambda phi: watched * phi.max()}
        given = {"step": 0.5 * glass.longest_step(1.0), "steps": 4, "watch": watch}
        wp.simulate(glass, body, **given | options)

    cases = {
        "material": [lambda: wp.solve(law, wp.Dirichlet(sheet, b, u)), partial(moved, law),
                     partial(broken, toughness=1e-4 * (1 + one))],
        "problem": [partial(moved, problem=wp.Dirichlet(sheet, None if one else b, u)),
                    lambda: wp.solve(solid(2), wp.Dirichlet(sheet, b, u[None] if one else u))],
        "density": [partial(moved, density=2000.0 + one)],
        "step": [partial(moved, step=1e-3 / (1 + one)), partial(broken, step=1e-3 / (1 + one))],
        "steps": [partial(moved, steps=4 + one), partial(broken, steps=4 + one)],
        "signal": [partial(moved, signal=np.arange(5.0 + one)[:5] + one)],
        "solver": [lambda: wp.solve(solid(2), wp.Dirichlet(sheet, b, u),
                                    solver=wp.CG(tolerance=1e-8 / (1 + one)))],
        "cracks": [partial(broken, at=-5.0 + one)],
        "watch": [partial(broken, watched=1.0 + one)],
        "points": [lambda: partition(wp.Points(x + one, inside(x), H))],
        "shape": [lambda: lattice((52 + one, 52), H, inside)],
    }  # fmt: skip
    return {name: [told_by(case) for case in some] for name, some in cases.items()}


def crack(folder, by="rows", steps="60", pause="0"):
    """A notched plate that is pulled at its ends."""
    x = rectangle_nodes(40.0, 20.0, 1.0)
    points = partition(wp.Points(x, np.ones(len(x), bool), 1.0, units=("mm", "GPa")), by)
    x = points.x
    glass = BrittleMaterial(
        wp.LPSMaterial(0.3, 0.4, 1.0, np.ones(1), horizon=2.5, units=("mm", "GPa")),
        2500.0,
        toughness=1e-4,
    )
    ends = np.abs(x[:, 1]) > 9
    os.environ["PAUSE"] = pause  # no part of what a checkpoint knows a run by
    if pause != "0":
        print("pids", *points.comm.allgather(os.getpid()), flush=True)
    motion = wp.simulate(
        glass,
        Cracked(points, np.where(ends[:, None], np.sign(x) * (0.0, 0.01), 0.0),
                cracks=[[(-20.5, 0.0), (-5.0, 0.0)]]),
        step=0.5 * glass.longest_step(1.0),
        steps=int(steps),
        every=20,
        no_fail=np.abs(x[:, 1]) > 7,
        regions={"top": x[:, 1] > 0},
        sections={"middle": [(-20.5, 6.0), (20.5, 6.0)]},
        watch={"worst": lambda phi: time.sleep(float(os.environ["PAUSE"])) or phi.max()},
        checkpoint=folder / "state.h5",
        checkpoint_every=1,
        series=folder / "series",
    )  # fmt: skip
    records = [motion["elastic"], motion["force middle"], motion["u top"], motion["worst"]]
    phi = gather(points, motion.details.damage)
    return {
        "u": digest(gather(points, motion.u)),
        "damage": digest(phi),
        "worst": phi.max(),
        "records": digest(np.concatenate([np.ravel(record) for record in records])),
        "ledger": motion.missing,
    }


def corrected(by="rows"):
    """A notched plate that breaks, its missing bonds made up for."""
    x = rectangle_nodes(40.0, 20.0, 1.0)
    points = partition(wp.Points(x, np.ones(len(x), bool), 1.0), by)
    glass = BrittleMaterial(
        wp.LPSMaterial(0.3, 0.3, 1.0, np.ones(1), horizon=3.0), 2500.0, toughness=1e-4
    )
    pull = np.where(np.abs(points.x[:, 1:]) > 9, np.sign(points.x) * (0.0, 0.01), 0.0)
    plate = Cracked(points, pull, cracks=[[(-20.5, 0.0), (-5.0, 0.0)]], corrected=True)
    motion = wp.simulate(glass, plate, step=0.5 * glass.longest_step(1.0), steps=60)
    return [digest(gather(points, one)) for one in (motion.u, motion.details.damage)]


def block(by="rows"):
    """A notched block in space."""
    x = box_nodes((20.0, 10.0, 8.0), 1.0)
    points = partition(wp.Points(x, np.ones(len(x), bool), 1.0), by)
    x = points.x
    model = wp.LPSMaterial(0.3, 0.4, 1.0, np.ones(1), horizon=2.0, dimension=3)
    rock = BrittleMaterial(model, 2500.0, toughness=1e-4)
    pull = np.where(np.abs(x[:, 1:2]) > 4, np.sign(x) * (0.0, 0.02, 0.0), 0.0)
    notch = [(-11.0, 0.0, -5.0), (-4.0, 0.0, -5.0), (-4.0, 0.0, 5.0), (-11.0, 0.0, 5.0)]
    motion = wp.simulate(
        rock, Cracked(points, pull, cracks=[notch]), step=0.5 * rock.longest_step(1.0), steps=40,
        no_fail=np.abs(x[:, 1]) > 3,
    )  # fmt: skip
    return {"u": digest(gather(points, motion.u)),
            "worst": gather(points, motion.details.damage).max()}  # fmt: skip


def fail():
    comm = world()
    if comm.rank == 1:
        raise wp.InputError("load: rank 1 has none")
    comm.Barrier()


if __name__ == "__main__":
    folder, by, steps, pause, *more = sys.argv[1:]
    found = {"crack": crack(Path(folder), by, steps, pause)}
    if pause == "0":
        found["corrected"] = corrected(by)
        found["block"] = block(by)
    if "rest" in more:
        found |= rest(Path(folder))
    print(json.dumps(found), flush=True)
    if "fail" in more:
        fail()
