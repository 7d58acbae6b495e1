"""The V-cycle of statics.multigrid in tiles of many ranks; where it is small, each has it all."""

from __future__ import annotations

import numpy as np

from warp_peri.core.grid import Grid
from warp_peri.core.sweeps import ByRows, torus_symbol
from warp_peri.ranks.convolution import smallest
from warp_peri.ranks.processes import Comm
from warp_peri.ranks.tiles import Halo, Tiles
from warp_peri.statics.multigrid import VCycle, coarser, prolong, restrict

WHOLE = 10_000
"""Most nodes of a level that every rank has all of."""
WAVES = 16
"""Along an axis, at which the largest eigenvalue of the nearest cells is looked for."""


class Between:
    """Restriction from nodes of ranks to every second one, and prolongation back.

    Args:
        comm: the ranks.
        tiles: who owns which fine nodes; they can be halved.
    """

    def __init__(self, comm: Comm, tiles: Tiles) -> None:
        self.coarse = tiles.coarser()
        self._fine, self._few = Halo(comm, tiles, 1), Halo(comm, self.coarse, 1)
        follows = (at + 1 < count for at, count in zip(tiles.at(comm.rank), tiles.grid))
        self._with_next = tuple(slice(1, None if more else -1) for more in follows)
        self._cuts = len(tiles.block)

    def restrict(self, field: np.ndarray) -> np.ndarray:
        """Pᵗ of the nodes of this rank, one of the next rank's along each cut included."""
        return restrict(self._fine(field)[:, *self._with_next])

    def prolong(self, field: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        """P to nodes of this rank, of a given shape."""
        before = self._few(field)[:, *(slice(None, -1),) * self._cuts]
        wide = (n + 2 * (axis < self._cuts) for axis, n in enumerate(shape))
        return prolong(before, tuple(wide))[:, *(slice(2, None),) * self._cuts]


def cycle(
    comm: Comm, steps: np.ndarray, tensors: np.ndarray, mask: np.ndarray, tiles: Tiles
) -> _InTiles | _Gathered:
    """A V-cycle on this rank's nodes of a mask, whole where nodes are few or tiles too small.

    Which levels are whole does not depend on the ranks.
    """
    if np.prod(tiles.shape) <= WHOLE or not tiles.halves:
        return _Gathered(comm, steps, tensors, mask, tiles)
    return _InTiles(comm, steps, tensors, mask, tiles)


class _InTiles(VCycle):
    """As VCycle, of this rank's nodes: a level reads one more around them."""

    def __init__(
        self, comm: Comm, steps: np.ndarray, tensors: np.ndarray, mask: np.ndarray, tiles: Tiles
    ) -> None:
        d = mask.ndim
        self.mask, self.shape, self.factors = mask, mask.shape, None
        asked = np.pad(mask, 1)
        place = np.flatnonzero(asked)
        nodes = Grid(np.eye(d), asked.shape, 1, False, np.arange(len(place)), place, place)
        self.rows = ByRows(nodes, steps, tensors)
        diagonal = 2 * np.diag(tensors.sum(axis=0))
        self.diagonal = diagonal.reshape(d, *([1] * d))
        self.largest = largest(steps, tensors)
        self._halo, self._between = Halo(comm, tiles, 1), Between(comm, tiles)
        self._pad = [(0, 0)] * (1 + len(tiles.block)) + [(1, 1)] * (d - len(tiles.block))
        few = coarser(mask)
        self._next = cycle(comm, steps, tensors * 2.0 ** (d - 2), few, self._between.coarse)

    def product(self, field: np.ndarray) -> np.ndarray:
        """The level's operator on planes [d, *box]."""
        wide = np.pad(self._halo(field), self._pad)
        return np.asarray(self.rows(wide[None])[(0, slice(None)) + (slice(1, -1),) * len(field)])

    def __call__(self, r: np.ndarray) -> np.ndarray:
        z = self._smoothed(r, None)
        left = self._between.restrict(r - self.product(z)) * self._next.mask
        z = z + self._between.prolong(self._next(left), self.shape) * self.mask
        return self._smoothed(r, z)


class _Gathered:
    """A level that every rank has the whole of: the same work on each, and one exchange."""

    def __init__(
        self, comm: Comm, steps: np.ndarray, tensors: np.ndarray, mask: np.ndarray, tiles: Tiles
    ) -> None:
        self.comm, self.mask, self._shape = comm, mask, tiles.shape
        self._boxes = [(tiles.own(r), tiles.box(r)) for r in range(comm.size)]
        full = self._whole(mask[None].astype(float))[0] > 0.5
        self._cycle = VCycle(steps, tensors, full) if full.any() else None

    def _whole(self, field: np.ndarray) -> np.ndarray:
        count = len(field)
        sizes = np.array([count * int(np.prod(box)) for _, box in self._boxes])
        flat = np.empty(sizes.sum())
        self.comm.Allgatherv(np.ascontiguousarray(field), [flat, sizes])
        whole = np.empty((count, *self._shape))
        for (own, box), values in zip(self._boxes, np.split(flat, np.cumsum(sizes)[:-1])):
            whole[:, *own] = values.reshape(count, *box)
        return whole

    def __call__(self, r: np.ndarray) -> np.ndarray:
        whole = self._whole(r)
        if self._cycle is None:
            return np.zeros_like(r)
        return self._cycle(whole)[:, *self._boxes[self.comm.rank][0]]


def largest(steps: np.ndarray, tensors: np.ndarray) -> float:
    """Largest eigenvalue of a stencil over its diagonal on all of a lattice, hence on any mask."""
    d = tensors.shape[-1]
    scale = 1 / np.sqrt(2 * np.diag(tensors.sum(axis=0)))
    scaled = scale[:, None] * tensors * scale
    return -smallest(-torus_symbol((WAVES,) * d, steps, scaled))
