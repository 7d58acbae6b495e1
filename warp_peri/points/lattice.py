"""Square and cubic lattices, straight or turned: their axes, steps of their nodes, who is where."""

from __future__ import annotations

import itertools

import numpy as np
import warp as wp
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from warp_peri.errors import InputError
from warp_peri.kernels import neighbours as kernels
from warp_peri.launch import ints, launch_slices, zeros
from warp_peri.points import scattered
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.points.unit_names import symbols

LATTICE_TOLERANCE = 1e-6
"""Largest distance of a node from its lattice position, in spacings."""

EMPTY_SHARE, SMALL_TABLE = 1000, 10**7
"""The table of lattice places around the nodes may be so much larger than their number, or so
large; beyond that the nodes are too far apart to be one body."""
LARGEST_TABLE = 2**30
"""Places that can be numbered, with room for a margin."""


def check_lattice(points: PointsLike) -> None:
    """Raise InputError for scattered points, saying what carries samples from there."""
    if points.spacing == 0:
        raise InputError(
            "points: expected a lattice, got scattered points; "
            "transfers.onto_lattice(samples, spacing=…) carries samples to one"
        )


def lattice_steps(points: PointsLike) -> tuple[np.ndarray, np.ndarray]:
    """Steps of the nodes of a lattice from its corner, shape [N, d] int32, and its axes as columns.

    Raises InputError naming points off the lattice, for nodes too far apart to be one body, and as
    check_lattice.
    """
    check_lattice(points)
    x, h = points.x, points.spacing
    _refuse_far(x, h)
    return _steps(x, h, _axes(x, h), " " + symbols(nodes_of(points).units)[0])


