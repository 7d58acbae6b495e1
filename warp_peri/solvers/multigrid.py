"""Approximate inverses of a stencil on a body: edge elimination, multigrid. Fields are planes
[d, *box], zero off the unknowns, in units of stress, L h²; filters work in single precision."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any

import numpy as np
import scipy.fft
import scipy.sparse as sp
from scipy.ndimage import convolve1d, distance_transform_cdt

from warp_peri.core.proof import smallest_eigenvalue
from warp_peri.core.stencil import (
    ByRows,
    Grid,
    Stencil,
    convolved,
    inverse,
    q1_tensors,
    torus_shape,
    torus_symbol,
)
from warp_peri.runtime import get_num_threads
from warp_peri.solvers.systems import symmetric_factors


class Edge:
    """Edge elimination z = E A_ee⁻¹ Eᵗ r on nodes within a reach of the edge, else zero."""

    def __init__(self, grid: Grid, stencil: Stencil) -> None:
        mask = grid.mask()
        depth = distance_transform_cdt(np.pad(mask, 1), "chessboard")[(slice(1, -1),) * mask.ndim]
        self.near = mask & (depth <= grid.reach)
        self.factors = symmetric_factors(block(stencil, self.near))

    def __call__(self, r: np.ndarray) -> np.ndarray:
        """Displacement [d, *shape] that leaves no residual on the edge."""
        return solved(self.factors, self.near, r)


def solved(factors: Any, mask: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Solution of a block's factors for r, in planes [d, *shape], zero off the mask."""
    z = np.zeros_like(r)
    z[:, mask] = factors.solve(np.ascontiguousarray(r[:, mask].T).ravel()).reshape(-1, len(r)).T
    return z


def block(stencil: Stencil, mask: np.ndarray) -> sp.csc_array:
    """Matrix of the operator between the nodes of a mask, shape [d n, d n]."""
    d, here = stencil.dimension, np.argwhere(mask)
    number = np.full(mask.shape, -1)
    number[mask] = np.arange(len(here))
    rows, columns = [np.arange(len(here))], [np.arange(len(here))]
    values = [np.broadcast_to(2 * stencil.tensors.sum(axis=0), (len(here), d, d))]
    both = np.concatenate([stencil.steps, -stencil.steps])
    for step, C in zip(both, np.concatenate([stencil.tensors] * 2)):
        there = here + step
        inside = np.flatnonzero(((there >= 0) & (there < mask.shape)).all(axis=1))
        other = number[tuple(there[inside].T)]
        rows.append(inside[other >= 0])
        columns.append(other[other >= 0])
        values.append(np.broadcast_to(-C, (len(rows[-1]), d, d)))
    row, column, value = map(np.concatenate, (rows, columns, values))
    i, j = np.indices((d, d)).reshape(2, -1)
    at = ((d * row[:, None] + i).ravel(), (d * column[:, None] + j).ravel())
    return sp.csc_array((value.ravel(), at), shape=2 * (d * len(here),))


Filter = Callable[[np.ndarray], np.ndarray]
SINE_SHIFT, SHIFT = 0.4, 1.0
"""Of the short-range filters beside the sine transform and beside multigrid, in shear moduli."""
COARSEST = 400
"""Most nodes of a level that is factorised, as what is one or two nodes wide always is."""
SMOOTHED = 4.0
"""The Chebyshev smoother, of degree two, covers eigenvalues from 1/SMOOTHED of the largest."""
WAVES = 16
"""Along an axis, at which the largest eigenvalue of the nearest cells is looked for."""


def shear(elastic: np.ndarray) -> float:
    """Mean shear modulus: of C_ijij − C_iijj/d, over the number of shears."""
    d = elastic.shape[0]
    full, trace = np.einsum("ijij", elastic), np.einsum("iijj", elastic)
    return float((full - trace / d) / (d * (d + 1) - 2))


def torus_inverse(
    nodes: Grid, steps: np.ndarray, tensors: np.ndarray, shift: np.ndarray | float = 0.0
) -> Filter:
    """Filter (D(k) + shift I)⁻¹ on the torus around the nodes, cut off at them."""
    torus = torus_shape(nodes)
    kind = np.float64 if nodes.periodic else np.float32  # on a period it is the whole inverse
    table = shifted_inverse(torus, steps, tensors, shift).astype(kind)
    mask = nodes.mask()
    inside = tuple(slice(0, n) for n in nodes.shape)

    def apply(r: np.ndarray) -> np.ndarray:
        z = convolved(table, r.astype(kind), torus)
        return np.asarray(z[(slice(None), *inside)] * mask, dtype=np.float64)

    return apply


