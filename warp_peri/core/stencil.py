"""Linear solids on one lattice as stencils: L u(x) = Σ C(ξ) (u(x) − u(x + ξ)) (theory, T1–T2).

C(−ξ) = C(ξ) is symmetric. Every homogeneous linear material on a lattice is a stencil, and what is
proven, transferred or solved on lattices is written for stencils alone. Their products are taken in
a box of nodes with all that bonds reach, by rows or by FFT (T1, T15).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.fft
import scipy.sparse as sp
import warp as wp
from numpy import ndarray
from numpy.linalg import eigh, eigvalsh, inv, norm, svd

from warp_peri.core.elastic import directions, orbit_grid, symmetric_part
from warp_peri.errors import InputError, Several, Shape
from warp_peri.kernels.micromodulus import rows
from warp_peri.points.arguments import ArrayMap, Pair
from warp_peri.points.families import HORIZON_TOLERANCE, nodes_in_period
from warp_peri.points.points import Points, grid_places, grid_points
from warp_peri.runtime import floats, get_num_threads, ints, launch_slices

DIRECTIONS = {2: 60, 3: 200}
"""Of long waves."""
LONG = 1e-3
"""Their |k| h."""
LEAST_WAVE = 1e-4
"""|k| h, below which waves are not looked at: they answer as long ones do."""
MOST_BONDS = 4000
"""Of a half family; a horizon beyond it is a slip of units."""
SPARE = 60
"""Largest box, in places a node; beyond that the nodes lie too far apart to be laid out."""
SCALARS = {np.dtype(np.float64): wp.float64, np.dtype(np.float32): wp.float32}
FASTER = 4
"""How much less than a usual node a lane of a piece has to do, for the number of threads."""
FFT_BONDS = {2: 75, 3: 120}
"""Half families from which FFT takes less time than rows, the middle of four measurements."""


@dataclass(frozen=True, eq=False)
class Stencil:
    """A linear solid, or a conductor of one component, on one lattice.

    Attributes:
        spacing: h [length].
        steps: ξ/h of one half of the bonds, shape [H, d] of whole numbers.
        tensors: C(ξ) [stress/length²], shape [H, c, c], c components of the field.
    """

    spacing: float
    steps: ndarray
    tensors: ndarray

    @property
    def dimension(self) -> int:
        """Dimension of space: 2 or 3."""
        return int(self.steps.shape[1])

    @property
    def reach(self) -> int:
        """Largest step along an axis, in spacings."""
        return int(np.abs(self.steps).max())

    def symbol(self, phase: ndarray) -> ndarray:
        """Symbol D(k) = 2 Σ C(ξ) (1 − cos k·ξ) at k h = `phase`, [K, d] to [K, c, c]."""
        return np.tensordot(bend(phase, self.steps), self.tensors, 1)

    @cached_property
    def brackets(self) -> ndarray:
        """Brackets [ij, kl] = Σ C_ij ξ_k ξ_l over the half [stress], shape [c, c, d, d] (T3)."""
        xi = self.spacing * self.steps
        return np.asarray(np.einsum("nij,nk,nl->ijkl", self.tensors, xi, xi, optimize=True))

    @cached_property
    def elastic(self) -> ndarray:
        """Elastic tensor of long waves along the nodes' axes [stress], shape [d, d, d, d] (T4)."""
        return elastic_from_brackets(self.brackets)

    def asymmetry(self, group: ndarray) -> float:
        """Largest error of C(Rξ) = R C(ξ) Rᵗ over R [g, d, d], relative to the largest entry."""
        number, worst = numbers_of(self.steps), 0.0
        for g in group:
            images = [number.get(tuple(s), -1) for s in (self.steps @ g.T).tolist()]
            if -1 in images:
                return np.inf
            worst = max(worst, float(np.abs(self.tensors[images] - g @ self.tensors @ g.T).max()))
        return worst / max(float(np.abs(self.tensors).max()), 1e-300)

    def minus(self, other: Stencil, factor: float = 1.0) -> Stencil:
        """The stencil less a factor times another on the same lattice."""
        steps = np.concatenate([self.steps, other.steps])
        first = steps @ (2 * int(np.abs(steps).max()) + 1) ** np.arange(steps.shape[1]) > 0
        steps = np.where(first[:, None], steps, -steps)  # ξ and −ξ are one bond
        tensors = np.concatenate([self.tensors, -factor * other.tensors])
        kept, place = np.unique(steps, axis=0, return_inverse=True)
        joined = np.zeros((len(kept), *tensors.shape[1:]))
        np.add.at(joined, place.ravel(), tensors)
        return Stencil(self.spacing, kept, joined)


