"""Nodes of a lattice in a box with all that bonds reach; products by rows, or by FFT (T1, T15)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
import warp as wp

from warp_peri.errors import InputError
from warp_peri.kernels.micromodulus import rows
from warp_peri.points.points import LATTICE_TOLERANCE, Points, lattice_steps
from warp_peri.runtime import DEVICE, floats, get_num_threads, ints, launch_slices

SPARE = 60
"""Largest box, in places a node; beyond that the nodes lie too far apart to be laid out."""
SCALARS = {np.dtype(np.float64): wp.float64, np.dtype(np.float32): wp.float32}
FASTER = 4
"""How much less than a usual node a lane of a piece has to do, for the number of threads."""
FFT_BONDS = {2: 75, 3: 120}
"""Half families from which FFT takes less time than rows: the middle of where four measurements on
an idle machine crossed."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Where nodes lie in a box around the unknowns that holds every node they feel.

    Attributes:
        axes: of the lattice, as columns, shape [d, d].
        shape: of the box: that of the interior with `reach` more on each side, or the period.
        reach: steps that a bond may lead along an axis.
        periodic: whether the box closes on itself.
        near, place: numbers of the nodes in the box, and their places in it, flat.
        interior: places of the interior nodes, flat, in the order of the point set.
    """

    axes: np.ndarray
    shape: tuple[int, ...]
    reach: int
    periodic: bool
    near: np.ndarray
    place: np.ndarray
    interior: np.ndarray

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return len(self.shape)

    @property
    def wide(self) -> tuple[int, ...]:
        """The box, and around a period its images within reach."""
        return tuple(n + 2 * self.reach * self.periodic for n in self.shape)

    @property
    def core(self) -> tuple[slice, ...]:
        """Where the box of the interior lies in the wide one."""
        r = self.reach
        return tuple(slice(r, n - r) for n in self.wide)

    @property
    def is_box(self) -> bool:
        """Whether all nodes of a box are unknown."""
        return bool(self.periodic or self.unknown.all())

    def mask(self) -> np.ndarray:
        """Which places of the box are unknown, in its shape."""
        asked = np.zeros(int(np.prod(self.shape)), bool)
        asked[self.interior] = True
        return asked.reshape(self.shape)

    @property
    def unknown(self) -> np.ndarray:
        """Which places of the box of the interior are unknown, in that one's shape."""
        return self.mask() if self.periodic else self.mask()[self.core]

    def scatter(self, u: np.ndarray, dtype: type = np.float64) -> np.ndarray:
        """Vectors of all nodes [S, N, d] along the lattice's axes, in planes [S, d, *wide]."""
        field: np.ndarray = np.zeros((len(u), self.dimension, int(np.prod(self.shape))), dtype)
        field[:, :, self.place] = (u[:, self.near] @ self.axes).transpose(0, 2, 1)
        field = field.reshape(len(u), self.dimension, *self.shape)
        if self.periodic:
            field = np.pad(field, [(0, 0)] * 2 + [(self.reach,) * 2] * self.dimension, mode="wrap")
        return field

    def scatter_interior(self, inner: np.ndarray) -> np.ndarray:
        """Vectors of the interior nodes [I, d] in planes [d, *shape], zero elsewhere."""
        field: np.ndarray = np.zeros((self.dimension, int(np.prod(self.shape))))
        field[:, self.interior] = (inner @ self.axes).T
        return field.reshape(self.dimension, *self.shape)

    def gather(self, planes: np.ndarray) -> np.ndarray:
        """Planes [S, d, *shape] at the interior nodes, along the points' axes, [S, I, d]."""
        flat = planes.reshape(*planes.shape[:2], -1)[:, :, self.interior]
        return np.ascontiguousarray(flat.transpose(0, 2, 1) @ self.axes.T.astype(planes.dtype))


def grid_of(points: Points, steps: np.ndarray, *, why: str = "", least: int | None = None) -> Grid:
    """Lay the nodes of a lattice out for bonds of the given steps, shape [H, d] of one half.

    `why` is said of nodes whose bonds are cut; a period must be longer than `least` steps, by
    default twice the reach. Raises InputError for scattered points, another dimension, nodes off
    the lattice or given twice, interior nodes without all their neighbours, and a box that bonds
    reach around.
    """
    d = steps.shape[1]
    if points.x.shape[1] != d:
        raise InputError(f"points: expected {d} coordinates, got {points.x.shape[1]}")
    grid, axes = lattice_steps(points)
    reach = int(np.abs(steps).max())
    if points.box is not None:
        shape = _period(points, axes, 2 * reach if least is None else least)
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


