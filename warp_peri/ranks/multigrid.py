"""The V-cycle of micromodulus.coarse in rows of many ranks; where it is small, each has it all."""

from __future__ import annotations

import numpy as np

from warp_peri.micromodulus.coarse import VCycle, coarser, prolong, restrict
from warp_peri.micromodulus.nodes import Nodes
from warp_peri.micromodulus.sweeps import ByRows, torus_symbol
from warp_peri.ranks.convolution import smallest
from warp_peri.ranks.halo import RowHalo
from warp_peri.ranks.processes import Comm

WHOLE = 10_000
"""Most nodes of a level that every rank has all of."""
WAVES = 16
"""Along an axis, at which the largest eigenvalue of the nearest cells is looked for."""


class Between:
    """Restriction from rows of ranks to every second row, and prolongation back.

    Args:
        comm: the ranks.
        starts: first fine row of each rank, and their number; all but the last are even.
    """

    def __init__(self, comm: Comm, starts: np.ndarray) -> None:
        self.coarse = starts // 2
        self._fine, self._few = RowHalo(comm, starts, 1), RowHalo(comm, self.coarse, 1)
        self._follows = comm.rank + 1 < comm.size

    def restrict(self, field: np.ndarray) -> np.ndarray:
        """Pᵗ of the rows of this rank, one row of the next rank's included."""
        return restrict(self._fine(field)[:, 1 : None if self._follows else -1])

    def prolong(self, field: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        """P to rows of this rank of a given shape [rows, ...]."""
        before = self._few(field)[:, :-1]
        return prolong(before, (shape[0] + 2, *shape[1:]))[:, 2:]


def cycle(
    comm: Comm, steps: np.ndarray, tensors: np.ndarray, mask: np.ndarray, starts: np.ndarray
) -> _InRows | _Gathered:
    """A V-cycle on the rows of this rank of a mask [rows, ...], whole where there are few nodes."""
    nodes = starts[-1] * np.prod(mask.shape[1:])
    if nodes <= WHOLE or (starts[1:-1] % 2).any():
        return _Gathered(comm, steps, tensors, mask, starts)
    return _InRows(comm, steps, tensors, mask, starts)


class _InRows(VCycle):
    """As VCycle, of rows: a level reads one row of its neighbours."""

    def __init__(
        self,
        comm: Comm,
        steps: np.ndarray,
        tensors: np.ndarray,
        mask: np.ndarray,
        starts: np.ndarray,
    ) -> None:
        d = mask.ndim
        self.mask, self.shape, self.dense = mask, mask.shape, None
        asked = np.pad(mask, 1)
        place = np.flatnonzero(asked)
        nodes = Nodes(np.eye(d), asked.shape, 1, False, np.arange(len(place)), place, place)
        self.rows = ByRows(nodes, steps, tensors)
        diagonal = 2 * np.diag(tensors.sum(axis=0))
        self.diagonal = diagonal.reshape(d, *([1] * d))
        self.largest = largest(steps, tensors)
        self._halo, self._between = RowHalo(comm, starts, 1), Between(comm, starts)
        few = coarser(mask)
        self._next = cycle(comm, steps, tensors * 2.0 ** (d - 2), few, self._between.coarse)

    def product(self, field: np.ndarray) -> np.ndarray:
        """The level's operator on planes [d, rows, ...]."""
        d = self.mask.ndim
        wide = np.pad(self._halo(field), [(0, 0)] * 2 + [(1, 1)] * (d - 1))
        return np.asarray(self.rows(wide[None])[(0, slice(None)) + (slice(1, -1),) * d])

    def __call__(self, r: np.ndarray) -> np.ndarray:
        z = self._smoothed(r, None)
        left = self._between.restrict(r - self.product(z)) * self._next.mask
        z = z + self._between.prolong(self._next(left), self.shape) * self.mask
        return self._smoothed(r, z)


class _Gathered:
    """A level that every rank has the whole of: the same work on each, and one exchange."""

    def __init__(
        self,
        comm: Comm,
        steps: np.ndarray,
        tensors: np.ndarray,
        mask: np.ndarray,
        starts: np.ndarray,
    ) -> None:
        self.comm, self.mask, self._counts = comm, mask, np.diff(starts)
        self._own = slice(*starts[comm.rank : comm.rank + 2])
        full = self._whole(mask[None].astype(float))[0] > 0.5
        self._cycle = VCycle(steps, tensors, full) if full.any() else None

    def _whole(self, field: np.ndarray) -> np.ndarray:
        rows = np.ascontiguousarray(np.moveaxis(field, 1, 0))
        whole = np.empty((self._counts.sum(), *rows.shape[1:]))
        sizes = self._counts * int(np.prod(rows.shape[1:]))
        self.comm.Allgatherv(rows, [whole, sizes])
        return np.ascontiguousarray(np.moveaxis(whole, 0, 1))

    def __call__(self, r: np.ndarray) -> np.ndarray:
        whole = self._whole(r)
        return np.zeros_like(r) if self._cycle is None else self._cycle(whole)[:, self._own]


def largest(steps: np.ndarray, tensors: np.ndarray) -> float:
    """Largest eigenvalue of a stencil over its diagonal on all of a lattice, hence on any mask."""
    d = tensors.shape[-1]
    scale = 1 / np.sqrt(2 * np.diag(tensors.sum(axis=0)))
    scaled = scale[:, None] * tensors * scale
    return -smallest(-torus_symbol((WAVES,) * d, steps, scaled))