def numbers_of(steps: ndarray) -> dict[tuple[int, ...], int]:
    """Number of the bond of each step ξ/h of a half family, and of −ξ/h."""
    return {tuple(xi): n for half in (steps, -steps) for n, xi in enumerate(half.tolist())}


def numbers_at(shape: Any, places: Any) -> ndarray:
    """Numbers of places, which are indices or a mask, in an array of a shape; −1 elsewhere."""
    number = np.full(shape, -1)
    number[places] = np.arange(number[places].size)
    return number


def stencil_in_box(spacing: float, C: ndarray, least: float = 0.0) -> Stencil:
    """Stencil of C(ξ) = C(−ξ) at all places of a box about ξ = 0, [*box, c, c]: of ξ and −ξ one,
    and none whose entries are at most a share `least` of the largest."""
    steps, tensors = grid_places(C.shape[:-2]), C.reshape(-1, *C.shape[-2:])
    size = np.abs(tensors).max(axis=(1, 2))
    size[: len(size) // 2 + 1] = 0.0
    kept = size > least * size.max()
    return Stencil(spacing, (steps - steps[-1] // 2)[kept], tensors[kept])


def laplacian_stencil(spacing: float, dimension: int, components: int) -> Stencil:
    """Stencil of the 2 d + 1-point Laplacian times the identity [1/length²]; its symbol is s(k)."""
    steps = np.eye(dimension, dtype=np.int64)
    return Stencil(spacing, steps, np.tile(np.eye(components), (dimension, 1, 1)) / spacing**2)


def bend(phase: ndarray, steps: ndarray) -> ndarray:
    """2 (1 − cos k·ξ) without cancellation at small k, shape [K, H]."""
    return np.asarray(4 * np.sin(phase @ steps.T / 2) ** 2)


def smallest_eigenvalue(matrices: ndarray) -> ndarray:
    """Smallest eigenvalue of symmetric matrices [..., c, c], shape [...]."""
    if matrices.shape[-1] == 2:  # much faster than by LAPACK
        a, b, c = matrices[..., 0, 0], matrices[..., 1, 1], matrices[..., 0, 1]
        return np.asarray((a + b) / 2 - np.hypot((a - b) / 2, c))
    return eigvalsh(matrices)[..., 0]


def zoomed(
    of: ArrayMap, k: ndarray, reach: float, *, side: int = 7, zooms: int = 8, finer: float = 3
) -> Pair:
    """Smallest ratio `of` waves k h [K, d], by `side` an axis about each k [n, d], on grids ever
    finer by a factor, and where it is, [n] and [n, d]; waves below LEAST_WAVE do not count."""
    patch = grid_points(np.linspace(-1, 1, side), k.shape[1])
    value = np.full(len(k), np.inf)
    for _ in range(zooms):
        near = k[:, None] + reach * patch
        seen = (near**2).sum(axis=2) > LEAST_WAVE**2
        found = np.full(seen.shape, np.inf)
        found[seen] = of(near[seen])
        best = np.arange(len(k)), found.argmin(axis=1)
        k, value, reach = near[best], found[best], reach / finer
    return value, k


def elastic_from_brackets(brackets: ndarray) -> ndarray:
    """Elastic tensor [ik, jl] + [jk, il] − [jl, ik] of brackets (T4), symmetric after Huang."""
    first, second, third = (
        np.einsum(f"...{order}->...agbl", brackets) for order in ("abgl", "bgal", "blag")
    )
    return np.asarray(first + second - third)


def half_ball(reach: float, dimension: int) -> ndarray:
    """Steps ξ/h of one half of the bonds with |ξ| ≤ reach h, shape [H, d]. InputError for a ball
    without bonds, or with more than MOST_BONDS of a half."""
    most = min(reach, 4.0 * MOST_BONDS) ** 2 * (1 + HORIZON_TOLERANCE) ** 2
    side = int(np.sqrt(most))
    if (2 * side + 1) ** dimension > 4 * MOST_BONDS:
        raise InputError(f"horizon: expected a few spacings, got {reach:g} of them")
    grid = grid_places(dimension * (2 * side + 1,)) - side
    grid = grid[len(grid) // 2 + 1 :]  # of ξ and −ξ just one
    half: ndarray = grid[(grid**2).sum(axis=1) <= most]
    if not len(half):
        raise InputError(f"horizon: expected at least one spacing, got {reach:g} of them")
    return half[np.argsort((half**2).sum(axis=1), kind="stable")]


def laplacian(phase: ndarray) -> ndarray:
    """Laplacian symbol s(k) h² = 4 Σ sin²(k_a h/2) at k h = `phase`, shape [K]."""
    return np.asarray(4 * (np.sin(phase / 2) ** 2).sum(axis=1))


def zone_sample(group: ndarray, dimension: int, intervals: int) -> ndarray:
    """Phases k h of one wave per orbit of a grid on the zone, and of very long waves, [K, d]."""
    grid = orbit_grid(intervals, group, dimension)
    axes = grid_places((3,) * dimension) - 1.0
    axes = axes[axes.any(axis=1)]
    axes /= norm(axes, axis=1)[:, None]
    return np.concatenate([grid, LONG * axes, LONG * directions(DIRECTIONS[dimension], dimension)])


def ratios(
    steps: ndarray, tensors: ndarray, phase: ndarray, wave: ndarray | None = None
) -> Several:
    """Λmin D/s h^−2 at k h = `phase`, [K], and its eigenvectors, [K, d]; `wave`: known bend."""
    symbol = np.tensordot(bend(phase, steps) if wave is None else wave, tensors, 1)
    value, vector = eigh(symbol)
    return value[:, 0] / laplacian(phase), vector[:, :, 0]


@dataclass(frozen=True, eq=False)
class Basis:
    """Half of a family and the bond tensors that a symmetry group allows on it.

    Attributes:
        steps: ξ/h, shape [H, d] int64; the other half is −steps.
        basis: invariant tensors: C(ξ) = Σ_a p_a basis[a, ξ], shape [P, H, d, d].
    """

    steps: ndarray
    basis: ndarray

    @property
    def dimension(self) -> int:
        """Dimension of space: 2 or 3."""
        return int(self.steps.shape[1])

    def symbol(self, phase: ndarray) -> ndarray:
        """Symbols 2 Σ (1 − cos k·ξ) basis at k h = `phase`, [K, d] to [K, P, d, d]."""
        return np.tensordot(bend(phase, self.steps), self.basis, (1, 1))

    def moments(self) -> ndarray:
        """Brackets [ij, kl] of each basis tensor in units of h² (T3), shape [P, d, d, d, d]."""
        x = self.steps.astype(float)
        return np.asarray(np.einsum("anij,nk,nl->aijkl", self.basis, x, x, optimize=True))


def invariant_basis(reach: float, group: ndarray) -> Basis:
    """Basis of half-ball tensors with C(Rξ) = R C(ξ) Rᵗ for integer R with −1, [g, d, d]."""
    d = group.shape[1]
    steps = half_ball(reach, d)
    number, (i, j) = numbers_of(steps), np.triu_indices(d)
    n = np.arange(d * (d + 1) // 2)
    plain = np.zeros((len(n), d, d))  # an orthonormal basis of symmetric matrices
    plain[n, i, j] = plain[n, j, i] = np.where(i == j, 1.0, np.sqrt(0.5))
    seen, basis = np.zeros(len(steps), bool), []
    for first, step in enumerate(steps):
        if seen[first]:
            continue
        image = np.array([number[tuple(g @ step)] for g in group])
        seen[image] = True
        fixing = group[image == first]  # ξ and −ξ carry the same tensor
        mean = np.mean([np.kron(g, g) for g in fixing], axis=0)
        vectors, size, _ = svd(mean @ plain.reshape(-1, d * d).T)
        for tensor in vectors[:, : len(size)].T[size > 0.5]:
            on_bonds = np.zeros((len(steps), d, d))
            on_bonds[image] = group @ tensor.reshape(d, d) @ group.mT
            basis.append(symmetric_part(on_bonds))
    return Basis(steps, np.array(basis))


@dataclass(frozen=True, eq=False)
class Grid:
    """Places of nodes in a box around the unknowns that holds every node they feel.

    Attributes:
        axes: of the lattice, as columns, shape [d, d].
        shape: of the box: that of the interior with `reach` more on each side, or the period.
        reach: steps that a bond may lead along an axis.
        periodic: whether the box closes on itself.
        near, place: numbers of the nodes in the box, and their places in it, flat.
        interior: places of the interior nodes, flat, in the order of the point set.
    """

    axes: ndarray
    shape: Shape
    reach: int
    periodic: bool
    near: ndarray
    place: ndarray
    interior: ndarray

    @property
    def dimension(self) -> int:
        """Dimension of space: 2 or 3."""
        return len(self.shape)

    @property
    def wide(self) -> Shape:
        """Shape of the box with, around a period, its images within reach."""
        return tuple(n + 2 * self.reach * self.periodic for n in self.shape)

    @property
    def core(self) -> tuple[slice, ...]:
        """Slices of the interior's box in the wide one."""
        r = self.reach
        return tuple(slice(r, n - r) for n in self.wide)

    @property
    def is_box(self) -> bool:
        """Whether all nodes of the interior's box are unknown."""
        return bool(self.periodic or self.unknown.all())

    def mask(self) -> ndarray:
        """Which places of the box are unknown, in its shape."""
        asked = np.zeros(np.prod(self.shape), bool)
        asked[self.interior] = True
        return asked.reshape(self.shape)

    @property
    def unknown(self) -> ndarray:
        """Which places of the interior's box are unknown, in that box's shape."""
        return self.mask() if self.periodic else self.mask()[self.core]

    def scatter(self, u: ndarray, dtype: type = np.float64) -> ndarray:
        """Vectors of all nodes [S, N, d] along the lattice's axes, in planes [S, d, *wide]."""
        field: ndarray = np.zeros((len(u), self.dimension, np.prod(self.shape)), dtype)
        field[:, :, self.place] = (u[:, self.near] @ self.axes).mT
        return self.around(field.reshape(len(u), self.dimension, *self.shape))

    def around(self, field: ndarray) -> ndarray:
        """A field [..., n, …] with its images beside it on a period, as it is elsewhere."""
        if not self.periodic:
            return field
        rest = field.ndim - self.dimension
        return np.pad(field, [(0, 0)] * rest + [(self.reach,) * 2] * self.dimension, mode="wrap")

    def within(self, planes: ndarray) -> ndarray:
        """Planes [S, d, *wide] without the images around a period, [S, d, *shape]."""
        return planes[:, :, *self.core] if self.periodic else planes

    def scatter_interior(self, inner: ndarray) -> ndarray:
        """Vectors of the interior nodes [I, d] laid out in planes [d, *shape], zero elsewhere."""
        field = np.zeros((self.dimension, np.prod(self.shape)))
        field[:, self.interior] = (inner @ self.axes).T
        return field.reshape(self.dimension, *self.shape)

    def gather(self, planes: ndarray, place: ndarray | None = None) -> ndarray:
        """Values of planes [S, d, *shape] at interior nodes, along the points' axes, [S, I, d], or
        at the nodes of other places."""
        place = self.interior if place is None else place
        flat = planes.reshape(*planes.shape[:2], -1)[:, :, place]
        return np.ascontiguousarray(flat.mT @ self.axes.T.astype(planes.dtype))


def grid_of(points: Points, steps: ndarray, *, why: str = "", least: int | None = None) -> Grid:
    """Lay the nodes of a lattice out for bonds of the given steps, shape [H, d] of one half.

    `why` is said of nodes whose bonds are cut; a period must be longer than `least` steps, by
    default twice the reach. Raises InputError for scattered points, another dimension, nodes off
    the lattice or given twice, interior nodes that lack neighbours, and too short a period.
    """
    d = steps.shape[1]
    if points.dimension != d:
        raise InputError(f"points: expected {d} coordinates, got {points.dimension}")
    grid, axes = points.lattice
    reach = int(np.abs(steps).max())
    if points.box is not None:
        shape = (*nodes_in_period(points, 2 * reach if least is None else least).tolist(),)
        grid = grid % shape
        place = np.ravel_multi_index(tuple(grid.T), shape)
        near = np.arange(len(grid))
    else:
        inside = grid[points.interior]
        corner = inside.min(axis=0) - reach
        shape = tuple((inside.max(axis=0) - corner + 1 + reach).tolist())
        if np.prod(shape, dtype=float) > SPARE * len(grid) + 1e6:
            raise InputError(f"points: the interior of {len(inside)} nodes spans a box of {shape}")
        near = np.flatnonzero(((grid >= corner) & (grid < corner + shape)).all(axis=1))
        place = np.ravel_multi_index(tuple((grid[near] - corner).T), shape)
    number = np.full(len(grid), -1)
    number[near] = place
    nodes = Grid(axes, shape, reach, points.box is not None, near, place, number[points.interior])
    _check(points, nodes, steps, why)
    return nodes


def _check(points: Points, nodes: Grid, steps: ndarray, why: str) -> None:
    """Refuse nodes given twice, and interior nodes whose bonds lead nowhere."""
    there = np.bincount(nodes.place, minlength=np.prod(nodes.shape))
    if there.max() > 1:
        raise InputError("points: expected every node once, got two at one place")
    body = there.astype(bool)
    if points.outside is not None:
        body[nodes.place[points.outside[nodes.near]]] = False
    body = nodes.around(body.reshape(nodes.shape))
    lacking = int((nodes.unknown & ~complete(body, steps, nodes.reach)).sum())
    refuse_cut(lacking, len(nodes.interior), points.spacing * steps, why)


def complete(body: ndarray, steps: ndarray, r: int) -> ndarray:
    """Whether each place of a body's mask, padded by r, has its neighbours by all ±steps."""
    whole = np.ones([n - 2 * r for n in body.shape], bool)
    for step in np.concatenate([steps, -steps]):
        whole &= body[tuple(slice(r + s, n - r + s) for s, n in zip(step, body.shape))]
    return whole


def block(stencil: Stencil, mask: ndarray, *, around: bool = False) -> sp.csc_array:
    """Matrix of the operator between a mask's nodes, shape [d n, d n]; `around`: of a period."""
    d, here = stencil.dimension, np.argwhere(mask)
    number = numbers_at(mask.shape, mask)
    rows, columns = [np.arange(len(here))], [np.arange(len(here))]
    values = [np.broadcast_to(2 * stencil.tensors.sum(axis=0), (len(here), d, d))]
    both = np.concatenate([stencil.steps, -stencil.steps])
    for step, C in zip(both, np.concatenate([stencil.tensors] * 2)):
        there = (here + step) % mask.shape if around else here + step
        inside = np.flatnonzero(((there >= 0) & (there < mask.shape)).all(axis=1))
        other = number[*there[inside].T]
        rows.append(inside[other >= 0])
        columns.append(other[other >= 0])
        values.append(np.broadcast_to(-C, (len(rows[-1]), d, d)))
    row, column, value = map(np.concatenate, (rows, columns, values))
    i, j = np.indices((d, d)).reshape(2, -1)
    at = ((d * row[:, None] + i).ravel(), (d * column[:, None] + j).ravel())
    return sp.csc_array((value.ravel(), at), shape=2 * (d * len(here),))


def refuse_cut(lacking: int, count: int, xi: ndarray, why: str = "") -> None:
    """Raise InputError where some of `count` interior nodes lack neighbours by bonds ξ [H, d]."""
    if lacking:
        why = why or f"; give a collar {norm(xi, axis=1).max():g} wide"
        raise InputError(
            f"points: expected all bonds of every interior node, got {lacking} of "
            f"{count} nodes with cut bonds{why}"
        )


class ByRows:
    """Stencil product by rows; the bits are the same on any number of threads."""

    def __init__(
        self, nodes: Grid, steps: ndarray, tensors: ndarray, dtype: Any = np.float64
    ) -> None:
        self.nodes, self.dtype, self.scalar = nodes, np.dtype(dtype), SCALARS[np.dtype(dtype)]
        self.kernels = rows(self.scalar, nodes.dimension)
        strides = np.array([math.prod(nodes.wide[a + 1 :]) for a in range(nodes.dimension)])
        self.offset = ints(steps @ strides)
        upper = tensors[:, *np.triu_indices(nodes.dimension)]  # of symmetric matrices
        self.tensors = floats(np.ascontiguousarray(upper, self.dtype), self.scalar)
        mask = np.zeros(nodes.wide, bool)
        mask[nodes.core] = nodes.unknown
        places = np.flatnonzero(mask)
        self.asked: Any = ints(row_pieces(places, self.kernels.lanes, places)[:, ::2], wp.vec2i)

    def __call__(self, planes: ndarray) -> ndarray:
        """L u at the unknown nodes of planes [S, d, *wide]; planes [S, d, *shape], else zero."""
        nodes, count, lanes = self.nodes, len(planes), self.kernels.lanes
        room = np.zeros(planes.size + lanes, self.dtype)  # for lanes that read beyond
        laid = room[:-lanes].reshape(count, -1)
        laid[:] = planes.reshape(count, -1)
        out = np.zeros_like(laid)
        ends = (floats(one, self.scalar) for one in (laid, out))
        given, how = (self.asked, self.offset, self.tensors, *ends), lanes // FASTER
        launch_slices(self.kernels.pulled, len(self.asked), given, samples=count, weight=how)
        return nodes.within(out.reshape(planes.shape))


def row_pieces(places: ndarray, lanes: int, numbers: ndarray) -> ndarray:
    """Cut runs of rising places and numbers to lanes: first place, first number, count [P, 3]."""
    begin = np.flatnonzero(np.diff(places, prepend=-2) - 1 | np.diff(numbers, prepend=-2) - 1)
    length = np.diff(np.append(begin, len(places)))
    parts = -(-length // lanes)
    step = lanes * (np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts))
    first = np.repeat(begin, parts) + step
    count = np.minimum(np.repeat(length, parts) - step, lanes)
    return np.stack([places[first], numbers[first], count], axis=1).astype(np.int32)


class ByFFT:
    """Stencil product by FFT on a torus that nothing reaches around, exact but for rounding."""

    def __init__(
        self, nodes: Grid, steps: ndarray, tensors: ndarray, dtype: Any = np.float64
    ) -> None:
        self.nodes, self.dtype = nodes, np.dtype(dtype)
        self.torus = torus_shape(nodes)
        self.symbol = torus_symbol(self.torus, steps, tensors).astype(self.dtype)
        self.mask = nodes.mask()

    def __call__(self, planes: ndarray) -> ndarray:
        """L u at the unknown nodes of planes [S, d, *wide]; planes [S, d, *shape], else zero."""
        out = [convolved(self.symbol, one, self.torus) for one in self.nodes.within(planes)]
        return np.asarray(out * self.mask)


def torus_shape(nodes: Grid) -> Shape:
    """Shape of a torus that holds the box and keeps its images apart; a period is its own."""
    if nodes.periodic:
        return nodes.shape
    return tuple(scipy.fft.next_fast_len(n, real=True) for n in nodes.shape)


def torus_symbol(torus: Shape, steps: ndarray, tensors: ndarray) -> ndarray:
    """Symbol D(k) (or D(k) h², as tensors are) at waves of a torus [d, d, *half a torus]."""
    d = len(torus)
    symbol = np.empty((d, d, *torus[:-1], torus[-1] // 2 + 1))
    place = np.ravel_multi_index(tuple(np.concatenate([steps, -steps]).T), torus, mode="wrap")
    for i, j in zip(*np.triu_indices(d)):
        stencil, c = np.zeros(torus), tensors[:, i, j]
        np.subtract.at(stencil.reshape(-1), place, np.concatenate([c, c]))
        stencil.flat[0] += 2 * c.sum()
        wave = scipy.fft.rfftn(stencil, workers=get_num_threads(), overwrite_x=True)
        symbol[i, j] = symbol[j, i] = wave.real
    return symbol


def convolved(symbol: ndarray, field: ndarray, torus: Shape) -> ndarray:
    """Convolve a symbol with one field [d, …] in a corner of the torus, there."""
    how = {"s": torus, "axes": range(1, len(torus) + 1), "workers": get_num_threads()}
    mixed = np.einsum("ij...,j...->i...", symbol, scipy.fft.rfftn(field, **how))
    whole = scipy.fft.irfftn(mixed, overwrite_x=True, **how)
    return np.asarray(whole[:, *map(slice, field.shape[1:])])


def inverse(symbol: ndarray) -> ndarray:
    """Inverse of symbol matrices [d, d, …], in their place; 0 where that has none (k = 0)."""
    at_rest = symbol.T[(0,) * (symbol.ndim - 2)].T
    if none := np.abs(at_rest).max() <= 1e-12 * np.abs(symbol).max():
        at_rest[:] = np.eye(len(symbol))
    for row in range(symbol.shape[2]):  # in space all matrices at once are much memory
        full = np.moveaxis(symbol[:, :, row], (0, 1), (-2, -1))
        full[:] = inv(full)
    at_rest *= not none
    return symbol
