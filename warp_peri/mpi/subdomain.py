"""Nodes of one body, each owned by one rank, and problems on them: at rest, waves, breaking bonds.

A breaking rank steps its nodes and those of others within δ, 2δ with a dilatation, whose
displacement comes from their owners after each drift: bonds break here as they do there.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from itertools import count
from math import prod
from typing import Any

import numpy as np
from numpy import ndarray

from warp_peri.errors import InputError, InSpace, Shape, agreed, hold
from warp_peri.files.checkpoint import nodal_fingerprint, same
from warp_peri.fracture.body import lattice_body
from warp_peri.fracture.problems import Cracked, in_steps
from warp_peri.kernels import neighbours
from warp_peri.kernels.damage import halves, sweep
from warp_peri.mpi.linear import operator_on
from warp_peri.mpi.processes import Comm, Slabs, build, cut, exchange, inner, total, world
from warp_peri.points.arguments import (
    USUAL,
    ArrayMap,
    Options,
    Positive,
    Units,
    as_array,
    check_arguments,
    check_function,
    check_nodes,
    check_units,
    checked,
    checked_fields,
    is_piece,
    offered,
    plain,
    taken,
)
from warp_peri.points.families import HORIZON_TOLERANCE
from warp_peri.points.points import PointsLike, checked_axis, nodes_of, whole_numbers
from warp_peri.runtime import ranks_started
from warp_peri.solvers.motion import Motion, Recorder
from warp_peri.solvers.solution import CG, TOLERANCE, Solution, Solver, by_sample, refuse_solver
from warp_peri.solvers.systems import Inner
from warp_peri.solvers.verlet import march

SLAB, FEW = 8, 50_000
"""Least rows of a slab; nodes of a level that every rank can have, to which slabs can be halved."""
FIELDS = "load", "held", "grip", "no_fail", "u", "v"
"""Of a body that breaks, on nodes."""
NUMBERS = count(1)
"""Of bodies, which the ranks make together."""
_OF_A_WHOLE = "box", "outside", "is_open_lattice", "lattice", "rows"


@dataclass(frozen=True, eq=False)
class Subdomain(InSpace):
    """Nodes that this rank owns, on which its fields are.

    Attributes:
        comm: the ranks.
        x: positions [length], shape [n, d].
        interior: of these nodes, shape [n] bool, as of Points.
        spacing: of the lattice.
        number: of these nodes in the whole body, rising, shape [n].
        count: nodes of the whole body.
        grid: lattice steps from the corner of the whole body, shape [n, d].
        slabs: of the box around the whole body.
        units, axis: as of Points.
        which: number of the body among those that the ranks have made together; 0 of a copy of a
            piece with other parts, which no rank takes.
    """

    comm: Comm
    x: ndarray
    interior: ndarray
    spacing: float
    number: ndarray
    count: int
    grid: ndarray
    slabs: Slabs
    units: Units = USUAL
    axis: Any = None
    which: int = field(default=0, init=False)
    own, mark = slice(None), nodal_fingerprint
    """Of the nodes that belong to this rank: all; and what tells fields on them."""

    def numbered(self) -> Subdomain:
        """The piece as the next body that the ranks make together."""
        hold(self, which=next(NUMBERS))
        return self

    def sum(self, values: ndarray) -> ndarray:
        """Sum values [k, ...] over all ranks, shape [...], with the same bits on any number."""
        return total(self.comm, values)

    def solve(self, material: Any, problem: Any, solver: Solver, options: Options) -> Solution:
        """Solve a Dirichlet problem at rest; u and load are those of this rank's nodes. Raises
        InputError for other problems and materials, and as RowOperator."""
        alike(material, problem, options | {"solver": solver})
        operator = operator_on(material, self, options)
        with agreed(self.comm):
            taken(options, "solve")
            if not hasattr(problem, "u") or hasattr(problem, "cracks"):
                raise InputError("solve: expected a Dirichlet(points, b, u) on ranks")
            b, u = checked_fields(self, problem.b, problem.u)
            refuse_solver(solver, (CG,), "a linear body on ranks")
            if (kind := getattr(solver, "preconditioner", None)) not in (None, "multigrid"):
                raise InputError(f"preconditioner: expected multigrid on ranks, got {kind!r}")
        tolerance = TOLERANCE if solver is None else solver.tolerance  # type: ignore[union-attr]
        answer, right, records = np.where(self.interior[:, None], 0.0, u), operator.rhs(b), []
        fields = answer.reshape(-1, *self.x.shape)
        for one, load in zip(fields, right.reshape(len(fields), -1, self.dimension)):
            one[self.interior], record = operator.inverted(load - operator(one), tolerance)
            records.append(record)
        return by_sample(operator, answer, right, records, operator.method, operator.proven)

    def move(self, material: Any, problem: Any, options: Options) -> Motion:
        """Move a Cracked on ranks, as Cracked.moved, or an unbroken body, as solvers.verlet.march.
        Raises InputError for anything but steps, and for a pressure."""
        comm = self.comm
        alike(material, problem, options)
        if hasattr(problem, "b") and not isinstance(problem, Cracked):
            operator = operator_on(material, self, options)
            with agreed(comm):
                how, files = taken(options, "simulate", march, Recorder.__init__)
            return march(operator, problem.b, problem.u, **how | files)
        with agreed(comm):
            if not isinstance(problem, Cracked) or "step" not in options:
                raise InputError("simulate: expected a Dirichlet or Cracked with steps on ranks")
            offered(material, "density", "simulate", "a BrittleMaterial")
            if problem.pressure is not None:
                raise InputError("simulate: expected no pressure on ranks")
            material.own_nodes(self)
            how, begin, *_ = asked = problem.steps(options)
        model, d = material.model, self.dimension
        build(comm, neighbours.lattice_neighbours, sweep(d).sweep, halves(d).kick_and_drift)
        balls = 1 if model.lam == model.mu and not problem.corrected else 2
        halo = NodeHalo(self, balls * model.horizon * (1 + HORIZON_TOLERANCE))
        fields = [(of, name) for of in (how, begin) for name in FIELDS if of.get(name) is not None]
        with agreed(comm):
            for of, name in fields:
                kind = bool if name in ("held", "no_fail") else float
                of[name] = checked(name, of[name], kind, self.x.shape[: 2 - (name == "no_fail")])
        for of, name in fields:
            of[name] = halo.around(of[name])
        with agreed(comm):
            body = lattice_body(halo.x, self.spacing, model.horizon)
        return in_steps(material, body, asked, halo)

    @property
    def inner(self) -> Inner:
        """Scalar products and norms of fields [k, d] on nodes, over all ranks."""
        return inner(self.comm, lambda a, b: (a * b).sum(axis=1))

    def gather(self, values: ndarray) -> ndarray:
        """Gather values [n, ...] of all pieces on every rank, in the order of the whole body;
        InputError on all for a field that is none, or of another kind on some."""
        with agreed(self.comm):
            values = _nodal(self, values)
        same(self.comm, values=(values.shape[1:], values.dtype))
        whole = np.empty((self.count, *values.shape[1:]), values.dtype)
        for number, part in self.comm.allgather((self.number, values)):
            whole[number] = part
        return whole

    def __getattr__(self, name: str) -> Any:
        if name in _OF_A_WHOLE:
            raise InputError("points: expected Points, got a piece of some, which are on ranks")
        raise AttributeError(name)


class NodeHalo:
    """Nodes of a piece and of other ranks in the box around it, in the order of the whole body.

    Sums over neighbours then have the same bits on any rank. The m nodes here have rising numbers
    `number` in the whole body and positions `x` [m, d]; `own` are the places of the piece's own
    [n]; count, sum and gather are the piece's.
    """

    mark = nodal_fingerprint

    def __init__(self, piece: Subdomain, reach: float) -> None:
        self.piece, self.count = piece, piece.count
        self.sum, self.gather = piece.sum, piece.gather
        self.comm, reach = piece.comm, reach + 1e-6 * piece.spacing
        boxes = self.comm.allgather((piece.x.min(axis=0) - reach, piece.x.max(axis=0) + reach))
        given = [
            np.flatnonzero(((piece.x >= low) & (piece.x <= high)).all(axis=1))
            for low, high in boxes
        ]
        given[self.comm.rank] = given[self.comm.rank][:0]
        taken = self.comm.alltoall([(piece.number[nodes], piece.x[nodes]) for nodes in given])
        number = np.concatenate([piece.number, *[numbers for numbers, _ in taken]])
        order = np.argsort(number)
        self.number = number[order]
        self.x = np.concatenate([piece.x, *[x for _, x in taken]])[order]
        places = [np.searchsorted(self.number, n) for n in (piece.number, *[n for n, _ in taken])]
        self.own = places[0]
        self._give = [(r, self.own[nodes]) for r, nodes in enumerate(given) if len(nodes)]
        self._take = [(r, nodes) for r, nodes in enumerate(places[1:]) if len(nodes)]

    def exchange(self, field: ndarray) -> None:
        """Fill others' nodes in a field [m or more, ...] from their owners."""
        exchange(self.comm, field, field, self._give, self._take)

    def around(self, values: ndarray) -> ndarray:
        """Extend values [n, ...] of the piece's own nodes to all nodes here, [m, ...]."""
        values = np.asarray(values)
        here = np.zeros((len(self.number), *values.shape[1:]), values.dtype)
        here[self.own] = values
        self.exchange(here)
        return here


