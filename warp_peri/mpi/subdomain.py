"""Nodes of one body, each owned by one rank: tiles of a lattice, or parts by bisection."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.files.checkpoint import agreed, same
from warp_peri.mpi import problems
from warp_peri.mpi.halo import Tiles, cut
from warp_peri.mpi.linear import operator_on
from warp_peri.mpi.processes import Comm, fingerprint, inner, total, world
from warp_peri.points.points import LATTICE_TOLERANCE, Points
from warp_peri.points.unit_names import USUAL, Units, check_units
from warp_peri.runtime import ranks_started
from warp_peri.solvers.conjugate_gradients import Inner

SLABS, SMALLEST, LARGEST = 8, 8, 128
"""Slabs of rows that a box is cut to at least, where they have between so many rows each."""
TILES, LONGEST, TILED = 4, {2: 256, 3: 48}, {2: 768, 3: 64}
"""In the plane and in space: tiles along an axis at least, most nodes of each, and nodes of a box
from which there are tiles, not slabs: the filter reaches 32 and 12 nodes beyond a tile."""
FEW = 50_000
"""Nodes of a level of multigrid that every rank can have, to which tiles are halved if they can."""
READ = 100_000
"""Nodes that are read from a file at a time: between those of a tile lie those of others."""
_OF_A_WHOLE = ("box", "outside", "is_open_lattice")


@dataclass(frozen=True, eq=False)
class Subdomain:
    """The nodes that this rank owns. Fields that go with it are on these.

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
        """Which of these nodes are this rank's own: all."""
        return slice(None)

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return int(self.x.shape[1])

    def sum(self, values: np.ndarray) -> np.ndarray:
        """Of values [k, ...] over all ranks, shape [...], with the same bits on any number."""
        return total(self.comm, values)

    def mark(self, *parts: Any) -> str:
        """A fingerprint of arrays [n, ...] on these nodes, and of other values as printed."""
        arrays = [part for part in parts if isinstance(part, np.ndarray)]
        others = [part for part in parts if not isinstance(part, np.ndarray)]
        return fingerprint(self.comm, self.number, *arrays) + "".join(map(repr, others))

    def dot(self, a: np.ndarray, b: np.ndarray) -> float:
        """Scalar product of vectors [n, d] over all ranks, with the same bits on any number."""
        return float(total(self.comm, (a * b).sum(axis=1)))

    def operator(self, material: Any) -> Any:
        """A material on these nodes, as linear.operator_on."""
        return operator_on(material, self)

    def solve(self, material: Any, problem: Any, solver: Any, options: Any) -> Any:
        """A problem on these nodes at rest, as problems.solve."""
        return problems.solve(material, problem, solver, options)

    def move(self, material: Any, problem: Any, options: Any) -> Any:
        """A problem on these nodes in motion, as problems.move."""
        return problems.move(material, problem, options)

    @property
    def inner(self) -> Inner:
        """How fields [k, d] on some of the nodes are measured, over all ranks."""
        return inner(self.comm, lambda a, b: (a * b).sum(axis=1))

    def gather(self, values: np.ndarray) -> np.ndarray:
        """Values [n, ...] of all pieces, on every rank, in the order of the whole body."""
        whole = np.empty((self.count, *np.shape(values)[1:]), np.asarray(values).dtype)
        for number, part in self.comm.allgather((self.number, np.asarray(values))):
            whole[number] = part
        return whole

    def read(self, path: str | os.PathLike[str], name: str) -> np.ndarray:
        """Of an array [N, ...] of all nodes in an HDF5 file those of this rank, [n, ...].

        Raises InputError for a file without it, or an array of another length.
        """
        with agreed(self.comm):
            values = read_rows(path, name, self.number, self.count)
        return values

    def __getattr__(self, name: str) -> Any:
        if name in _OF_A_WHOLE:
            raise InputError("points: expected Points, got a piece of some, which are on ranks")
        raise AttributeError(name)


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
        interior: which nodes are unknown, of positions [n, d] as bool [n]; or an HDF5 file whose
            `interior` says it of all nodes, [N], of which a rank reads its own.
        origin: position of the first node.
        block: nodes of a tile along the first axes, which stay together, even numbers; a number
            alone is of whole rows.
        units, axis: as of Points.

    Raises InputError for more ranks than tiles, a number of ranks that is no grid of them, and no
    interior node anywhere.
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
    """Rows of rising numbers of an array of `count` in an HDF5 file; some READ at a time, with
    those that lie between.

    Raises InputError for a file without the array, and one of another length.
    """
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

    Args:
        points: a lattice along the axes, without a box, the same on every rank.
        by: "rows" of the lattice, or "bisection" of boxes at the middle of their longest side.

    Raises InputError for other points, for more ranks than there are rows in blocks, or nodes.
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
        raise InputError("points: expected a lattice along the axes for ranks, got a turned one")
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
    """Values on all nodes, on every rank: of a piece gathered, of Points as they are."""
    return values if isinstance(points, Points) else np.asarray(points.gather(values))


def _slab(rows: int) -> tuple[int]:
    """Rows of a slab of a box with so many, a power of two."""
    wanted = 1 << int(np.log2(max(rows / SLABS, 1)))
    return (min(max(wanted, SMALLEST), LARGEST),)


def _usual(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Nodes of a tile along the axes that are cut, of a box of this shape."""
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
