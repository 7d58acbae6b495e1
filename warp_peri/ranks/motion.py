"""Breaking bodies in motion on many ranks, with the bits of one process.

A rank steps its nodes and those of others that they feel: within δ for bonds, 2δ with a dilatation.
After each drift the displacement of others' nodes comes from their owners, while nodes that feel
none of them are swept. All bonds that its own nodes feel then break here as they do there, and
nothing else is sent.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from warp_peri.contract import MATERIAL, offered, taken
from warp_peri.damage.lattice_body import LatticeBody, lattice_body
from warp_peri.damage.march import CrackRun
from warp_peri.damage.motion import BreakingBody
from warp_peri.damage.problems import Broken, Cracked, options_of_steps
from warp_peri.dynamics.motion import Motion
from warp_peri.dynamics.verlet import march
from warp_peri.errors import InputError
from warp_peri.files.checkpoint import agreed
from warp_peri.kernels import neighbours
from warp_peri.kernels.damage.motion import halves
from warp_peri.kernels.damage.sweeps import sweeps
from warp_peri.points.families import HORIZON_TOLERANCE
from warp_peri.points.unit_names import check_same
from warp_peri.ranks.halo import NodeHalo
from warp_peri.ranks.processes import build


def move(material: Any, problem: Any, options: dict[str, Any]) -> Motion:
    """Motion of a Cracked on ranks: see Cracked.moved; fields are those of this rank's nodes.
    Of an unbroken body: see dynamics.verlet.march.

    Raises InputError for anything but steps, and for bonds that break by energy.
    """
    piece, comm = problem.points, problem.points.comm
    if hasattr(problem, "b") and not isinstance(problem, Cracked):
        with agreed(comm):
            offered(material, "on", "move", MATERIAL)
            (options,) = taken(options, "move", march)
        return march(piece.operator(material), problem.b, problem.u, **options)
    with agreed(comm):
        if not isinstance(problem, Cracked) or "step" not in options:
            raise InputError("move: expected a Dirichlet or Cracked, and step=…, steps=… on ranks")
        offered(material, "density", "move", "a BrittleSolid")
        if material.by_energy or problem.pressure is not None:
            raise InputError(
                "move: expected bonds that break by their stretch, and no pressure, on ranks"
            )
        check_same(material.units, piece.units)
        material.linear.check_dimension(piece)
        how, begin, records, run = options_of_steps(options)
    model = material.model
    build(comm, *_kernels(piece.dimension, material.tension_only))
    felt = model.horizon * (1 + HORIZON_TOLERANCE) * (1 if model.lam == model.mu else 2)
    halo = NodeHalo(piece, felt)
    given: dict[str, Any] = {"load": problem.b, "held": problem.held, "u": problem.u}
    given |= {name: how.pop(name, None) for name in ("no_fail", "grip")}
    given["v"] = begin.pop("v", None)
    with agreed(comm):
        for name, values in given.items():
            if values is not None and len(np.asarray(values)) != len(piece.x):
                raise InputError(f"{name}: expected {len(piece.x)} nodes of this rank")
    here: dict[str, Any] = {
        name: None if v is None else halo.around(v) for name, v in given.items()
    }
    with agreed(comm):
        body = lattice_body(halo.x, piece.spacing, model.horizon)
        _check_straight(body)
        at_start = {name: here.pop(name) for name in ("u", "v")}
        moving = BreakingBody(material, body, **here, **how)
        state = moving.start(**at_start, cracks=problem.cracks, **begin)
    marching = CrackRun(moving, nodes=halo, **records)
    moving.operator.sweep_early(halo.is_own)
    moving.exchange = lambda u: halo.start(u.numpy())
    state = marching.march(state, **run)
    own = halo.own
    return Motion(
        marching.history.column("time"),
        moving.displacement(state)[own],
        moving.velocity(state)[own],
        marching.history.by_name(),
        Broken(moving.damage(state)[own], moving, state),
    )


def _check_straight(body: LatticeBody) -> None:
    if not np.array_equal(body.axes, np.eye(body.dimension)):
        raise InputError("points: expected a lattice along the axes on ranks, got a turned one")


def _kernels(dimension: int, tension_only: bool) -> list[Any]:
    made, steps = sweeps(dimension, bool(tension_only)), halves(dimension)
    return [neighbours.lattice_neighbours, made.state_based, steps.kick_and_drift]