def lattice(
    shape: Shape,
    spacing: Positive,
    interior: ArrayMap,
    *,
    origin: Any = 0.0,
    units: Units = USUAL,
    axis: float | None = None,
) -> Any:
    """This rank's Subdomain of a box of lattice nodes, of which no rank ever holds the whole.

    Args:
        shape: nodes along each axis; the ranks share slabs of the first.
        spacing: h [length].
        interior: which nodes are unknown, a function of positions [n, d] to bool [n].
        origin: position of the first node.
        units, axis: as of Points.

    Raises InputError for values of another kind, more ranks than slabs, and no interior node.
    """
    comm = world()
    with agreed(comm):
        shape = whole_numbers("shape", shape)
        if len(shape) not in (2, 3):
            raise InputError(f"shape: expected two or three counts of nodes, got {list(shape)}")
        spacing = check_arguments(lattice, {"spacing": spacing})["spacing"]
        if np.shape(origin := checked("origin", origin)) not in ((), (len(shape),)):
            raise InputError(f"origin: expected {len(shape)} coordinates, got {len(origin)}")
        check_nodes("shape", shape)
        axis = checked_axis(axis, len(shape))
        check_function("interior", interior, "positions")
    same(comm, shape=shape, spacing=spacing, origin=origin, units=units, axis=axis)
    slabs = cut(comm, shape, _rows(shape))
    grid = np.indices(slabs.box(comm.rank), dtype=np.int32).reshape(len(shape), -1).T.copy()
    grid[:, 0] += slabs.own(comm.rank).start
    x = origin + spacing * grid
    number = np.asarray(np.ravel_multi_index(tuple(grid.T), shape))
    with agreed(comm):
        inside = checked("interior", interior(x.copy()), bool, (len(x),))
        check_units(units)
    if not any(comm.allgather(inside.any())):
        raise InputError("interior: expected at least one interior node, got none")
    parts = x, inside, float(spacing), number, prod(shape), grid, slabs, units, axis
    return Subdomain(comm, *parts).numbered()