def shifted_inverse(
    torus: tuple[int, ...], steps: np.ndarray, tensors: np.ndarray, shift: np.ndarray | float
) -> np.ndarray:
    """Inverse (D(k) + shift I)⁻¹ at the waves of a torus, as torus_symbol has D."""
    symbol = torus_symbol(torus, steps, tensors)
    symbol[range(len(torus)), range(len(torus))] += shift
    return inverse(symbol)


def seen_by_coarser(torus: tuple[int, ...]) -> np.ndarray:
    """Factor p = Π (1 + cos k_a h)/2 of prolongation at the waves of a torus."""
    seen = [(1 + np.cos(2 * np.pi * np.arange(n) / n)) / 2 for n in torus]
    seen[-1] = seen[-1][: torus[-1] // 2 + 1]
    return np.asarray(reduce(np.multiply.outer, seen))


def sine(nodes: Grid, steps: np.ndarray, tensors: np.ndarray, elastic: np.ndarray) -> Filter:
    """Filter for boxes: z = H ∗ r + S D_a⁻¹ shift (D_a + shift)⁻¹ S r, S the DST-I, the symbol's
    diagonal D_a = D_aa in the sine basis at long waves, all of it at short ones."""
    d, core = nodes.dimension, nodes.core
    shift = SINE_SHIFT * shear(elastic)
    short = torus_inverse(nodes, steps, tensors, shift)
    sizes = [len(range(*part.indices(n))) for part, n in zip(core, nodes.wide)]
    angles = [np.pi * np.arange(1, n + 1) / (n + 1) for n in sizes]
    D = np.zeros((d, *sizes))
    diagonal = tensors[:, np.arange(d), np.arange(d)]
    for step, c in zip(steps, diagonal):
        # the mean over signs of the waves: a product of cosines
        wave = reduce(np.multiply.outer, [np.cos(angle * s) for angle, s in zip(angles, step)])
        D += 2 * c.reshape(d, *([1] * d)) * (1 - wave)
    gain = (shift / (D * (D + shift))).astype(np.float32)
    axes = tuple(range(1, d + 1))

    def apply(r: np.ndarray) -> np.ndarray:
        z = short(r)
        inner = r[(slice(None), *core)].astype(np.float32)
        wave = scipy.fft.dstn(inner, type=1, axes=axes, workers=get_num_threads()) * gain
        z[(slice(None), *core)] += scipy.fft.idstn(
            wave, type=1, axes=axes, workers=get_num_threads()
        )
        return z

    return apply


def multigrid(nodes: Grid, steps: np.ndarray, tensors: np.ndarray, elastic: np.ndarray) -> Filter:
    """Filter for any mask: short waves by a filter on the torus, long ones by a V-cycle, added. z =
    mask (H ∗ r + P V(Pᵗ r)), H = (D + shift p(k))⁻¹ with p of `seen_by_coarser`; V is a V-cycle for
    Q1 elements of the same moduli on every second node."""
    seen = seen_by_coarser(torus_shape(nodes))
    short = torus_inverse(nodes, steps, tensors, SHIFT * shear(elastic) * seen)
    mask = nodes.unknown
    coarse = coarser(mask)
    if not coarse.any():
        return short
    d = nodes.dimension
    cycle = VCycle(*q1_tensors(elastic * 2.0 ** (d - 2)), coarse)
    core = (slice(None), *nodes.core)

    def apply(r: np.ndarray) -> np.ndarray:
        z = short(r)
        long = cycle(restrict(r[core]) * coarse)
        z[core] += prolong(long, mask.shape) * mask
        return z

    return apply


def coarser(mask: np.ndarray) -> np.ndarray:
    """Mask of a coarser level: every second node along each axis, from the second on."""
    return mask[(slice(1, None, 2),) * mask.ndim]


def _spread(field: np.ndarray) -> np.ndarray:
    """Planes [d, …] and half of what is beside, along each axis."""
    for axis in range(1, field.ndim):
        field = convolve1d(field, (0.5, 1.0, 0.5), axis, mode="constant")
    return field


def restrict(field: np.ndarray) -> np.ndarray:
    """Restriction Pᵗ: sums of planes [d, …] with weights 1 and 1/2 along each axis."""
    return _spread(field)[(slice(None), *[slice(1, None, 2)] * (field.ndim - 1))]


def prolong(field: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Prolongation P: linear interpolation of coarser planes to a box of the given shape."""
    fine = np.zeros((len(field), *shape), field.dtype)
    fine[(slice(None), *[slice(1, None, 2)] * len(shape))] = field
    return _spread(fine)


def largest(steps: np.ndarray, tensors: np.ndarray) -> float:
    """Largest eigenvalue of a stencil over its diagonal on a lattice, hence on any mask."""
    d = tensors.shape[-1]
    scale = 1 / np.sqrt(2 * np.diag(tensors.sum(axis=0)))
    phase = 2 * np.pi / WAVES * np.indices((WAVES,) * d).reshape(d, -1).T
    symbol = Stencil(1.0, steps, scale[:, None] * tensors * scale).symbol(phase)
    return -float(smallest_eigenvalue(-symbol).min())


class VCycle:
    """V-cycle z ≈ A⁻¹ r for a stencil on a mask; symmetric and positive. Each coarser level has the
    same stencil, of nearest cells, times 2^(d − 2)."""

    coarser: Any = None
    factors: Any = None

    def __init__(self, steps: np.ndarray, tensors: np.ndarray, mask: np.ndarray) -> None:
        self._lay(steps, tensors, mask)
        if np.count_nonzero(mask) <= COARSEST or min(mask.shape) < 3:
            self.factors = symmetric_factors(block(Stencil(1.0, steps, tensors), mask))
            return
        self.largest = largest(steps, tensors)
        coarse = coarser(mask)
        if coarse.any():
            self.coarser = VCycle(steps, tensors * 2.0 ** (mask.ndim - 2), coarse)

    def _lay(self, steps: np.ndarray, tensors: np.ndarray, mask: np.ndarray) -> None:
        d, self.reach = mask.ndim, int(np.abs(steps).max())
        self.mask, self.shape = mask, mask.shape
        asked = np.pad(mask, self.reach)
        place = np.flatnonzero(asked)
        nodes = Grid(np.eye(d), asked.shape, self.reach, False, np.arange(len(place)), place, place)
        self.rows = ByRows(nodes, steps, tensors)
        self.diagonal = 2 * np.diag(tensors.sum(axis=0)).reshape(d, *([1] * d))

    def around(self, field: np.ndarray) -> np.ndarray:
        """Planes [d, …] padded by as many nodes as the stencil reaches."""
        return np.pad(field, [(0, 0)] + [(self.reach,) * 2] * self.mask.ndim)

    def restrict(self, field: np.ndarray) -> np.ndarray:
        """Restrict planes to the coarser level."""
        return restrict(field)

    def prolong(self, field: np.ndarray) -> np.ndarray:
        """Prolong planes from the coarser level."""
        return prolong(field, self.shape)

    def product(self, field: np.ndarray) -> np.ndarray:
        """Apply the level's operator to planes [d, …]."""
        inner = (0, slice(None)) + (slice(self.reach, -self.reach),) * self.mask.ndim
        return np.asarray(self.rows(self.around(field)[None])[inner])

    def _smoothed(self, r: np.ndarray, z: np.ndarray | None) -> np.ndarray:
        """Two Chebyshev iterations of the operator over its diagonal, from z or from zero."""
        middle, radius = (self.largest * (1 + sign / SMOOTHED) / 2 for sign in (1, -1))
        left = r if z is None else r - self.product(z)
        step = left / self.diagonal / middle
        z = step if z is None else z + step
        now = 1 / (2 * middle / radius - radius / middle)
        left = r - self.product(z)
        step = now * (radius / middle * step + 2 / radius * (left / self.diagonal))
        return np.asarray(z + step)

    def __call__(self, r: np.ndarray) -> np.ndarray:
        """Approximate solution z ≈ A⁻¹ r for r zero outside the mask."""
        if self.factors is not None:
            return solved(self.factors, self.mask, r)
        z = self._smoothed(r, None)
        if self.coarser is not None:
            left = self.restrict(r - self.product(z)) * self.coarser.mask
            z = z + self.prolong(self.coarser(left)) * self.mask
        return self._smoothed(r, z)
