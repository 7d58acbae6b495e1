"""Products and inverses of a stencil on the nodes of one body (theory, T15), and what stands before
conjugate gradients: edge elimination, the sine transform, multigrid. Their fields are planes
[d, *box], zero off the unknowns, in units of stress, L h²; filters work in single precision.

L_II is a block of the operator of a torus, so the smallest eigenvalue of that operator's symbol
bounds it from below: above zero, conjugate gradients find the one answer.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial, reduce
from typing import Any, TypeAlias

import numpy as np
import scipy.fft
from numpy import ndarray
from scipy.ndimage import convolve1d, distance_transform_cdt

from warp_peri.core.elastic import q1_tensors
from warp_peri.core.stencil import (
    FFT_BONDS,
    SCALARS,
    ByFFT,
    ByRows,
    Grid,
    Stencil,
    block,
    convolved,
    grid_of,
    inverse,
    smallest_eigenvalue,
    torus_shape,
    torus_symbol,
)
from warp_peri.errors import InputError, Shape
from warp_peri.points.arguments import ArrayMap
from warp_peri.points.points import Points, grid_places
from warp_peri.runtime import get_num_threads
from warp_peri.solvers.systems import (
    SolveRecord,
    definite,
    definite_factors,
    factorised,
    symmetric_factors,
)

Inverse: TypeAlias = Callable[[ndarray, float], ndarray]
"""An inverse of the linear part: of a load on the interior [I, d], to a relative residual."""
FEW = DIRECT = 4_000
"""Most unknown nodes for which multigrid, whose iterations do not grow, is not worth its set-up;
and most that are factorised."""
STIFFEST = 4 * DIRECT
"""Likewise most that are factorised where λ ≫ μ and loads are many: each takes long to iterate."""
MANY, FEW_IN_SPACE = 10, 500
"""Loads that are many; most unknown nodes in space whose factors, which fill up, cost little."""
PAYS = {"sine": 3400, "fft": 7000}
"""A factorisation pays from 2 + n H/3400 loads on n nodes, H half of a stencil's bonds, where the
sine transform does, from 2 + n H/7000 elsewhere."""
STIFF = 30.0
"""λ/μ from which the strip at the edge costs less than the iterations that it saves."""
SINGULAR = 1e-13
"""A bound of the smallest eigenvalue below this fraction of the largest is no bound."""
ROUNDING = 1e-14
"""Of a load's component, which is its mean where no more is left without that."""
WAVES = 1 << 17
"""Of a torus, whose eigenvalues are taken at once."""


