"""Nodes of one body, each owned by one rank, and problems on them: at rest, waves, breaking bonds.

A breaking rank steps its nodes and those of others within δ, 2δ with a dilatation, whose
displacement comes from their owners after each drift: bonds break here as they do there.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.files.checkpoint import RunFile, agreed, fingerprint, same
from warp_peri.fracture.body import lattice_body
from warp_peri.fracture.dynamics import BreakingBody, CrackRun
from warp_peri.fracture.problems import Cracked, options_of_steps
from warp_peri.kernels import neighbours
from warp_peri.kernels.damage import halves, sweep
from warp_peri.mpi.linear import operator_on
from warp_peri.mpi.processes import (
    Comm,
    Tiles,
    build,
    cut,
    exchange,
    inner,
    nodal_fingerprint,
    total,
    world,
)
from warp_peri.points.arguments import as_array, checked_fields
from warp_peri.points.families import HORIZON_TOLERANCE
from warp_peri.points.points import LATTICE_TOLERANCE, Points
from warp_peri.points.unit_names import USUAL, Units, check_same, check_units
from warp_peri.protocols import MATERIAL, offered, taken
from warp_peri.runtime import ranks_started
from warp_peri.solvers.motion import Motion, Recorder
from warp_peri.solvers.solution import CG, TOLERANCE, Solution, Solver, by_sample, refuse_solver
from warp_peri.solvers.systems import Inner, SolveRecord, norm
from warp_peri.solvers.verlet import march

STAGE = 1e-3
"""Of a residual, after which a linear solve with a checkpoint writes it."""
SLABS, SMALLEST, LARGEST = 8, 8, 128
"""Slabs of rows that a box is cut to at least, where they have between so many rows each."""
TILES, LONGEST, TILED = 4, {2: 256, 3: 48}, {2: 768, 3: 64}
"""In the plane and in space: tiles along an axis at least, most nodes of each, and nodes of a box
from which there are tiles, not slabs: the filter reaches 32 and 12 nodes beyond a tile."""
FEW = 50_000
"""Nodes of a level of multigrid that every rank can have, to which tiles are halved if they can."""
READ = 100_000
"""Nodes that are read from a file at a time: between those of a tile lie those of others."""
TURNED = "points: expected a lattice along the axes on ranks, got a turned one"
_OF_A_WHOLE = ("box", "outside", "is_open_lattice")


@dataclass(frozen=True, eq=False)
class Subdomain:
    """Nodes that this rank owns, on which its fields are.

    Attributes:
        comm: the ranks.
        x: positions [length], shape [n, d].
        interior: of these nodes, shape [n] bool, as of Points.
        spacing: of the lattice.
        number: of these nodes in the whole body, rising, shape [n].
        count: nodes of the whole body.
        grid: lattice steps from the corner of the whole body, shape [n, d].
        tiles: of a box in tiles; None of other parts.
        units, axis: as of Points.
    """

    comm: Comm
    x: np.ndarray
    interior: np.ndarray
    spacing: float
    number: np.ndarray
    count: int
    grid: np.ndarray
    tiles: Tiles | None
    units: Units = USUAL
    axis: Any = None

    @property
    def own(self) -> slice:
        """Slice of the nodes that belong to this rank: all."""
        return slice(None)

    @property
    def dimension(self) -> int:
        """Dimension of space, 2 or 3."""
        return int(self.x.shape[1])

    def sum(self, values: np.ndarray) -> np.ndarray:
        """Sum values [k, ...] over all ranks, shape [...], with the same bits on any number."""
        return total(self.comm, values)

    def mark(self, *parts: Any) -> str:
        """Fingerprint of arrays [n, ...] on these nodes, and of other values as printed."""
        arrays = [part for part in parts if isinstance(part, np.ndarray)]
        others = [part for part in parts if not isinstance(part, np.ndarray)]
        return nodal_fingerprint(self.comm, self.number, *arrays) + "".join(map(repr, others))

    def solve(
        self, material: Any, problem: Any, solver: Solver, options: dict[str, Any]
    ) -> Solution:
        """Solve a Dirichlet problem at rest; u and load are those of this rank's nodes.

        The option checkpoint=PATH writes iterates, from which a later solve goes on, on any number
        of ranks. Raises InputError for other problems and materials, and as RowOperator.
        """
        alike(material, problem, options | {"solver": solver})
        (asked,) = taken(options, "solve", _asked)
        path = _asked(**asked)
        with agreed(self.comm):
            if not hasattr(problem, "u") or hasattr(problem, "cracks"):
                raise InputError("solve: expected a Dirichlet(points, b, u) on ranks")
            offered(material, "on", "solve", MATERIAL)
            b, u = checked_fields(self, problem.b, problem.u)
            refuse_solver(solver, (CG,), "a linear body on ranks")
            if (kind := getattr(solver, "preconditioner", None)) not in (None, "multigrid"):
                raise InputError(f"preconditioner: expected multigrid on ranks, got {kind!r}")
        operator = operator_on(material, self)
        tolerance = TOLERANCE if solver is None else solver.tolerance  # type: ignore[union-attr]
        inside, flat = self.interior, [field.reshape(-1, *self.x.shape) for field in (b, u)]
        file, mark, mask = None, "", inside[:, None]
        if path is not None:
            if len(flat[0]) > 1:
                raise InputError(f"checkpoint: expected one load, got {len(flat[0])}")
            file = RunFile(path, "warp_peri.rest", self)
            given = np.where(mask, flat[0][0], 0.0), np.where(mask, 0.0, flat[1][0]), mask, self.x
            mark = self.mark(*given, fingerprint(material))
        answers, records = np.where(mask, 0.0, flat[1]), list[SolveRecord]()
        for field, load, held in zip(answers, *flat):
            field[:], record = solved(operator, load, held, tolerance, file, mark)
            records.append(record)
        right = operator.rhs(b).reshape(*b.shape[:-2], -1, b.shape[-1])
        counts, how = [record.iterations for record in records], (operator.method, operator.proven)
        return by_sample(operator, answers.reshape(u.shape), right, records, counts, *how)

    def move(self, material: Any, problem: Any, options: dict[str, Any]) -> Motion:
        """Move a Cracked on ranks, as Cracked.moved, or an unbroken body, as solvers.verlet.march.
        Raises InputError for anything but steps, and for a pressure."""
        comm = self.comm
        alike(material, problem, options)
        if hasattr(problem, "b") and not isinstance(problem, Cracked):
            with agreed(comm):
                offered(material, "on", "simulate", MATERIAL)
                how, files = taken(options, "simulate", march, Recorder.__init__)
            return march(operator_on(material, self), problem.b, problem.u, **how | files)
        with agreed(comm):
            if not isinstance(problem, Cracked) or "step" not in options:
                raise InputError("simulate: expected a Dirichlet or Cracked with steps on ranks")
            offered(material, "density", "simulate", "a BrittleMaterial")
            if problem.pressure is not None:
                raise InputError("simulate: expected no pressure on ranks")
            check_same(material.units, self.units)
            material.linear.check_dimension(self)
            how, begin, files, records, run = options_of_steps(options)
        model = material.model
        d = self.dimension
        build(comm, neighbours.lattice_neighbours, sweep(d).sweep, halves(d).kick_and_drift)
        balls = 1 if model.lam == model.mu and not problem.corrected else 2
        felt = balls * model.horizon * (1 + HORIZON_TOLERANCE)
        halo = NodeHalo(self, felt)
        given: dict[str, Any] = {"load": problem.b, "held": problem.held, "u": problem.u}
        given |= {name: how.pop(name, None) for name in ("no_fail", "grip")}
        given = {k: v for k, v in (given | {"v": begin.pop("v", None)}).items() if v is not None}
        with agreed(comm):
            for name, values in given.items():
                if len(np.asarray(values)) != len(self.x):
                    raise InputError(f"{name}: expected {len(self.x)} nodes of this rank")
        here: dict[str, Any] = {name: halo.around(values) for name, values in given.items()}
        with agreed(comm):
            body = lattice_body(halo.x, self.spacing, model.horizon)
            if not np.array_equal(body.axes, np.eye(d)):
                raise InputError("points: expected a lattice along the axes on ranks")
            at_start = {name: here.pop(name, None) for name in ("u", "v")}
            moving = BreakingBody(material, body, corrected=problem.corrected, **here, **how)
            state = moving.start(**at_start, cracks=problem.cracks, **begin)
        marching = CrackRun(moving, nodes=halo, **records | files)
        moving.exchange = halo.exchange
        return marching.motion(marching.march(state, **run))

    @property
    def inner(self) -> Inner:
        """Scalar products and norms of fields [k, d] on nodes, over all ranks."""
        return inner(self.comm, lambda a, b: (a * b).sum(axis=1))

    def gather(self, values: np.ndarray) -> np.ndarray:
        """Gather values [n, ...] of all pieces on every rank, in the order of the whole body."""
        whole = np.empty((self.count, *np.shape(values)[1:]), np.asarray(values).dtype)
        for number, part in self.comm.allgather((self.number, np.asarray(values))):
            whole[number] = part
        return whole

    def read(self, path: str | os.PathLike[str], name: str) -> np.ndarray:
        """Read this rank's rows [n, ...] of an array [N, ...] in an HDF5 file, as read_rows."""
        with agreed(self.comm):
            return read_rows(path, name, self.number, self.count)

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

    def mark(self, *parts: Any) -> str:
        """Fingerprint, as Subdomain.mark, of arrays [m or more, ...] on the nodes here."""
        own = [part[self.own] if isinstance(part, np.ndarray) else part for part in parts]
        return self.piece.mark(*own)

    def exchange(self, field: np.ndarray) -> None:
        """Fill others' nodes in a field [m or more, ...] from their owners."""
        exchange(self.comm, field, field, self._give, self._take)()

    def around(self, values: np.ndarray) -> np.ndarray:
        """Extend values [n, ...] of the piece's own nodes to all nodes here, [m, ...]."""
        values = np.asarray(values)
        here = np.zeros((len(self.number), *values.shape[1:]), values.dtype)
        here[self.own] = values
        self.exchange(here)
        return here


