"""Problems on many ranks: bodies at rest, waves, and bodies that break.

A rank that breaks a body steps its nodes and those of others within δ, 2δ with a dilatation, whose
displacement comes from their owners after each drift. All bonds that its own nodes feel then break
here as they do there.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.files.checkpoint import RunFile, agreed, fingerprint, same
from warp_peri.fracture.body import lattice_body
from warp_peri.fracture.dynamics import BreakingBody
from warp_peri.fracture.problems import Cracked, options_of_steps
from warp_peri.fracture.run import CrackRun
from warp_peri.kernels import neighbours
from warp_peri.kernels.damage.motion import halves
from warp_peri.kernels.damage.sweeps import sweep
from warp_peri.mpi.halo import NodeHalo
from warp_peri.mpi.linear import operator_on
from warp_peri.mpi.processes import build
from warp_peri.points.arguments import as_array, checked_fields
from warp_peri.points.families import HORIZON_TOLERANCE
from warp_peri.points.unit_names import check_same
from warp_peri.protocols import MATERIAL, offered, taken
from warp_peri.solvers.conjugate_gradients import SolveRecord, norm
from warp_peri.solvers.motion import Motion, Recorder
from warp_peri.solvers.solution import CG, TOLERANCE, Solution, Solver, by_sample, refuse_solver
from warp_peri.solvers.verlet import march

STAGE = 1e-3
"""Of a residual, after which a linear solve with a checkpoint writes it."""


def solve(material: Any, problem: Any, solver: Solver, options: dict[str, Any]) -> Solution:
    """A Dirichlet problem on a piece; u and load are those of this rank's nodes.

    With the option checkpoint=PATH what was found is written as the solve goes, and a later one
    goes on from there, on any number of ranks.

    Raises InputError for other problems and laws, and as RowOperator and `definite` do.
    """
    piece = problem.points
    alike(material, problem, options | {"solver": solver})
    (asked,) = taken(options, "solve", _asked)
    path = _asked(**asked)
    with agreed(piece.comm):
        if not hasattr(problem, "u") or hasattr(problem, "cracks"):
            raise InputError("solve: expected a Dirichlet(points, b, u) on ranks")
        offered(material, "on", "solve", MATERIAL)
        b, u = checked_fields(piece, problem.b, problem.u)
        refuse_solver(solver, (CG,), "a linear body on ranks")
        if (kind := getattr(solver, "preconditioner", None)) not in (None, "multigrid"):
            raise InputError(f"preconditioner: expected multigrid on ranks, got {kind!r}")
    operator = operator_on(material, piece)
    tolerance = TOLERANCE if solver is None else solver.tolerance  # type: ignore[union-attr]
    inside, flat = piece.interior, [field.reshape(-1, *piece.x.shape) for field in (b, u)]
    file, mark, mask = None, "", inside[:, None]
    if path is not None:
        if len(flat[0]) > 1:
            raise InputError(f"checkpoint: expected one load, got {len(flat[0])}")
        file = RunFile(path, "warp_peri.rest", piece)
        given = np.where(mask, flat[0][0], 0.0), np.where(mask, 0.0, flat[1][0]), mask, piece.x
        mark = piece.mark(*given, fingerprint(material))
    answers, records = np.where(mask, 0.0, flat[1]), list[SolveRecord]()
    for field, load, held in zip(answers, *flat):
        field[:], record = solved(operator, load, held, tolerance, file, mark)
        records.append(record)
    right = operator.rhs(b).reshape(*b.shape[:-2], -1, b.shape[-1])
    counts, how = [record.iterations for record in records], (operator.method, operator.proven)
    return by_sample(operator, answers.reshape(u.shape), right, records, counts, *how)


NODAL = ("points", "b", "u", "free", "v", "no_fail", "grip", "record")
"""Of what is given to a verb those that each rank has for its own nodes."""


def alike(material: Any, problem: Any, options: Mapping[str, Any]) -> None:
    """Refuse ranks that were given different things: a step, a material, a crack, a signal.

    Raises InputError on all, before anything is sent that depends on what was given.
    """
    comm = problem.points.comm
    with agreed(comm):
        asked = {f.name: getattr(problem, f.name) for f in fields(problem)} | dict(options)
        given = {name: asked.pop(name, None) for name in NODAL}
        there = [n for n, one in given.items() if one is not None and n != "record"]
        stacked = [as_array(n, given[n]).shape[:-2] for n in ("b", "u") if n in there]
        regions = sorted(asked.pop("regions", None) or ())
    kind = type(problem).__name__
    same(comm, material=material, problem=(kind, stacked, there, regions), **asked)


def solved(
    operator: Any, b: np.ndarray, u: np.ndarray, tolerance: float, file: RunFile | None, mark: str
) -> tuple[np.ndarray, SolveRecord]:
    """Displacement [n, d] of a linear operator with load b on the interior, u given elsewhere.

    With a file, which the mark says to be of this problem, the answer goes on from what is kept
    there, and is written each time that the residual is STAGE of what it was. All ranks come here.
    """
    inside, load = operator.points.interior, operator.rhs(b)
    field = np.where(inside[:, None], 0.0, u)
    right = load - operator(field)
    if file is None:
        field[inside], record = operator.inverted(right, tolerance)
        return field, record
    inner, record, last = operator.points.inner, SolveRecord(), np.inf
    size = norm(right, inner)
    if (kept := file.read("u")) is not None:
        if kept[1]["mark"] != mark:
            raise InputError(f"{file.path}: expected a checkpoint of this problem")
        field[inside] = kept[0]["u"][inside]
    while (left := norm(rest := load - operator(field), inner)) > tolerance * size:
        if not left < last:
            raise InputError(
                f"tolerance: {tolerance:.1e} of the load was asked for, the residual stays at "
                f"{last / size:.1e}, which is rounding"
            )
        last = left
        more, part = operator.inverted(rest, max(tolerance * size / left, STAGE))
        field[inside] += more
        record.iterations += part.iterations
        file.write({"u": field}, {"mark": mark})
    record.residual = left / size if size > 0 else 0.0
    return field, record


def _asked(*, checkpoint: str | os.PathLike[str] | None = None) -> Any:
    """The options of a solve on ranks: the file of a checkpoint."""
    return checkpoint


def move(material: Any, problem: Any, options: dict[str, Any]) -> Motion:
    """Motion of a Cracked on ranks: see Cracked.moved; fields are those of this rank's nodes.
    Of an unbroken body: see solvers.verlet.march.

    Raises InputError for anything but steps, and for bonds that break by energy.
    """
    piece, comm = problem.points, problem.points.comm
    alike(material, problem, options)
    if hasattr(problem, "b") and not isinstance(problem, Cracked):
        with agreed(comm):
            offered(material, "on", "simulate", MATERIAL)
            how, files = taken(options, "simulate", march, Recorder.__init__)
        return march(operator_on(material, piece), problem.b, problem.u, **how | files)
    with agreed(comm):
        if not isinstance(problem, Cracked) or "step" not in options:
            raise InputError(
                "simulate: expected a Dirichlet or Cracked, and step=…, steps=… on ranks"
            )
        offered(material, "density", "simulate", "a BrittleMaterial")
        if material.critical_energy is not None or problem.pressure is not None:
            raise InputError(
                "simulate: expected bonds that break by their stretch, and no pressure, on ranks"
            )
        check_same(material.units, piece.units)
        material.linear.check_dimension(piece)
        how, begin, files, records, run = options_of_steps(options)
    model = material.model
    d = piece.dimension
    build(comm, neighbours.lattice_neighbours, sweep(d).sweep, halves(d).kick_and_drift)
    balls = 1 if model.lam == model.mu and not problem.corrected else 2
    felt = balls * model.horizon * (1 + HORIZON_TOLERANCE)
    halo = NodeHalo(piece, felt)
    given: dict[str, Any] = {"load": problem.b, "held": problem.held, "u": problem.u}
    given |= {name: how.pop(name, None) for name in ("no_fail", "grip")}
    given = {k: v for k, v in (given | {"v": begin.pop("v", None)}).items() if v is not None}
    with agreed(comm):
        for name, values in given.items():
            if len(np.asarray(values)) != len(piece.x):
                raise InputError(f"{name}: expected {len(piece.x)} nodes of this rank")
    here: dict[str, Any] = {name: halo.around(values) for name, values in given.items()}
    with agreed(comm):
        body = lattice_body(halo.x, piece.spacing, model.horizon)
        if not np.array_equal(body.axes, np.eye(d)):
            raise InputError("points: expected a lattice along the axes on ranks, got a turned one")
        at_start = {name: here.pop(name, None) for name in ("u", "v")}
        moving = BreakingBody(material, body, corrected=problem.corrected, **here, **how)
        state = moving.start(**at_start, cracks=problem.cracks, **begin)
    marching = CrackRun(moving, nodes=halo, **records | files)
    moving.exchange = halo.exchange
    return marching.motion(marching.march(state, **run))
