"""Where the nodes of a point set lie for the sweeps over bonds: a lattice row by row in a box, many
nodes at a time; anything else as it is numbered, with lists of bonds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp

from warp_peri.kernels.lps.sweeps import BYTES
from warp_peri.launch import DEVICE
from warp_peri.points.families import Families
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.points import Points

SPARE = 2
"""Largest box, in places a node: beyond that the nodes are better left in their lists."""
SHORT = 4
"""Least mean length of a piece that is worth it."""


@dataclass(frozen=True)
class Layout:
    """Places and bonds, as kernels/lps/sweeps.py says. Pieces have shape [·] of vectors.

    Attributes:
        in_rows: whether all places share one family, and are laid out in planes.
        row, end: first bond of each place, and places from one to the end of each bond.
        bond: vectors ξ [Å] and 1/r², shape [E, d + 1], of rows [B, d + 1].
        places: of a plane, P.
        images: place and number of every node, periodic images included; None of lists.
        home: place of every node, shape [N], or all of them.
        laid, needed, forces: pieces to be laid out, where dilatations are needed, and forces.
        back, nodes: the same of the transpose, of forces to all nodes.
        whole: `needed` without images.
        none: no pieces.
        ready: launches and planes that nobody uses.
    """

    in_rows: bool
    row: np.ndarray
    end: np.ndarray
    bond: np.ndarray
    places: int
    images: tuple[np.ndarray, np.ndarray] | None
    home: Any
    laid: wp.array[Any]
    needed: wp.array[Any]
    forces: wp.array[Any]
    back: wp.array[Any]
    nodes: wp.array[Any]
    whole: wp.array[Any]
    none: wp.array[Any]
    ready: dict[Any, list[Any]] = field(default_factory=dict)


def listed(points: Points, families: Families) -> tuple[np.ndarray, ...]:
    """Owner, far end and vector of each bond, and its number in tables by class, shape [E].

    Broken bonds, and those to nodes that are not there, end at a negative node.
    """
    row, end = families.row, families.neighbour
    owner = np.repeat(np.arange(len(row) - 1), np.diff(row))
    if families.lattice is not None:
        nodes = len(row) - 1
        kind = np.tile(families.lattice.bond_class, nodes)
        return owner, end, np.tile(families.pattern, (nodes, 1)), kind
    xi = points.x[np.where(end < 0, -1 - end, end)] - points.x[owner]
    if points.box is not None:  # the nearest images
        xi -= points.box * np.rint(xi / points.box)
    return owner, end, xi, np.arange(len(end))


def lists_of(points: Points, families: Families, device: str = DEVICE) -> Layout:
    """The layout of nodes as they are numbered."""
    owner, end, xi, _ = listed(points, families)
    nodes, full = np.arange(len(points.x)), np.concatenate([families.whole, families.cut])

    def pieces(places: np.ndarray) -> wp.array[Any]:
        return _pieces(places, np.arange(len(places)), 1, device)

    none, needed = pieces(nodes[:0]), pieces(np.sort(full))
    to = np.where(end < 0, 0, end - owner)
    of = none, needed, pieces(families.rows), none, pieces(nodes), needed, none
    return Layout(False, families.row, to, _bond(xi), len(nodes), None, slice(None), *of)


def rows_of(points: Points, families: Families, scalar: Any) -> Layout | None:
    """The layout of a lattice in a box; None with broken bonds, and where the box or the pieces of
    it would be mostly empty."""
    if families.lattice is None or len(families.cut):
        return None
    grid, steps = lattice_steps(points)[0], families.lattice.steps
    period = np.zeros(points.dimension, np.int64)
    if points.box is not None:
        period = np.rint(np.divide(points.box, points.spacing)).astype(np.int64)
    order = np.argsort(np.abs(grid[1:2] - grid[:1]).sum(axis=0), kind="stable")
    grid, steps, period = grid[:, order], steps[:, order], period[order]  # numbered last along it
    grid = (grid - grid.min(axis=0)) % np.where(period, period, grid.max() - grid.min() + 1)
    size, reach = grid.max(axis=0) + 1, int(np.abs(steps).max())
    if size.prod() > SPARE * len(grid):
        return None
    ring = reach if points.box is None else 2 * reach
    sides = np.where(period, period, size) + 2 * ring
    stride = np.append(np.cumprod(sides[:0:-1])[::-1], 1)
    lanes = BYTES // wp.types.type_size_in_bytes(scalar)
    room = reach * int(stride.sum()) + lanes  # for bonds off the box, and the last piece's lanes

    def places(steps: np.ndarray) -> np.ndarray:
        corner: np.ndarray = room + (steps + ring) @ stride
        return corner

    def pieces(places: np.ndarray, numbers: np.ndarray) -> wp.array[Any]:
        return _pieces(places, numbers, lanes, DEVICE)

    home, numbers = places(grid), np.arange(len(grid))
    nodes = pieces(home, numbers)
    if SHORT * len(nodes) > len(grid):
        return None
    row_numbers, needed = np.full(len(grid), -1), np.zeros(len(grid), bool)
    row_numbers[families.rows], needed[families.whole] = np.arange(len(families.rows)), True
    owner, image = _images(grid, period, ring)
    around = places(_images(grid[needed], period, reach)[1])
    inside, at = row_numbers[owner] >= 0, places(image)
    of = (
        pieces(at, owner),
        pieces(around, around),
        pieces(home[families.rows], row_numbers[families.rows]),
        pieces(at[inside], row_numbers[owner[inside]]),
        nodes,
        pieces(home[families.whole], home[families.whole]),
        pieces(home[:0], home[:0]),
    )
    row, places_in = np.array([0, len(steps)]), int(sides.prod() + 2 * room)
    return Layout(
        True, row, steps @ stride, _bond(families.pattern), places_in, (at, owner), home, *of
    )


def _bond(xi: np.ndarray) -> np.ndarray:
    return np.hstack([xi, 1 / (xi**2).sum(axis=1, keepdims=True)])


def _images(grid: np.ndarray, period: np.ndarray, ring: int) -> tuple[np.ndarray, np.ndarray]:
    """Number and steps of all nodes and of their periodic images in a ring around the period."""
    owners, images = [np.arange(len(grid))], [grid]
    if period.any():
        border = np.flatnonzero(((grid < ring) | (grid >= period - ring)).any(axis=1))
        for shift in np.ndindex(*[3] * len(period)):
            image = grid[border] + (np.array(shift) - 1) * period
            inside = ((image >= -ring) & (image < period + ring)).all(axis=1)
            if np.any(np.array(shift) != 1):
                owners.append(border[inside])
                images.append(image[inside])
    return np.concatenate(owners), np.concatenate(images)


def _pieces(places: np.ndarray, numbers: np.ndarray, lanes: int, device: str) -> wp.array[Any]:
    """Pieces of at most so many lanes, in the order of their places, shape [P] of vectors."""
    if (np.diff(places) <= 0).any():
        order = np.argsort(places, kind="stable")
        places, numbers = places[order], numbers[order]
    broken = np.ones(len(places), bool)
    broken[1:] = (np.diff(places) != 1) | (np.diff(numbers) != 1)
    begin = np.flatnonzero(broken)
    length = np.diff(np.append(begin, len(places)))
    parts = -(-length // lanes)
    step = lanes * (np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts))
    first = np.repeat(begin, parts) + step
    count = np.minimum(np.repeat(length, parts) - step, lanes)
    table = np.stack([places[first], numbers[first], count], axis=1).astype(np.int32)
    return wp.array(table, dtype=wp.vec3i, device=device)