def straight_steps(x: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """As lattice_steps; the axes are exactly those of x where the nodes lie along them.

    Raises InputError as lattice_steps does.
    """
    _refuse_far(x, spacing)
    place = (x - x.min(axis=0)) / spacing
    grid = np.rint(place)
    if np.abs(place - grid).max() <= LATTICE_TOLERANCE:
        return grid.astype(np.int32), np.eye(x.shape[1])
    return _steps(x, spacing, _axes(x, spacing), "")


def neighbour_table(
    grid: np.ndarray, steps: np.ndarray, size: np.ndarray | None = None
) -> np.ndarray:
    """The node at each step of a family from each node, −1 where there is none: [N, B] int32.

    Args:
        grid: lattice steps of the nodes, shape [N, d].
        steps: bond vectors of a family in lattice steps, shape [B, d].
        size: periods in lattice steps, more than twice the longest step; None without.

    Raises InputError for nodes given twice.
    """
    reach = int(np.abs(steps).max())
    if size is None:
        grid = grid - grid.min(axis=0) + reach
        size = grid.max(axis=0) + 1 + reach
        wrapped = 0
    else:
        grid, wrapped = grid % size, reach
    number = np.full(size, -1, dtype=np.int32)
    number[tuple(grid.T)] = nodes = np.arange(len(grid))
    twice = np.flatnonzero(number[tuple(grid.T)] != nodes)
    if len(twice):
        raise InputError(f"points: {len(twice)} duplicates: {scattered.listed(twice)}")
    number = np.pad(number, wrapped, mode="wrap")
    stride = np.array(number.strides) // number.itemsize
    table = zeros(len(grid), len(steps), dtype=wp.int32)
    lattice = (ints((grid + wrapped) @ stride), ints(steps @ stride), ints(number.ravel()))
    launch_slices(kernels.lattice_neighbours, len(grid), lattice, (table,))
    found: np.ndarray = table.numpy()
    return found


def _refuse_far(x: np.ndarray, spacing: float) -> None:
    places = np.prod(np.ptp(x, axis=0) / spacing + 1)
    if places > max(SMALL_TABLE, min(EMPTY_SHARE * len(x), LARGEST_TABLE)):
        raise InputError(
            f"points: {len(x)} nodes spread over {places:.1e} lattice places; expected one body"
        )


def _steps(x: np.ndarray, h: float, axes: np.ndarray, unit: str) -> tuple[np.ndarray, np.ndarray]:
    x = x @ axes  # coordinates along the lattice
    grid = np.rint((x - x[0]) / h).astype(np.int32)
    off = np.abs(x - x[0] - h * grid).max(axis=1)
    far = np.flatnonzero(off > LATTICE_TOLERANCE * h)
    if len(far):
        kind = "square" if x.shape[1] == 2 else "cubic"
        raise InputError(
            f"points: expected a {kind} lattice of spacing {h}{unit}; off it: "
            f"{scattered.listed(far)}, by up to {float(off.max()):.2g}{unit}, where "
            f"{LATTICE_TOLERANCE * h:.1g}{unit} ({LATTICE_TOLERANCE:g} spacings) are allowed: are "
            "positions rounded?"
        )
    return grid - grid.min(0), axes


def _axes(x: np.ndarray, spacing: float) -> np.ndarray:
    """Directions of the lattice as columns."""
    if x.shape[1] == 3:
        return _cubic_axes(x, spacing)
    row, neighbour, _ = scattered.neighbours(x, spacing * (1 + LATTICE_TOLERANCE))
    step = (x[neighbour] - np.repeat(x, np.diff(row), axis=0)) @ (1, 1j)
    step = step[step != 0]  # a point given twice says nothing
    if len(step) == 0:
        raise InputError(
            f"points: expected a square lattice of spacing {spacing}, but no two "
            "points are that close"
        )
    # The mean angle of nearest-neighbour bonds; the fourth power is blind to quarter turns.
    angle = np.angle((step**4).sum()) / 4
    if abs(angle) < 1e-12:
        return np.eye(2)
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _cubic_axes(x: np.ndarray, spacing: float) -> np.ndarray:
    """Of the directions of nearest-neighbour bonds, as near to the coordinates as can be named, and
    then those that fit all positions best."""
    some = x[:: max(1, len(x) // 2000)]
    pairs = cKDTree(x).query_ball_point(some, spacing * (1 + LATTICE_TOLERANCE))
    step = np.concatenate([x[near] - at for near, at in zip(pairs, some)])
    step = step[np.linalg.norm(step, axis=1) > spacing / 2] / spacing
    if not len(step):
        raise InputError(f"points: no two of them are {spacing:g} apart, the spacing of a lattice")
    first = step[0] / np.linalg.norm(step[0])
    across = step[np.abs(step @ first) < 0.1]
    if not len(across):
        raise InputError("points: expected a cubic lattice, got nodes along one line")
    second = across[0] - (across[0] @ first) * first
    second /= np.linalg.norm(second)
    frame = np.stack([first, second, np.cross(first, second)], axis=1)
    axes: np.ndarray = max(
        (frame[:, order] * signs for order in itertools.permutations(range(3))
         for signs in itertools.product((1, -1), repeat=3)),
        key=np.trace,
    )  # fmt: skip
    if np.abs(axes - np.eye(3)).max() < 1e-12:
        return np.eye(3)
    local = (x - x[0]) @ axes / spacing
    grid = np.rint(local)
    if np.abs(local - grid).max() < 1e-9:
        return axes
    U, _, V = np.linalg.svd((x - x.mean(axis=0)).T @ (grid - grid.mean(axis=0)))
    fitted: np.ndarray = U @ V
    return fitted


DIAGONAL = 1.5
"""Spacings within which nodes of a lattice are neighbours where strain is told."""


def largest_strain(
    points: PointsLike, u: ArrayLike, nodes: np.ndarray | slice = slice(None)
) -> float:
    """Largest |ξ·(u_j − u_i)|/r² between nodes and their nearest neighbours.

    On a lattice those across the diagonals of a square count too: shear along the axes stretches no
    other bond.

    Args:
        points: a lattice or scattered points; nodes outside the body do not count.
        u: displacement [Å], shape [N, d] or [S, N, d].
        nodes: of the body, that are looked at; all by default.
    """
    body = np.ones(len(points.x), bool) if points.outside is None else ~points.outside
    x, d = points.x[body], points.x.shape[1]
    if points.spacing > 0 and len(points.x) > 1:
        steps = np.array(list(itertools.product((-1, 0, 1), repeat=d)))
        steps = steps[np.isin((steps**2).sum(axis=1), (1, 2))]
        if isinstance(nodes, slice):  # each bond once
            steps = steps[len(steps) // 2 :]
        table = neighbour_table(lattice_steps(points)[0][body], steps)[nodes]
        near = np.where(table < 0, np.arange(len(x))[nodes, None], table)
    else:
        count = min(2 * d + 1, len(x))
        near = cKDTree(x).query(x[nodes], k=count)[1].reshape(-1, count)[:, 1:]
    xi = x[near] - x[nodes, None]
    square = (xi**2).sum(axis=-1)
    unit = xi / np.where(square > 0, square, np.inf)[..., None]
    fields = np.asarray(u).reshape(-1, *points.x.shape)[:, body]
    return max(
        (
            float(np.abs((unit * (field[near] - field[nodes, None])).sum(axis=-1)).max(initial=0))
            for field in fields
        ),
        default=0.0,
    )
