"""What test_petsc starts under mpiexec: python -m tests.ranks.petsc_job FOLDER.

Bodies at rest whose coarse problem PETSc solves: a plate on three levels and on many, whose rows do
not start evenly, a ball, scattered points, and a solve that goes on. The first rank prints JSON.
"""

import json
import sys
from pathlib import Path

import numpy as np

import warp_peri as wp
from tests.ranks.job import H, carried, fields, inside, scattered, small, solid
from warp_peri.ranks import lattice, partition, petsc
from warp_peri.ranks.processes import world

LATTICES = {"plate": (116, 116), "deep": (116, 116), "ball": (25, 25, 25)}
SOLVER = wp.Krylov("petsc", tolerance=1e-10)


def thick(x):
    """An L in the plane with room for a collar; in space a ball."""
    away = np.abs(x / H - 57.5)
    return inside(x) if x.shape[1] == 3 else (away < 52).all(axis=1) & ~(x > 30).all(axis=1)


def work(operator):
    """z₁·r₂ and z₂·r₁ of its coarse problem, which are the same of a symmetric one, and z₁·r₁."""
    coarse = operator._near[2]
    place = operator.points.grid.min(axis=0)[0] + np.argwhere(coarse.mask)
    r = [np.zeros((operator.dimension, *coarse.mask.shape)) for _ in range(2)]
    for k, field in enumerate(r):
        field[:, coarse.mask] = np.sin((k + 1) * place @ np.ones(place.shape[1]) + k)
    z = [coarse(field) for field in r]
    told = [(z[0] * r[1]).sum(), (z[1] * r[0]).sum(), (z[0] * r[0]).sum()]
    return np.sum(operator.points.comm.allgather(told), axis=0).tolist()


def solved(material, points):
    solution = wp.solve(material, wp.Dirichlet(points, *fields(points.x)), solver=SOLVER)
    told = {"iterations": solution.iterations[0], "residual": solution.residual,
            "method": solution.method}  # fmt: skip
    return told, points.gather(solution.u), solution.operator


def going_on(folder):
    """Half of the digits on two ranks, all of them on others, from where those stopped."""
    points = lattice((52, 52), H, inside, block=(16, 16))
    problem, few = wp.Dirichlet(points, *small(points.x)), points.comm.size == 2
    solver = wp.Krylov("petsc", tolerance=1e-5 if few else 1e-10)
    found = wp.solve(solid(2), problem, solver=solver, checkpoint=folder / "kept.h5")
    fresh = wp.solve(solid(2), problem, solver=wp.Krylov(tolerance=1e-10))
    far = np.abs(found.u - fresh.u).max() / np.abs(fresh.u).max()
    return {"far": max(points.comm.allgather(far)), "took": found.iterations[0],
            "fresh": fresh.iterations[0]}  # fmt: skip


def main(folder):
    comm, found, answers = world(), {}, {}
    usual = petsc.COARSEST
    for name, shape in LATTICES.items():
        petsc.COARSEST = 20 if name == "deep" else usual
        points = lattice(shape, H, thick, block=8)
        found[name], answers[name], operator = solved(solid(len(shape)), points)
        found[name]["work"] = work(operator)
    petsc.COARSEST = usual
    found["cloud"], answers["cloud"], _ = solved(carried(), partition(scattered()))
    found["kept"] = going_on(folder)
    if comm.rank == 0:
        np.savez(folder / f"answers_{comm.size}.npz", **answers)
    print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
