"""Nodes of a square or cubic lattice laid out in a box, with all that the bonds of a law reach."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warp_peri.errors import InputError
from warp_peri.points.lattice import LATTICE_TOLERANCE, lattice_steps
from warp_peri.points.points import Points

SPARE = 60
"""Largest box, in places a node; beyond that the nodes lie too far apart to be laid out."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Where nodes lie in a box around the unknowns that holds every node they feel.

    Attributes:
        axes: of the lattice, as columns, shape [d, d].
        shape: of the box: the box of the interior with `reach` more on each side; of a periodic
            set the period alone.
        reach: steps that a bond may lead along an axis.
        periodic: whether the box closes on itself.
        near: numbers of the nodes that lie in the box.
        place: their places in it, flat.
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

    Args:
        points: lattice nodes with a collar, or periodic.
        steps: ξ/h of the bonds.
        why: said beside the error for nodes whose bonds are cut.
        least: steps that a period must be longer than; twice the reach of the bonds by default.

    Raises InputError for scattered points, another dimension, nodes off the lattice or given
    twice, interior nodes without all their neighbours, and a box that bonds reach around.
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
    """Which places of a box have all their neighbours by some steps and back, of a body in the box
    with r more around it."""
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