def _period(points: Points, axes: np.ndarray, least: int) -> tuple[int, ...]:
    """Nodes of a period along the axes."""
    if np.abs(axes - np.eye(len(axes))).max() > LATTICE_TOLERANCE:
        raise InputError("box: expected the lattice's axes along the coordinates, got a turned one")
    counts = np.asarray(points.box) / points.spacing
    whole = np.rint(counts).astype(int)
    if np.abs(counts - whole).max() > LATTICE_TOLERANCE * whole.max() or whole.min() <= least:
        raise InputError(
            f"box: expected whole multiples of the spacing, more than {least} of them, got "
            f"{', '.join(f'{count:g}' for count in counts)}"
        )
    return tuple(whole.tolist())


def _check(points: Points, nodes: Grid, steps: np.ndarray, why: str) -> None:
    """Refuse nodes given twice, and interior nodes whose bonds lead nowhere."""
    there = np.zeros(int(np.prod(nodes.shape)), np.int32)
    np.add.at(there, nodes.place, 1)
    if there.max() > 1:
        raise InputError("points: expected every node once, got two at one place")
    body = there.astype(bool)
    if points.outside is not None:
        body[nodes.place[points.outside[nodes.near]]] = False
    body = body.reshape(nodes.shape)
    if nodes.periodic:
        body = np.pad(body, nodes.reach, mode="wrap")
    lacking = int((nodes.unknown & ~complete(body, steps, nodes.reach)).sum())
    if lacking:
        width = points.spacing * np.linalg.norm(steps, axis=1).max()
        why = why or f"; give a collar {width:g} wide"
    refuse_cut(lacking, len(nodes.interior), why)


def complete(body: np.ndarray, steps: np.ndarray, r: int) -> np.ndarray:
    """Which places have all their neighbours by some steps and back, of a body with r more."""
    whole = np.ones([n - 2 * r for n in body.shape], bool)
    for step in np.concatenate([steps, -steps]):
        whole &= body[tuple(slice(r + s, n - r + s) for s, n in zip(step, body.shape))]
    return whole


def refuse_cut(lacking: int, count: int, why: str = "") -> None:
    """InputError where some of so many interior nodes lack neighbours."""
    if lacking:
        raise InputError(
            f"points: expected all bonds of every interior node, got {lacking} of "
            f"{count} nodes with cut bonds{why}"
        )


class ByRows:
    """Half families by rows; the bits are the same on any number of threads."""

    def __init__(
        self, nodes: Grid, steps: np.ndarray, tensors: np.ndarray, dtype: Any = np.float64
    ) -> None:
        self.nodes, self.core = nodes, (slice(None), slice(None), *nodes.core)
        self.dtype, self.scalar = np.dtype(dtype), SCALARS[np.dtype(dtype)]
        self.kernels = rows(self.scalar, nodes.dimension)
        strides = np.array([int(np.prod(nodes.wide[a + 1 :])) for a in range(nodes.dimension)])
        self.offset = ints(steps @ strides)
        upper = tensors[(slice(None), *np.triu_indices(nodes.dimension))]  # of symmetric matrices
        self.tensors = floats(np.ascontiguousarray(upper, self.dtype), self.scalar)
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
    """Runs of rising places and numbers cut to lanes: first place, first number, count [P, 3]."""
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
    """D(k), or D(k) h² as tensors are, at waves of a torus [d, d, *torus], its last axis halved."""
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


def convolved(symbol: np.ndarray, field: np.ndarray, torus: tuple[int, ...]) -> np.ndarray:
    """A symbol's product with one field [d, …] in a corner of the torus, on all of it."""
    how: dict[str, Any] = {
        "s": torus,
        "axes": range(1, len(torus) + 1),
        "workers": get_num_threads(),
    }
    mixed = np.einsum("ij...,j...->i...", symbol, scipy.fft.rfftn(field, **how))
    return np.asarray(scipy.fft.irfftn(mixed, overwrite_x=True, **how))


def inverse(symbol: np.ndarray) -> np.ndarray:
    """D⁻¹ of matrices [d, d, …]; 0 where that has none (k = 0)."""
    answer, largest, first = np.empty_like(symbol), np.abs(symbol).max(), (0,) * (symbol.ndim - 3)
    for row in range(symbol.shape[2]):  # in space all matrices at once are much memory
        full = np.moveaxis(symbol[:, :, row], (0, 1), (-2, -1)).copy()
        singular = row == 0 and np.abs(full[first]).max() <= 1e-12 * largest
        if singular:
            full[first] = np.eye(len(symbol))
        found = np.linalg.inv(full)
        if singular:
            found[first] = 0
        answer[:, :, row] = np.moveaxis(found, (-2, -1), (0, 1))
    return answer
