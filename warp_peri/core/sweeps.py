"""Products with the operator on a box of nodes: by rows of half families, or by FFT (T1, T15)."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import scipy.fft
import warp as wp

from warp_peri.core.grid import Grid
from warp_peri.kernels.micromodulus.rows import rows
from warp_peri.runtime import DEVICE, floats, get_num_threads, ints, launch_slices

SCALARS = {np.dtype(np.float64): wp.float64, np.dtype(np.float32): wp.float32}
FASTER = 4
"""How much less than a usual node a lane of a piece has to do, for the number of threads."""
FFT_BONDS = {2: 75, 3: 120}
"""Half families from which FFT takes less time than rows: the middle of where four measurements on
an idle machine crossed."""


def entries(tensors: np.ndarray) -> np.ndarray:
    """The upper triangles of symmetric matrices, row by row, shape [H, d (d + 1)/2]."""
    upper = np.triu_indices(tensors.shape[-1])
    return np.ascontiguousarray(tensors[(slice(None), *upper)])


class ByRows:
    """Half families by rows; the bits are the same on any number of threads.

    Args:
        nodes: the box.
        steps, tensors: of one half of the bonds.
        dtype: float64 or float32.
    """

    def __init__(
        self, nodes: Grid, steps: np.ndarray, tensors: np.ndarray, dtype: Any = np.float64
    ) -> None:
        self.nodes, self.core = nodes, (slice(None), slice(None), *nodes.core)
        self.dtype, self.scalar = np.dtype(dtype), SCALARS[np.dtype(dtype)]
        self.kernels = rows(self.scalar, nodes.dimension)
        strides = np.array([int(np.prod(nodes.wide[a + 1 :])) for a in range(nodes.dimension)])
        self.offset = ints(steps @ strides)
        self.tensors = floats(entries(tensors).astype(self.dtype), self.scalar)
        mask = np.zeros(nodes.wide, bool)
        mask[nodes.core] = nodes.unknown
        places = np.flatnonzero(mask)
        pieces = row_pieces(places, self.kernels.lanes, places)[:, ::2]
        self.asked: Any = wp.array(pieces, dtype=wp.vec2i, device=DEVICE)

    def __call__(self, planes: np.ndarray) -> np.ndarray:
        """L u at the unknown nodes of planes [S, d, *wide]; planes [S, d, *shape], else zero."""
        nodes, count, lanes = self.nodes, len(planes), self.kernels.lanes
        room = np.zeros(planes.size + lanes, self.dtype)  # for lanes that read beyond
        laid = room[:-lanes].reshape(count, -1)
        laid[:] = planes.reshape(count, -1)
        out = np.zeros_like(laid)
        if len(self.asked):
            launch_slices(
                self.kernels.pulled,
                len(self.asked),
                (self.asked, self.offset, self.tensors, floats(laid, self.scalar)),
                (floats(out, self.scalar),),
                samples=count,
                weight=lanes // FASTER,
            )
        force = out.reshape(planes.shape)
        return force[self.core] if nodes.periodic else force


def row_pieces(places: np.ndarray, lanes: int, numbers: np.ndarray) -> np.ndarray:
    """Runs of rising places and their numbers, cut to so many lanes, as (first place, first number,
    count), shape [P, 3]."""
    begin = np.flatnonzero(np.diff(places, prepend=-2) - 1 | np.diff(numbers, prepend=-2) - 1)
    length = np.diff(np.append(begin, len(places)))
    parts = -(-length // lanes)
    step = lanes * (np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts))
    first = np.repeat(begin, parts) + step
    count = np.minimum(np.repeat(length, parts) - step, lanes)
    return np.stack([places[first], numbers[first], count], axis=1).astype(np.int32)


class ByFFT:
    """The same by convolution on a torus that nothing reaches around, exact but for rounding."""

    def __init__(
        self, nodes: Grid, steps: np.ndarray, tensors: np.ndarray, dtype: Any = np.float64
    ) -> None:
        self.nodes, self.dtype = nodes, np.dtype(dtype)
        self.torus = torus_shape(nodes)
        self.symbol = torus_symbol(self.torus, steps, tensors).astype(self.dtype)
        self.mask = nodes.mask()

    def __call__(self, planes: np.ndarray) -> np.ndarray:
        """L u at the unknown nodes of planes [S, d, *wide]; planes [S, d, *shape], else zero."""
        nodes = self.nodes
        if nodes.periodic:
            planes = planes[(slice(None), slice(None), *nodes.core)]
        out = np.stack([convolved(self.symbol, one, self.torus) for one in planes])
        inside = tuple(slice(0, n) for n in nodes.shape)
        return np.asarray(out[(slice(None), slice(None), *inside)] * self.mask)


def torus_shape(nodes: Grid) -> tuple[int, ...]:
    """A torus that holds the box, whose collar keeps its images apart; a period is its own."""
    if nodes.periodic:
        return nodes.shape
    return tuple(scipy.fft.next_fast_len(n, real=True) for n in nodes.shape)


def torus_symbol(torus: tuple[int, ...], steps: np.ndarray, tensors: np.ndarray) -> np.ndarray:
    """D(k) h² or D(k), as the tensors are, at the waves of a torus: its upper triangle first,
    [d (d + 1)/2, *torus] with the last axis halved."""
    flat = entries(tensors)
    symbol = np.empty((flat.shape[1], *torus[:-1], torus[-1] // 2 + 1))
    place = np.ravel_multi_index(tuple(np.concatenate([steps, -steps]).T), torus, mode="wrap")
    for part, whole, c in zip(symbol, flat.sum(axis=0), flat.T):
        stencil = np.zeros(torus)
        np.subtract.at(stencil.reshape(-1), place, np.concatenate([c, c]))
        stencil.flat[0] += 2 * whole
        part[:] = scipy.fft.rfftn(stencil, workers=get_num_threads(), overwrite_x=True).real
    return symbol


def convolved(symbol: np.ndarray, field: np.ndarray, torus: tuple[int, ...]) -> np.ndarray:
    """A symbol's product with one field [d, …] in a corner of the torus, on all of it."""
    axes = tuple(range(1, len(torus) + 1))
    wave = scipy.fft.rfftn(field, s=torus, axes=axes, workers=get_num_threads())
    mixed, part = np.empty_like(wave), np.empty_like(wave[0])
    for i, one in enumerate(mixed):
        component(symbol, wave, i, one, part)
    return np.asarray(
        scipy.fft.irfftn(mixed, s=torus, axes=axes, workers=get_num_threads(), overwrite_x=True)
    )