def lattice(
    shape: tuple[int, ...],
    spacing: float,
    interior: Callable[[np.ndarray], np.ndarray] | str | os.PathLike[str],
    *,
    origin: Any = 0.0,
    block: int | tuple[int, ...] | None = None,
    units: Units = USUAL,
    axis: float | None = None,
) -> Any:
    """This rank's Subdomain of a box of lattice nodes, of which no rank ever holds the whole.

    Args:
        shape: nodes along each axis; the ranks share tiles of the first two.
        spacing: h [length].
        interior: which nodes are unknown, a function of positions [n, d] to bool [n]; or an HDF5
            file whose `interior` [N] says it.
        origin: position of the first node.
        block: even numbers of nodes of a tile along the first axes; one number is of whole rows.
        units, axis: as of Points.

    Raises InputError for ranks more than tiles or that form no grid, and for no interior node.
    """
    comm = world()
    same(comm, shape=shape, spacing=spacing, origin=origin, block=block, units=units, axis=axis)
    sizes = _usual(shape) if block is None else tuple(np.atleast_1d(np.array(block)).tolist())
    tiles = cut(comm, shape, sizes)
    grid = np.indices(tiles.box(comm.rank), dtype=np.int32).reshape(len(shape), -1).T
    grid = np.ascontiguousarray(grid + tiles.corner(comm.rank))
    x = np.asarray(origin) + spacing * grid
    number = np.asarray(np.ravel_multi_index(tuple(grid.T), shape))
    count = int(np.prod(shape))
    with agreed(comm):
        if callable(interior):
            inside = np.asarray(interior(x))
        else:
            inside = read_rows(interior, "interior", number, count)
        if inside.shape != (len(x),) or inside.dtype != bool:
            raise InputError(f"interior: expected bool of shape [{len(x)}], got {inside.shape}")
        check_units(units)
    if not any(comm.allgather(bool(inside.any()))):
        raise InputError("interior: expected at least one interior node, got none")
    return Subdomain(comm, x, inside, float(spacing), number, count, grid, tiles, units, axis)