class Linear:
    """Operator L of one stencil on the nodes of one body or of one period, all bonds whole.

    Args:
        stencil: of the solid.
        points: lattice nodes with a collar of its reach, or periodic.
        dtype: float64 or float32.
        why, least: of grid_of.

    Raises InputError as grid_of does.
    """

    def __init__(
        self,
        stencil: Stencil,
        points: Points,
        *,
        dtype: Any = np.float64,
        why: str = "",
        least: int | None = None,
    ) -> None:
        self.stencil, self.points = stencil, points
        self.grid = grid_of(points, stencil.steps, why=why, least=least)
        if np.dtype(dtype) not in SCALARS:
            raise InputError(f"dtype: expected float64 or float32, got {np.dtype(dtype)}")
        self.dtype = np.dtype(dtype)
        many = len(stencil.steps) >= FFT_BONDS[self.grid.dimension]
        make: type[ByFFT | ByRows] = ByFFT if many else ByRows
        self.pull: ArrayMap = make(self.grid, stencil.steps, stencil.tensors, self.dtype)
        self._filters: dict[str, tuple[ArrayMap, ArrayMap | None]] = {}

    def __call__(self, u: ndarray) -> ndarray:
        """Force L u of fields [S, N, d] at the interior nodes, [S, I, d]."""
        return self.grid.gather(self.pull(self.grid.scatter(u, self.dtype)))

    @cached_property
    def _torus(self) -> ByFFT:
        if isinstance(self.pull, ByFFT) and self.dtype == np.float64:
            return self.pull
        return ByFFT(self.grid, self.stencil.steps, self.stencil.tensors)

    def push(self, inner: ndarray) -> ndarray:
        """Transposed product Lᵗ of a field on the interior [I, d], on all nodes, [N, d]."""
        grid, by = self.grid, self._torus
        field = convolved(by.symbol, grid.scatter_interior(inner), by.torus)
        out = np.zeros(self.points.x.shape)
        out[grid.near] = grid.gather(field[None], grid.place)[0]
        return out

    def check_definite(self) -> None:
        """Raise InputError unless the symbol proves that L_II is positive definite."""
        grid, by = self.grid, self._torus
        ratio = smallest_ratio(by.symbol, by.torus)
        # every node's Laplacian is at least that of the box's longest wave
        halves = [n + 1.0 - 2 * grid.reach for n in grid.shape]
        if grid.periodic:
            halves = [max(grid.shape) / 2]
        long = sum(4 * np.sin(np.pi / 2 / n) ** 2 for n in halves)
        scale = 2 * float(self.stencil.tensors[:, 0, 0].sum())
        if ratio * long > SINGULAR * scale:
            return
        kind = "singular" if abs(ratio) * long <= SINGULAR * scale else "indefinite"
        raise InputError(
            f"the operator on these {len(grid.interior)} nodes is {kind} or cannot be told from "
            f"it: the smallest Λmin D(k)/s(k) is {ratio * self.stencil.spacing**2:.2e}, and static "
            "problems of the model have no unique or no stable answer here"
        )

    def method(self, asked: str | None = None, loads: int = 0) -> str:
        """Name of the solve method: `asked`, or the cheapest for so many loads, of 0 by iteration;
        InputError where the nodes do not allow it."""
        grid, nodes, C = self.grid, len(self.grid.interior), self.stencil.elastic
        mu, d = shear(C), grid.dimension
        stiff = np.einsum("iijj", C) / d**2 - 2 * mu / d > STIFF * mu  # λ ≫ μ at long waves
        if grid.periodic:
            return "fft"
        if asked == "sine" and not grid.is_box:
            raise InputError("method: sine is for boxes of nodes; try multigrid")
        if asked:
            return asked
        pays = 2 + nodes * len(self.stencil.steps) / PAYS["sine" if grid.is_box else "fft"]
        most = STIFFEST if stiff and loads >= MANY else DIRECT
        few = nodes <= FEW_IN_SPACE if d == 3 else nodes <= most and (stiff or loads > pays)
        if few and loads:
            return "lu"
        if stiff:
            return "strip"
        return "sine" if grid.is_box else "fft" if nodes <= FEW else "multigrid"

    def filter(self, method: str) -> tuple[ArrayMap, ArrayMap | None]:
        """Preconditioner z ≈ L_II⁻¹ r of planes [d, *shape], and where a search begins."""
        if method not in self._filters:
            stencil, h2 = self.stencil, self.stencil.spacing**2
            args = self.grid, stencil.steps, stencil.tensors * h2
            make = {"sine": sine, "multigrid": multigrid}.get(method)
            inner = make(*args, stencil.elastic) if make else torus_inverse(*args)
            edge = edge_elimination(self.grid, stencil) if method == "strip" else None

            def apply(r: ndarray) -> ndarray:
                z = inner(r) * h2
                return z if edge is None else z - edge(self._product(z))

            self._filters[method] = apply, edge
        return self._filters[method]

    def _product(self, field: ndarray) -> ndarray:
        """Product of L with planes [d, *shape], at the unknowns, zero elsewhere."""
        return np.asarray(self.pull(self.grid.around(field)[None])[0])

    def _inverted(
        self, right: ndarray, method: str, tolerance: float
    ) -> tuple[ndarray, SolveRecord]:
        """Solution of L_II x = r in planes [d, *shape]."""
        if self.dtype != np.float64:
            raise InputError(f"dtype: expected float64 for a solve, got {self.dtype}")
        apply, begin = self.filter(method)
        return definite(
            self._product,
            apply,
            right,
            tolerance,
            begin=begin,
            where=f" on these {len(self.grid.interior)} nodes",
            hint=f", or so nearly incompressible that {method} does not come close to it: try "
            "strip, or lu where nodes are few",
        )

    def inverse(
        self, right: ndarray, tolerance: float, method: str | None = None
    ) -> tuple[ndarray, SolveRecord]:
        """Solution L_II⁻¹ b of an interior field [I, d], zero on the collar, and its record."""
        planes = self.grid.scatter_interior(right)
        z, record = self._inverted(planes, self.method(method), tolerance)
        return self.grid.gather(z[None])[0], record

    def cheapest_inverse(self, loads: int, *, definite: bool = True) -> Inverse:
        """L_II⁻¹ for so many loads: factorised, or iterated to the tolerance that it is asked for.
        Few nodes are factorised even if L_II is not proven definite; `definite` False takes any
        factors. InputError as check_definite for more nodes, and for bad factors."""
        grid, nodes, how = self.grid, len(self.grid.interior), self.method(loads=loads)
        try:
            self.check_definite()
            if how != "lu":
                return lambda right, tolerance: self.inverse(right, tolerance)[0]
        except InputError:
            if nodes > DIRECT:
                raise
            if definite and definite_factors(block(self.stencil, grid.mask())) is None:
                raise
        factors, axes = factorised(block(self.stencil, grid.mask())), grid.axes
        order = np.argsort(grid.interior)  # as they follow one another in the box

        def solved(right: ndarray, tolerance: float) -> ndarray:
            found = np.empty_like(right)
            found[order] = factors.solve((right @ axes)[order].ravel()).reshape(right.shape)
            return np.asarray(found @ axes.T)

        return solved

    def solve(
        self, b: ndarray, u: ndarray, tolerance: float, method: str | None = None
    ) -> tuple[ndarray, list[SolveRecord]]:
        """Solve L u = b at the interior nodes, u given elsewhere.

        Args:
            b: loads [stress/length] on all nodes, shape [S, N, d]; only the interior's are read.
            u: displacement on all nodes, same shape; only the collar's is read. On a period nothing
                is, and the answer's mean is zero.
            tolerance: of the true relative residual.
            method: what stands before conjugate gradients; None takes the cheapest.

        Raises InputError for a method that does not fit, or a solve that stalls.
        """
        asked, method = self.points.interior[:, None], self.method(method)
        answer, records = np.where(asked, 0.0, u), []
        for one, field in zip(b, answer):
            right = self.grid.within(self.grid.scatter(np.where(asked, one, 0.0)[None]))
            if self.grid.periodic:
                over: Any = {"axis": tuple(range(2, right.ndim)), "keepdims": True}
                largest = np.abs(right).max(**over)
                right = right - right.mean(**over)
                right = np.where(np.abs(right).max(**over) > ROUNDING * largest, right, 0.0)
            else:
                right = right - self.pull(self.grid.scatter(field[None]))
            z, took = self._inverted(right[0], method, tolerance)
            field[self.points.interior] = self.grid.gather(z[None])[0]
            records.append(took)
        return answer, records