def component(
    symbol: np.ndarray, wave: np.ndarray, i: int, out: np.ndarray, part: np.ndarray
) -> None:
    """A component of symmetric matrices [d (d + 1)/2, …] times vectors [d, …], to `out`; `part` is
    room for as much."""
    d = len(wave)
    place = {pair: n for n, pair in enumerate(itertools.combinations_with_replacement(range(d), 2))}
    np.multiply(symbol[place[0, i]], wave[0], out=out)
    for j in range(1, d):
        np.multiply(symbol[place[min(i, j), max(i, j)]], wave[j], out=part)
        out += part


def inverse(symbol: np.ndarray) -> np.ndarray:
    """D⁻¹ of symmetric matrices [d (d + 1)/2, …]; 0 where that has none (k = 0)."""
    d = {3: 2, 6: 3}[len(symbol)]
    i, j = np.triu_indices(d)
    answer, largest = np.empty_like(symbol), max(symbol.max(), -symbol.min())
    for row in range(symbol.shape[1]):  # in space all matrices at once are much memory
        full = np.empty((*symbol.shape[2:], d, d), symbol.dtype)
        full[..., i, j] = full[..., j, i] = np.moveaxis(symbol[:, row], 0, -1)
        zero = (0,) * (symbol.ndim - 2)
        singular = row == 0 and np.abs(full[zero]).max() <= 1e-12 * largest
        if singular:
            full[zero] = np.eye(d)
        found = np.linalg.inv(full)
        if singular:
            found[zero] = 0
        answer[:, row] = np.moveaxis(found[..., i, j], -1, 0)
    return answer
