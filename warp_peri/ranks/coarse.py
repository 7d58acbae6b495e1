"""Every second node of a lattice in rows on many ranks (theory.md, Q14, Q15).

Splines are made block by block, with rows of others around it, so far that what lies beyond them is
below rounding: they have the same bits on any number of ranks.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import spline_filter

from warp_peri.errors import InputError
from warp_peri.points.every_second import APART, halved
from warp_peri.ranks.halo import RowHalo

if TYPE_CHECKING:
    from warp_peri.ranks.pieces import Piece

FAR = 32
"""Coarse rows around a block, over which a spline forgets: (√3 − 2)³² is 5e-19."""


class RowsEverySecond:
    """As points.every_second.EverySecond, of a piece of a box in rows.

    Args:
        piece: of a lattice in the plane.

    Raises InputError for parts that are no rows of a box.
    """

    def __init__(self, piece: Piece) -> None:
        self.points, rows, comm = piece, piece.rows, piece.comm
        if rows is None or piece.count != np.prod(rows.shape) or rows.block < 2 * APART:
            raise InputError("points: expected all rows of a box")
        self.shift = (piece.span[0] - 1) % APART
        place = piece.grid - self.shift
        self.chosen = np.flatnonzero((place % APART == 0).all(axis=1))
        shape = tuple(-((shift - n) // APART) for n, shift in zip(rows.shape, self.shift.tolist()))
        starts = np.append(rows.starts[:-1] // APART, shape[0])
        if not np.diff(starts).all():
            raise InputError("ranks: one has no coarse rows")
        grid = (place // APART)[self.chosen].astype(np.int32)
        few = replace(rows, shape=shape, block=rows.block // APART, starts=starts)
        self.nodes = replace(
            piece, x=piece.x[self.chosen], interior=piece.interior[self.chosen],
            spacing=APART * piece.spacing, number=np.ravel_multi_index(tuple(grid.T), shape),
            count=int(np.prod(shape)), grid=grid, rows=few,
        )  # fmt: skip
        self._fine, self._wide = RowHalo(comm, rows.starts, 1), RowHalo(comm, starts, FAR + 2)
        self._box = (int(np.diff(rows.starts)[comm.rank]), rows.shape[1])
        self._first, self._last = (int(n) for n in starts[comm.rank : comm.rank + 2])

    def spread(self, u: np.ndarray) -> np.ndarray:
        """Of u on this rank's coarse nodes [C, 2] what its unknown nodes have, shape [I, 2]."""
        rows, margin = self.nodes.rows, FAR + 2
        assert rows is not None
        wide = self._wide(u.T.reshape(2, -1, rows.shape[1]))
        out = np.zeros((2, *self._box))
        # a row or column before the first coarse one has no unknown nodes: any value will do
        row, column = (np.arange(n) - shift for n, shift in zip(self._box, self.shift))
        row, column = row + APART * self._first, np.maximum(column, 0)
        for begin in range(self._first, self._last, rows.block):
            end = begin + rows.block
            low, high = max(begin - margin, 0), min(end + margin, rows.shape[0])
            here = wide[:, low - self._first + margin : high - self._first + margin]
            top = APART * (begin - self._first)
            bottom = self._box[0] if end >= self._last else top + APART * rows.block
            place = np.ix_(np.maximum(row[top:bottom] - APART * low, 0), column)
            for one, field in zip(out, here):
                one[top:bottom] = halved(spline_filter(field))[place]
        return np.ascontiguousarray(out.reshape(2, -1)[:, self.points.interior].T)

    def gathered(self, r: np.ndarray) -> np.ndarray:
        """Means of a residual on unknown nodes [I, 2] at coarse ones of this rank, shape [J, 2]."""
        rows = self.nodes.rows
        assert rows is not None
        field = np.zeros((2, int(np.prod(self._box))))
        field[:, self.points.interior] = r.T
        wide = np.pad(self._fine(field.reshape(2, *self._box)), [(0, 0), (0, 0), (1, 1)])
        for axis, count in ((1, self._last - self._first), (2, rows.shape[1])):
            lines, at = np.moveaxis(wide, axis, 0), int(self.shift[axis - 1])
            before, middle, after = (
                lines[at + k : at + k + APART * count : APART][:count] for k in range(3)
            )
            mean = middle / 2
            mean += before / 4
            mean[: len(after)] += after / 4
            wide = np.moveaxis(mean, 0, axis)
        return np.ascontiguousarray(wide.reshape(2, -1)[:, self.nodes.interior].T)