def smallest_ratio(symbol: ndarray, torus: Shape) -> float:
    """Smallest Λmin D(k) / Σ_a 4 sin²(k_a h/2) over waves k ≠ 0 of a torus and its torus_symbol."""
    waves = [4 * np.sin(np.pi * np.arange(n) / n) ** 2 for n in torus]
    waves[-1] = waves[-1][: symbol.shape[-1]]
    s = reduce(np.add.outer, waves).ravel()
    D, smallest = symbol.reshape(*symbol.shape[:2], -1).T, np.inf
    for first in range(1, len(s), WAVES):  # k = 0 is the first
        part = slice(first, first + WAVES)
        smallest = min(smallest, float((smallest_eigenvalue(D[part]) / s[part]).min()))
    return smallest


def edge_elimination(grid: Grid, stencil: Stencil) -> ArrayMap:
    """Edge elimination z = E A_ee⁻¹ Eᵗ r of planes r [d, *shape]: displacement on nodes within a
    reach of the edge that leaves no residual there, else zero."""
    mask = grid.mask()
    depth = distance_transform_cdt(np.pad(mask, 1), "chessboard")[(slice(1, -1),) * mask.ndim]
    near = mask & (depth <= grid.reach)
    return partial(solved, symmetric_factors(block(stencil, near)), near)


def solved(factors: Any, mask: ndarray, r: ndarray) -> ndarray:
    """Solution of a block's factors for r, in planes [d, *shape], zero off the mask."""
    z = np.zeros_like(r)
    z[:, mask] = factors.solve(np.ascontiguousarray(r[:, mask].T).ravel()).reshape(-1, len(r)).T
    return z


SINE_SHIFT, SHIFT = 0.4, 1.0
"""Of the short-range filters beside the sine transform and beside multigrid, in shear moduli."""
COARSEST = 400
"""Most nodes of a level that is factorised, as what is one or two nodes wide always is."""
SMOOTHED = 4.0
"""The Chebyshev smoother, of degree two, covers eigenvalues from 1/SMOOTHED of the largest."""
AXIS_WAVES = 16
"""Along an axis, at which the largest eigenvalue of the nearest cells is looked for."""


