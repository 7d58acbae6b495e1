"""Stencils on tiles, and what nearly inverts them: a filter and multigrid (theory, R1, R2).

A tile has nodes of others around it and its own transform; none crosses ranks, and a tile's has the
same bits on any number of them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, reduce

import numpy as np
import scipy.fft

from warp_peri.materials.crystal import StencilMaterial
from warp_peri.mpi.halo import Halo, Tiles
from warp_peri.mpi.processes import Comm
from warp_peri.runtime import get_num_threads
from warp_peri.solvers.multigrid import (
    SHIFT,
    VCycle,
    coarser,
    largest,
    prolong,
    restrict,
    seen_by_coarser,
    shear,
    shifted_inverse,
)

WIDTH = {2: 32, 3: 12}
"""Half the width of the inverse filter [nodes]."""
LONG = 0.7
"""Share of the long waves' answer beside the filter's, which is alone right for short ones: with
less than all of it the iterations grow by one or two, not three, from 128² to 2000²."""
TORUS = 8
"""Widths of the torus that the filter is taken from."""
MOST = 32
"""Solids whose filters, tensors and proofs are remembered."""


class Convolution:
    """A symmetric stencil's product with fields in tiles, zero beyond the box.

    Args:
        comm, tiles: the box and who owns what.
        reach: of the stencil [nodes].
        symbol: its transform on a torus of a given shape, [d, d, *torus] halved.
        dtype: of the transforms, float64 or float32.
    """

    def __init__(
        self,
        comm: Comm,
        tiles: Tiles,
        reach: int,
        symbol: Callable[[tuple[int, ...]], np.ndarray],
        dtype: type = np.float64,
    ) -> None:
        self.reach, self.dtype = reach, dtype
        self.box, self.parts = tiles.box(comm.rank), tiles.parts(tiles.box(comm.rank))
        self.halo, cuts = Halo(comm, tiles, reach), len(tiles.block)
        across = (max(n, reach + 1) + reach for n in tiles.shape[cuts:])  # the stencil fits too
        sizes = (*(n + 2 * reach for n in tiles.block), *across)
        self.torus = tuple(scipy.fft.next_fast_len(n, real=True) for n in sizes)
        self.symbol: np.ndarray = symbol(self.torus).astype(dtype)

    def start(self, field: np.ndarray) -> None:
        """Send for the nodes of others; `finish` gives the product."""
        self._wide, self._fill_halo = self.halo.start(field.astype(self.dtype, copy=False))

    def finish(self) -> np.ndarray:
        """The product with the field that was sent for, [d, *box]; inner tiles first."""
        out: np.ndarray = np.empty((len(self._wide), *self.box), self.dtype)
        inner = [part for part in self.parts if self._is_inner(part)]
        for part in inner:
            self._fill(out, part)
        self._fill_halo()
        for part in self.parts:
            if part not in inner:
                self._fill(out, part)
        del self._wide, self._fill_halo
        return out

    def _is_inner(self, part: tuple[slice, ...]) -> bool:
        """Whether a tile feels no node of others."""
        far = self.reach
        return all(p.start >= far and p.stop + far <= n for p, n in zip(part, self.box))

    def _fill(self, out: np.ndarray, part: tuple[slice, ...]) -> None:
        """One tile of the product: a component at a time, for in space a transform is large."""
        d, far, torus = len(self._wide), self.reach, self.torus
        here = self._wide[:, *(slice(p.start, p.stop + 2 * far) for p in part)]
        kept = [slice(far, far + p.stop - p.start) for p in part]
        kept += [slice(0, n) for n in self.box[len(part) :]]
        wave = np.empty((d, *torus[:-1], torus[-1] // 2 + 1), np.result_type(self.dtype, 1j))
        for one, there in zip(wave, here):
            one[...] = scipy.fft.rfftn(there, s=torus, workers=get_num_threads())
        for i in range(d):
            mixed = np.einsum("j...,j...->...", self.symbol[i], wave)
            found = scipy.fft.irfftn(mixed, s=torus, workers=get_num_threads(), overwrite_x=True)
            out[i][part] = found[*kept]

    def __call__(self, field: np.ndarray) -> np.ndarray:
        self.start(field)
        return self.finish()


@lru_cache(MOST)
def inverse_filter(law: StencilMaterial) -> tuple[int, Callable[[tuple[int, ...]], np.ndarray]]:
    """The inverse of D + SHIFT G p(k) at short range, beside multigrid: its width and symbol.

    The kernel of the inverse times Bartlett's window, whose transform is not negative, so that its
    symbol is positive (theory, R2). Cut off without a window it would not be.
    """
    steps, d = law.stencil.steps, law.dimension
    width, axes = WIDTH[d], tuple(range(d))
    torus, size = (TORUS * width,) * d, 2 * width + 1
    tensors = law.stencil.tensors * law.stencil.spacing**2
    shift = SHIFT * shear(law.tensor()) * seen_by_coarser(torus)
    along = 1 - np.abs(np.arange(-width, width + 1)) / (width + 1)
    window = reduce(np.multiply.outer, d * [along])
    kernel = [
        np.roll(scipy.fft.irfftn(one, s=torus), d * (width,), axes)[d * (slice(size),)] * window
        for row in shifted_inverse(torus, steps, tensors, shift)
        for one in row
    ]

    def symbol(torus: tuple[int, ...]) -> np.ndarray:
        waves = np.empty((d * d, *torus[:-1], torus[-1] // 2 + 1))
        for part, wave in zip(kernel, waves):  # one at a time: transforms are large in space
            field = np.zeros(torus)
            field[d * (slice(size),)] = part
            wave[:] = scipy.fft.rfftn(np.roll(field, d * (-width,), axes)).real
        return waves.reshape(d, d, *waves.shape[1:])

    return width, symbol


WHOLE = 10_000
"""Most nodes of a level that every rank has all of."""


class Between:
    """Restriction from nodes of ranks to every second one, and prolongation back.

    Args:
        comm: the ranks.
        tiles: who owns which fine nodes; they can be halved.
    """

    def __init__(self, comm: Comm, tiles: Tiles) -> None:
        self.coarse, every = tiles.coarser(), tiles.everywhere()
        self.around, self._few = Halo(comm, every, 1), Halo(comm, self.coarse.everywhere(), 1)
        follows = (at + 1 < count for at, count in zip(every.at(comm.rank), every.grid))
        self._with_next = tuple(slice(1, None if more else -1) for more in follows)

    def restrict(self, field: np.ndarray) -> np.ndarray:
        """Pᵗ of the nodes of this rank, one of the next rank's along each cut included."""
        return restrict(self.around(field)[:, *self._with_next])

    def prolong(self, field: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        """P to nodes of this rank, of a given shape."""
        before = self._few(field)[:, *(slice(None, -1),) * len(shape)]
        return prolong(before, tuple(n + 2 for n in shape))[:, *(slice(2, None),) * len(shape)]


def cycle(
    comm: Comm, steps: np.ndarray, tensors: np.ndarray, mask: np.ndarray, tiles: Tiles
) -> _InTiles | _Gathered:
    """A V-cycle on this rank's nodes of a mask, whole where nodes are few or tiles too small.

    Which levels are whole does not depend on the ranks.
    """
    if np.prod(tiles.shape) <= WHOLE or any(size % 2 for size in tiles.block):
        return _Gathered(comm, steps, tensors, mask, tiles)
    return _InTiles(comm, steps, tensors, mask, tiles)


class _InTiles(VCycle):
    """As VCycle, of this rank's nodes: a level reads one more around them."""

    def __init__(
        self, comm: Comm, steps: np.ndarray, tensors: np.ndarray, mask: np.ndarray, tiles: Tiles
    ) -> None:
        self._lay(steps, tensors, mask)
        self.largest, self._between = largest(steps, tensors), Between(comm, tiles)
        few, tensors = coarser(mask), tensors * 2.0 ** (mask.ndim - 2)
        self.coarser = cycle(comm, steps, tensors, few, self._between.coarse)

    def around(self, field: np.ndarray) -> np.ndarray:
        return self._between.around(field)

    def restrict(self, field: np.ndarray) -> np.ndarray:
        return self._between.restrict(field)

    def prolong(self, field: np.ndarray) -> np.ndarray:
        return self._between.prolong(field, self.shape)


class _Gathered:
    """A level that every rank has the whole of: the same work on each, and one exchange."""

    def __init__(
        self, comm: Comm, steps: np.ndarray, tensors: np.ndarray, mask: np.ndarray, tiles: Tiles
    ) -> None:
        self.comm, self.mask, self._shape = comm, mask, tiles.shape
        self._own = [tiles.own(r) for r in range(comm.size)]
        full = self._whole(mask[None].astype(float))[0] > 0.5
        self._cycle = VCycle(steps, tensors, full) if full.any() else None

    def _whole(self, field: np.ndarray) -> np.ndarray:
        whole = np.empty((len(field), *self._shape))
        for own, values in zip(self._own, self.comm.allgather(field)):
            whole[:, *own] = values
        return whole

    def __call__(self, r: np.ndarray) -> np.ndarray:
        whole = self._whole(r)
        if self._cycle is None:
            return np.zeros_like(r)
        return self._cycle(whole)[:, *self._own[self.comm.rank]]
