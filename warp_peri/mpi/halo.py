"""What a rank feels of others' nodes: a box of lattice nodes in tiles, and lists of nodes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.mpi.processes import Comm

if TYPE_CHECKING:
    from warp_peri.mpi.subdomain import Subdomain


@dataclass(frozen=True, eq=False)
class Tiles:
    """A box of lattice nodes in tiles along its first axes, owned by a grid of ranks.

    What is computed tile by tile has the same bits on any number of ranks, and on any grid of them.

    Attributes:
        shape: nodes of the box along the axes.
        block: nodes of a tile along the axes that are cut; of slabs of rows that is one.
        starts: along each of these the first node of each rank of the grid, and the number of
            nodes, shape [p + 1].
    """

    shape: tuple[int, ...]
    block: tuple[int, ...]
    starts: tuple[np.ndarray, ...]

    @property
    def grid(self) -> tuple[int, ...]:
        """Ranks along the axes that are cut."""
        return tuple(len(starts) - 1 for starts in self.starts)

    def at(self, rank: int) -> tuple[int, ...]:
        """Where a rank lies in the grid."""
        return tuple(int(n) for n in np.unravel_index(rank, self.grid))

    def own(self, rank: int) -> tuple[slice, ...]:
        """The nodes of a rank along the axes that are cut."""
        return tuple(slice(int(s[i]), int(s[i + 1])) for s, i in zip(self.starts, self.at(rank)))

    def box(self, rank: int) -> tuple[int, ...]:
        """Nodes of a rank along all axes."""
        own = self.own(rank)
        return (*(part.stop - part.start for part in own), *self.shape[len(own) :])

    def corner(self, rank: int) -> np.ndarray:
        """The first node of a rank, shape [d]."""
        first = [part.start for part in self.own(rank)]
        return np.array(first + [0] * (len(self.shape) - len(first)), np.int32)

    def parts(self, box: tuple[int, ...]) -> list[tuple[slice, ...]]:
        """The tiles of a rank with so many nodes, from its own first node."""
        along = [
            [slice(first, min(first + size, count)) for first in range(0, count, size)]
            for size, count in zip(self.block, box)
        ]
        return list(itertools.product(*along))

    def everywhere(self) -> Tiles:
        """The same, cut along all axes, into one part along those that are not."""
        rest = self.shape[len(self.block) :]
        ends = tuple(np.array([0, n]) for n in rest)
        return replace(self, block=self.block + rest, starts=self.starts + ends)

    def coarser(self) -> Tiles:
        """Every second node along each axis, from the second on."""
        return replace(
            self,
            shape=tuple(n // 2 for n in self.shape),
            block=tuple(n // 2 for n in self.block),
            starts=tuple(starts // 2 for starts in self.starts),
        )


def cut(comm: Comm, shape: tuple[int, ...], block: tuple[int, ...]) -> Tiles:
    """A box of so many nodes along each axis cut into tiles for the ranks there are: who has most
    has as few as can be, then the nodes along the cuts are as few as can be.

    `block` are the nodes of a tile along the first axes, even numbers. Raises InputError for other
    tiles, and ranks that are more than tiles or form no grid of them.
    """
    fits = 0 < len(block) <= len(shape) and all(isinstance(n, int) for n in block)
    if not fits or any(n < 2 or n % 2 for n in block):
        raise InputError(f"block: expected even numbers, at most {len(shape)}, got {block}")
    while len(block) > 1 and block[-1] >= shape[len(block) - 1]:
        block = block[:-1]  # as wide as the box: not cut there
    counts = tuple(-(-n // size) for n, size in zip(shape, block))
    if comm.size > math.prod(counts):
        nodes, tile = (" × ".join(map(str, sizes)) for sizes in (shape, block))
        raise InputError(
            f"ranks: expected at most {math.prod(counts)} for {nodes} nodes in tiles of {tile}, "
            f"got {comm.size}"
        )
    found = _grid(comm.size, shape, block, counts)
    if found is None:
        fewer = (n for n in range(comm.size, 0, -1) if _grid(n, shape, block, counts))
        raise InputError(
            f"ranks: expected a product of numbers up to {' and '.join(map(str, counts))}, the "
            f"tiles along the axes, got {comm.size}; {next(fewer)} would do"
        )
    starts = tuple(
        np.minimum(size * (count * np.arange(p + 1) // p), n)
        for n, size, count, p in zip(shape, block, counts, found)
    )
    return Tiles(tuple(int(n) for n in shape), tuple(int(n) for n in block), starts)


def _grid(
    ranks: int, shape: tuple[int, ...], block: tuple[int, ...], counts: tuple[int, ...]
) -> tuple[int, ...] | None:
    """The best grid of so many ranks; None where no grid has a tile for each."""
    factors = [n for n in range(ranks, 0, -1) if ranks % n == 0]  # along the first axis at best
    grids = [
        grid
        for grid in itertools.product(*[[n for n in factors if n <= count] for count in counts])
        if math.prod(grid) == ranks
    ]

    def cost(grid: tuple[int, ...]) -> tuple[int, float]:
        most = math.prod(-(-count // p) for count, p in zip(counts, grid))
        return most, sum((p - 1) / n for p, n in zip(grid, shape))  # nodes of the cuts, over all

    return min(grids, key=cost, default=None)


class Halo:
    """So many nodes of other ranks around those of this one, with the corners, along the axes that
    are cut; beyond the box zeros. More than a neighbour has come from the next ones."""

    def __init__(self, comm: Comm, tiles: Tiles, width: int) -> None:
        self.comm, self.width = comm, width
        own = tiles.own(comm.rank)
        self._inside = tuple(slice(width, width + part.stop - part.start) for part in own)
        others = [(r, tiles.own(r)) for r in range(comm.size) if r != comm.rank]
        given = [(r, _shared(own, theirs, width)) for r, theirs in others]
        taken = [(r, _shared(theirs, own, width)) for r, theirs in others]
        self._give = [(r, (slice(None), *_from(box, own, 0))) for r, box in given if box]
        self._take = [(r, (slice(None), *_from(box, own, width))) for r, box in taken if box]

    def start(self, field: np.ndarray) -> tuple[np.ndarray, Callable[[], None]]:
        """A field [c, *box] among zeros, and what waits for the nodes of others and puts them
        there."""
        w, cuts = self.width, len(self._inside)
        sides = (n + 2 * w * (axis < cuts) for axis, n in enumerate(field.shape[1:]))
        wide = np.zeros((len(field), *sides), field.dtype)
        wide[:, *self._inside] = field
        return wide, _exchange(self.comm, field, wide, self._give, self._take, w)

    def __call__(self, field: np.ndarray) -> np.ndarray:
        """The field with the nodes of others around it."""
        wide, finish = self.start(field)
        finish()
        return wide


def _exchange(
    comm: Comm, field: np.ndarray, wide: np.ndarray, give: Any, take: Any, tag: int = 0
) -> Callable[[], None]:
    """Send parts of a field to ranks, given as pairs (rank, place), and return what waits for
    theirs and puts them into places of another array."""
    from mpi4py import MPI

    out = [(r, np.ascontiguousarray(field[place])) for r, place in give]
    buffers = [(r, np.empty_like(wide[place], order="C")) for r, place in take]
    requests = [comm.Irecv(buffer, source=r, tag=tag) for r, buffer in buffers]
    requests += [comm.Isend(buffer, dest=r, tag=tag) for r, buffer in out]

    def finish() -> None:
        MPI.Request.Waitall(requests)
        for (_, place), (_, buffer) in zip(take, buffers):
            wide[place] = buffer
        out.clear()

    return finish


def _shared(
    have: tuple[slice, ...], want: tuple[slice, ...], width: int
) -> tuple[slice, ...] | None:
    """What one box has of another with so many nodes more around it; None for nothing."""
    both = tuple(
        slice(max(h.start, w.start - width), min(h.stop, w.stop + width))
        for h, w in zip(have, want)
    )
    return both if all(part.start < part.stop for part in both) else None


def _from(box: tuple[slice, ...], own: tuple[slice, ...], margin: int) -> tuple[slice, ...]:
    """A box as counted from the first of own nodes with a margin around them."""
    shifts = (margin - part.start for part in own)
    return tuple(slice(part.start + s, part.stop + s) for part, s in zip(box, shifts))


class NodeHalo:
    """Nodes of other ranks in the box around a piece, as far as it feels.

    The nodes here are the piece's own and theirs, in the order of the whole body: sums over
    neighbours then have the same bits on any rank.

    Attributes:
        number: of all nodes here in the whole body, rising, shape [m].
        x: their positions, shape [m, d].
        own: places of the piece's own among them, shape [n].
        count, sum, gather: as of the piece, of values on its own nodes.
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
        """As Subdomain.mark, of arrays [m or more, ...] on the nodes here."""
        own = [part[self.own] if isinstance(part, np.ndarray) else part for part in parts]
        return self.piece.mark(*own)

    def exchange(self, field: np.ndarray) -> None:
        """Fill others' nodes in a field [m or more, ...] from their owners."""
        _exchange(self.comm, field, field, self._give, self._take)()

    def around(self, values: np.ndarray) -> np.ndarray:
        """Values [n, ...] of the piece's own nodes on all nodes here, [m, ...]."""
        values = np.asarray(values)
        here = np.zeros((len(self.number), *values.shape[1:]), values.dtype)
        here[self.own] = values
        self.exchange(here)
        return here