def shear(elastic: ndarray) -> float:
    """Mean shear modulus: of C_ijij − C_iijj/d, over the number of shears."""
    d = elastic.shape[0]
    return float((np.einsum("ijij", elastic) - np.einsum("iijj", elastic) / d) / (d * (d + 1) - 2))


def torus_inverse(
    nodes: Grid, steps: ndarray, tensors: ndarray, shift: ndarray | float = 0.0
) -> ArrayMap:
    """Filter (D(k) + shift I)⁻¹ on the torus around the nodes, cut off at them."""
    torus = torus_shape(nodes)
    kind = np.float64 if nodes.periodic else np.float32  # on a period it is the whole inverse
    symbol = torus_symbol(torus, steps, tensors)
    symbol[range(len(torus)), range(len(torus))] += shift
    table = inverse(symbol).astype(kind)
    mask = nodes.mask()

    def apply(r: ndarray) -> ndarray:
        return np.asarray(convolved(table, r.astype(kind), torus) * mask, np.float64)

    return apply


def seen_by_coarser(torus: Shape) -> ndarray:
    """Factor p = Π (1 + cos k_a h)/2 of prolongation at the waves of a torus."""
    seen = [(1 + np.cos(2 * np.pi * np.arange(n) / n)) / 2 for n in torus]
    seen[-1] = seen[-1][: torus[-1] // 2 + 1]
    return reduce(np.multiply.outer, seen)


def sine(nodes: Grid, steps: ndarray, tensors: ndarray, elastic: ndarray) -> ArrayMap:
    """Filter for boxes: z = H ∗ r + S D_a⁻¹ shift (D_a + shift)⁻¹ S r, S the DST-I, the symbol's
    diagonal D_a = D_aa in the sine basis at long waves, all of it at short ones."""
    d, core = nodes.dimension, nodes.core
    shift = SINE_SHIFT * shear(elastic)
    short = torus_inverse(nodes, steps, tensors, shift)
    sizes = nodes.unknown.shape
    angles = [np.pi * np.arange(1, n + 1) / (n + 1) for n in sizes]
    D = np.zeros((d, *sizes))
    for step, c in zip(steps, tensors[:, np.arange(d), np.arange(d)]):
        # the mean over signs of the waves: a product of cosines
        wave = reduce(np.multiply.outer, [np.cos(angle * s) for angle, s in zip(angles, step)])
        D += 2 * c.reshape(d, *([1] * d)) * (1 - wave)
    gain = (shift / (D * (D + shift))).astype(np.float32)
    axes = tuple(range(1, d + 1))

    def apply(r: ndarray) -> ndarray:
        z = short(r)
        inner = r[:, *core].astype(np.float32)
        wave = scipy.fft.dstn(inner, type=1, axes=axes, workers=get_num_threads()) * gain
        z[:, *core] += scipy.fft.idstn(wave, type=1, axes=axes, workers=get_num_threads())
        return z

    return apply


def multigrid(nodes: Grid, steps: ndarray, tensors: ndarray, elastic: ndarray) -> ArrayMap:
    """Filter for any mask: short waves by a filter on the torus, long ones by a V-cycle, added. z =
    mask (H ∗ r + P V(Pᵗ r)), H = (D + shift p(k))⁻¹ with p of `seen_by_coarser`; V is a V-cycle for
    Q1 elements of the same moduli on every second node."""
    seen = seen_by_coarser(torus_shape(nodes))
    short = torus_inverse(nodes, steps, tensors, SHIFT * shear(elastic) * seen)
    mask = nodes.unknown
    coarse = coarser(mask)
    if not coarse.any():
        return short
    cycle = VCycle(*q1_tensors(elastic * 2.0 ** (nodes.dimension - 2)), coarse)
    core = (slice(None), *nodes.core)

    def apply(r: ndarray) -> ndarray:
        z = short(r)
        z[core] += prolong(cycle(restrict(r[core]) * coarse), mask.shape) * mask
        return z

    return apply


def coarser(mask: ndarray) -> ndarray:
    """Mask of a coarser level: every second node along each axis, from the second on."""
    return mask[(slice(1, None, 2),) * mask.ndim]


def _spread(field: ndarray) -> ndarray:
    """Planes [d, …] and half of what is beside, along each axis."""
    for axis in range(1, field.ndim):
        field = convolve1d(field, (0.5, 1.0, 0.5), axis, mode="constant")
    return field


def restrict(field: ndarray) -> ndarray:
    """Restriction Pᵗ: sums of planes [d, …] with weights 1 and 1/2 along each axis."""
    return _spread(field)[:, *[slice(1, None, 2)] * (field.ndim - 1)]


def prolong(field: ndarray, shape: Shape) -> ndarray:
    """Prolongation P: linear interpolation of coarser planes to a box of the given shape."""
    fine = np.zeros((len(field), *shape), field.dtype)
    fine[:, *[slice(1, None, 2)] * len(shape)] = field
    return _spread(fine)


def largest(steps: ndarray, tensors: ndarray) -> float:
    """Largest eigenvalue of a stencil over its diagonal on a lattice, hence on any mask."""
    scale = 1 / np.sqrt(2 * np.diag(tensors.sum(axis=0)))
    phase = 2 * np.pi / AXIS_WAVES * grid_places((AXIS_WAVES,) * tensors.shape[-1])
    symbol = Stencil(1.0, steps, scale[:, None] * tensors * scale).symbol(phase)
    return -float(smallest_eigenvalue(-symbol).min())


class VCycle:
    """V-cycle z ≈ A⁻¹ r for a stencil on a mask; symmetric and positive. Each coarser level has the
    same stencil, of nearest cells, times 2^(d − 2)."""

    coarser: Any = None
    factors: Any = None

    def __init__(self, steps: ndarray, tensors: ndarray, mask: ndarray) -> None:
        self._lay(steps, tensors, mask)
        if np.count_nonzero(mask) <= COARSEST or min(mask.shape) < 3:
            self.factors = symmetric_factors(block(Stencil(1.0, steps, tensors), mask))
            return
        self.largest = largest(steps, tensors)
        coarse = coarser(mask)
        if coarse.any():
            self.coarser = VCycle(steps, tensors * 2.0 ** (mask.ndim - 2), coarse)

    def _lay(self, steps: ndarray, tensors: ndarray, mask: ndarray) -> None:
        d, self.reach = mask.ndim, int(np.abs(steps).max())
        self.mask, self.shape = mask, mask.shape
        asked = np.pad(mask, self.reach)
        place = np.flatnonzero(asked)
        nodes = Grid(np.eye(d), asked.shape, self.reach, False, np.arange(len(place)), place, place)
        self.rows = ByRows(nodes, steps, tensors)
        self.diagonal = 2 * np.diag(tensors.sum(axis=0)).reshape(d, *([1] * d))

    def around(self, field: ndarray) -> ndarray:
        """Planes [d, …] padded by as many nodes as the stencil reaches."""
        return np.pad(field, [(0, 0)] + [(self.reach,) * 2] * self.mask.ndim)

    def restrict(self, field: ndarray) -> ndarray:
        """Restrict planes to the coarser level."""
        return restrict(field)

    def prolong(self, field: ndarray) -> ndarray:
        """Prolong planes from the coarser level."""
        return prolong(field, self.shape)

    def product(self, field: ndarray) -> ndarray:
        """Apply the level's operator to planes [d, …]."""
        inner = (0, slice(None)) + (slice(self.reach, -self.reach),) * self.mask.ndim
        return self.rows(self.around(field)[None])[inner]

    def _smoothed(self, r: ndarray, z: ndarray | None) -> ndarray:
        """Two Chebyshev iterations of the operator over its diagonal, from z or from zero."""
        middle, radius = (self.largest * (1 + sign / SMOOTHED) / 2 for sign in (1, -1))
        left = r if z is None else r - self.product(z)
        step = left / self.diagonal / middle
        z = step if z is None else z + step
        now = 1 / (2 * middle / radius - radius / middle)
        left = r - self.product(z)
        step = now * (radius / middle * step + 2 / radius * (left / self.diagonal))
        return np.asarray(z + step)

    def __call__(self, r: ndarray) -> ndarray:
        """Approximate solution z ≈ A⁻¹ r for r zero outside the mask."""
        if self.factors is not None:
            return solved(self.factors, self.mask, r)
        z = self._smoothed(r, None)
        if self.coarser is not None:
            left = self.restrict(r - self.product(z)) * self.coarser.mask
            z = z + self.prolong(self.coarser(left)) * self.mask
        return self._smoothed(r, z)