def partition(points: PointsLike) -> Any:
    """This rank's piece of points that every rank has, some rows; all without mpiexec. Raises
    InputError unless they are a lattice along the axes, without a box, and for too many ranks."""
    if not ranks_started():
        return nodes_of(points)
    comm = world()
    with agreed(comm):
        points = nodes_of(points)
    same(comm, points=points)
    if not points.is_open_lattice:
        raise InputError("points: expected a lattice that has no box and none outside, for ranks")
    grid, axes = points.lattice
    if (axes != np.eye(points.dimension)).any():
        raise InputError("points: expected a lattice along the axes on ranks, got a turned one")
    if twice := len(grid) - len(np.unique(grid, axis=0)):
        raise InputError(f"points: expected each node once, got {twice} duplicates")
    shape = tuple((grid.max(axis=0) + 1).tolist())
    slabs = cut(comm, shape, _rows(shape))
    rows = slabs.own(comm.rank)
    own = np.flatnonzero((grid[:, 0] >= rows.start) & (grid[:, 0] < rows.stop))
    if not all(comm.allgather(len(own))):
        raise InputError(f"points: {len(grid)} nodes are too few for {comm.size} ranks")
    nodes = points.x[own], points.interior[own], points.spacing, own, len(grid), grid[own]
    return Subdomain(comm, *nodes, slabs, points.units, points.axis).numbered()


def gather(points: Any, values: ndarray) -> ndarray:
    """Gather values of a piece's nodes on every rank; those of all nodes of Points are as they are.
    InputError as Subdomain.gather."""
    if is_piece(points):
        return points.gather(values)  # type: ignore[no-any-return]
    return _nodal(nodes_of(points), values)


def _nodal(nodes: Any, given: Any) -> ndarray:
    """Check values [n, ...] of the nodes, of numbers or truth values."""
    values = plain("values", given, None, "biufc")
    if values.shape[:1] != nodes.x.shape[:1]:
        raise InputError(f"values: expected {len(nodes.x)} rows, got shape {values.shape}")
    return values


def _rows(shape: Shape) -> int:
    """Rows of a slab for a box of this shape, a power of two, on any number of ranks."""
    rows = SLAB
    while np.prod(shape, dtype=float) > FEW * rows ** len(shape):
        rows *= 2
    return rows


NODAL = "points", "b", "u", "free", "v", "no_fail", "grip"
"""Of what is given to a verb those that each rank has for its own nodes."""
LOCAL = "record", "progress"
"""Those that any rank may have or not: no other waits for them."""


def alike(material: Any, problem: Any, options: Options) -> None:
    """Raise InputError on all ranks if they were given different steps, materials or cracks."""
    comm, which = problem.points.comm, problem.points.which
    with agreed(comm):
        if not which:
            raise InputError("points: expected a piece as it was made, got a copy with other parts")
        asked = {f.name: getattr(problem, f.name) for f in fields(problem)} | dict(options)
        given = {name: asked.pop(name, None) for name in (*NODAL, *LOCAL)}
        there = [name for name in NODAL if given[name] is not None]
        stacked = [as_array(n, given[n]).shape[:-2] for n in ("b", "u") if n in there]
    kind = type(problem).__name__
    asked |= {"points": which, "material": material, "problem": (kind, stacked, there)}
    same(comm, **asked)
