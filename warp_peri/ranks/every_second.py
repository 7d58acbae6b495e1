"""Every second node of a lattice in tiles on many ranks (theory, Q14, Q15).

Splines are made tile by tile, with nodes of others around it, so far that what lies beyond them is
below rounding: they have the same bits on any number of ranks.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import spline_filter

from warp_peri.errors import InputError
from warp_peri.points.every_second import APART, halved
from warp_peri.ranks.halo import Halo

if TYPE_CHECKING:
    from warp_peri.ranks.subdomain import Subdomain


FAR = 32
"""Coarse nodes around a tile, over which a spline forgets: (√3 − 2)³² is 5e-19."""


class TilesEverySecond:
    """As points.every_second.EverySecond, of a piece of a box in tiles.

    Args:
        piece: of a lattice in the plane.

    Raises InputError for parts that are no tiles of a box.
    """

    def __init__(self, piece: Subdomain) -> None:
        self.points, tiles, comm = piece, piece.tiles, piece.comm
        if tiles is None or piece.count != np.prod(tiles.shape):
            raise InputError("points: expected all nodes of a box")
        if any(n % (2 * APART) for n in tiles.block):
            raise InputError(f"block: expected multiples of {2 * APART}, got {tiles.block}")
        tiles = tiles.everywhere()
        self.shift = (piece.span[0] - 1) % APART
        place = piece.grid - self.shift
        self.chosen = np.flatnonzero((place % APART == 0).all(axis=1))
        shape = tuple(-((shift - n) // APART) for n, shift in zip(tiles.shape, self.shift.tolist()))
        starts = tuple(np.append(s[:-1] // APART, n) for s, n in zip(tiles.starts, shape))
        if not all(np.diff(along).all() for along in starts):
            raise InputError("ranks: one has no coarse nodes")
        grid = (place // APART)[self.chosen].astype(np.int32)
        block = tuple(n // APART for n in tiles.block)
        few = replace(tiles, shape=shape, block=block, starts=starts)
        self.nodes = replace(
            piece, x=piece.x[self.chosen], interior=piece.interior[self.chosen],
            spacing=APART * piece.spacing, number=np.ravel_multi_index(tuple(grid.T), shape),
            count=int(np.prod(shape)), grid=grid, tiles=few,
        )  # fmt: skip
        self._fine, self._wide = Halo(comm, tiles, 1), Halo(comm, few, FAR + 2)
        self._box, self._few = tiles.box(comm.rank), few.box(comm.rank)
        self._first = few.corner(comm.rank)
        self._tiles = few

    def spread(self, u: np.ndarray) -> np.ndarray:
        """Of u on this rank's coarse nodes [C, 2] what its unknown nodes have, shape [I, 2]."""
        wide = self._wide(u.T.reshape(2, *self._few))
        out = np.zeros((2, *self._box))
        for part in self._tiles.parts(self._few):
            parts = zip(*(self._along(axis, one) for axis, one in enumerate(part)))
            felt, fine, place = (tuple(those) for those in parts)
            for one, field in zip(out, wide[:, *felt]):
                one[fine] = halved(spline_filter(field))[np.ix_(*place)]
        return np.ascontiguousarray(out.reshape(2, -1)[:, self.points.interior].T)

    def _along(self, axis: int, part: slice) -> tuple[slice, slice, np.ndarray]:
        """Of a tile along an axis: the coarse nodes that its spline is made of, its fine nodes, and
        where the spline has them."""
        first, margin = int(self._first[axis]), FAR + 2
        low = max(first + part.start - margin, 0)
        high = min(first + part.stop + margin, self._tiles.shape[axis])
        last = part.stop == self._few[axis]
        fine = slice(APART * part.start, self._box[axis] if last else APART * part.stop)
        place = np.arange(fine.start, fine.stop) + APART * (first - low) - self.shift[axis]
        # a node before the first coarse one is not unknown: any value will do
        return slice(low - first + margin, high - first + margin), fine, np.maximum(place, 0)

    def gathered(self, r: np.ndarray) -> np.ndarray:
        """Means of a residual on unknown nodes [I, 2] at coarse ones of this rank, shape [J, 2]."""
        field = np.zeros((2, int(np.prod(self._box))))
        field[:, self.points.interior] = r.T
        wide = self._fine(field.reshape(2, *self._box))
        for axis, count in enumerate(self._few, 1):
            lines, at = np.moveaxis(wide, axis, 0), int(self.shift[axis - 1])
            before, middle, after = (
                lines[at + k : at + k + APART * count : APART][:count] for k in range(3)
            )
            mean = middle / 2
            mean += before / 4
            mean[: len(after)] += after / 4
            wide = np.moveaxis(mean, 0, axis)
        return np.ascontiguousarray(wide.reshape(2, -1)[:, self.nodes.interior].T)