def read_rows(
    path: str | os.PathLike[str], name: str, number: np.ndarray, count: int
) -> np.ndarray:
    """Read rows, of rising numbers, of an array of length `count` in an HDF5 file, READ at a time.
    Raises InputError for a file without the array, and another length."""
    import h5py

    try:
        with h5py.File(path) as file:
            array = file[name]
            length = len(array)
            if length == count:
                parts = np.array_split(number, len(number) // READ + 1)
                found = [array[n[0] : n[-1] + 1][n - n[0]] for n in parts if len(n)]
                return np.concatenate(found)
    except (OSError, KeyError, TypeError) as error:
        raise InputError(f"{path}: expected an HDF5 file with {name!r} ({error})") from None
    raise InputError(f"{path}: expected {count} rows of {name!r}, got {length}")


def partition(points: Points, by: str = "rows") -> Any:
    """This rank's piece of points that every rank has; the points themselves without mpiexec.

    Of a lattice along the axes, without a box; by "rows" of it, or "bisection" of boxes at the
    middle of their longest side. Raises InputError for other points, and too many ranks.
    """
    if not ranks_started():
        return points
    comm = world()
    same(comm, points=points, by=by)
    if by not in ("rows", "bisection"):
        raise InputError(f"by: expected rows or bisection, got {by!r}")
    if not points.is_open_lattice:
        raise InputError("points: expected a lattice that has no box and none outside, for ranks")
    place = (points.x - points.x.min(axis=0)) / points.spacing
    grid = np.rint(place).astype(np.int32)
    if np.abs(place - grid).max() > LATTICE_TOLERANCE:
        raise InputError(TURNED)
    if (twice := len(grid) - len(np.unique(grid, axis=0))) > 0:
        raise InputError(f"points: expected each node once, got {twice} duplicates")
    tiles = None
    if by == "rows":
        shape = tuple((grid.max(axis=0) + 1).tolist())
        tiles = cut(comm, shape, _slab(shape[0]))
        (rows,) = tiles.own(comm.rank)
        own = np.flatnonzero((grid[:, 0] >= rows.start) & (grid[:, 0] < rows.stop))
    else:
        own = np.sort(_bisected(grid, np.arange(len(grid)), comm.size)[comm.rank])
    if min(comm.allgather(len(own))) == 0:
        raise InputError(f"points: {len(grid)} nodes are too few for {comm.size} ranks")
    parts = points.x[own], points.interior[own], points.spacing
    return Subdomain(comm, *parts, own, len(grid), grid[own], tiles, points.units, points.axis)


def gather(points: Any, values: np.ndarray) -> np.ndarray:
    """Gather values of a piece's nodes on every rank; values on Points stay as they are."""
    return values if isinstance(points, Points) else np.asarray(points.gather(values))


def _slab(rows: int) -> tuple[int]:
    """Rows of a slab, a power of two, for a box of so many rows."""
    wanted = 1 << int(np.log2(max(rows / SLABS, 1)))
    return (min(max(wanted, SMALLEST), LARGEST),)


def _usual(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Default tile size along the axes that are cut, for a box of this shape."""
    d, unit = len(shape), 4  # two levels of multigrid at least
    if min(shape[:2]) < TILED[d]:
        return _slab(shape[0])
    while np.prod(shape) > FEW * unit**d and unit < LONGEST[d] // 3:
        unit *= 2
    sides = (n / max(-(-n // LONGEST[d]), TILES) for n in shape[:2])
    return tuple(unit * int(np.ceil(side / unit)) for side in sides)


def _bisected(grid: np.ndarray, nodes: np.ndarray, parts: int) -> list[np.ndarray]:
    """Nodes cut in parts of equal size, again and again across the longest side (Berger, 1987)."""
    if parts == 1:
        return [nodes]
    there = grid[nodes]
    axis = int(np.ptp(there, axis=0).argmax())
    order = nodes[np.lexsort((nodes, there[:, axis]))]
    few = parts // 2
    cut = len(order) * few // parts
    return _bisected(grid, order[:cut], few) + _bisected(grid, order[cut:], parts - few)


def _asked(*, checkpoint: str | os.PathLike[str] | None = None) -> Any:
    """Options of a solve on ranks: the file of a checkpoint."""
    return checkpoint


NODAL = ("points", "b", "u", "free", "v", "no_fail", "grip", "record")
"""Of what is given to a verb those that each rank has for its own nodes."""


def alike(material: Any, problem: Any, options: Mapping[str, Any]) -> None:
    """Raise InputError on all ranks if they were given different steps, materials or cracks."""
    comm = problem.points.comm
    with agreed(comm):
        asked = {f.name: getattr(problem, f.name) for f in fields(problem)} | dict(options)
        given = {name: asked.pop(name, None) for name in NODAL}
        there = [n for n, one in given.items() if one is not None and n != "record"]
        stacked = [as_array(n, given[n]).shape[:-2] for n in ("b", "u") if n in there]
    kind = type(problem).__name__
    same(comm, material=material, problem=(kind, stacked, there), **asked)


def solved(
    operator: Any, b: np.ndarray, u: np.ndarray, tolerance: float, file: RunFile | None, mark: str
) -> tuple[np.ndarray, SolveRecord]:
    """Solve a linear operator for u [n, d] with load b on the interior, u given elsewhere.

    With a file, of this problem by its `mark`, the solve goes on from what it holds, and writes
    each time that the residual falls by STAGE. All ranks come here.
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
                f"tolerance: expected more than rounding, {last / size:.1e}, got {tolerance:.1e}"
            )
        last = left
        more, part = operator.inverted(rest, max(tolerance * size / left, STAGE))
        field[inside] += more
        record.iterations += part.iterations
        file.write({"u": field}, {"mark": mark})
    record.residual = left / size if size > 0 else 0.0
    return field, record
