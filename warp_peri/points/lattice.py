"""Nodes of square and cubic lattices: who is where, and how far neighbours stretch."""

from __future__ import annotations

import itertools

import numpy as np
import warp as wp
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from warp_peri.errors import InputError
from warp_peri.kernels import neighbours as kernels
from warp_peri.points.arrays import listed
from warp_peri.points.points import LATTICE_TOLERANCE as LATTICE_TOLERANCE
from warp_peri.points.points import Lattice
from warp_peri.points.points import check_lattice as check_lattice
from warp_peri.points.points import straight_steps as straight_steps
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.runtime import ints, launch_slices, zeros


def lattice_steps(points: PointsLike) -> Lattice:
    """`Points.lattice` of points or samples."""
    return nodes_of(points).lattice


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
        raise InputError(f"points: {len(twice)} duplicates: {listed(twice)}")
    number = np.pad(number, wrapped, mode="wrap")
    stride = np.array(number.strides) // number.itemsize
    table = zeros(len(grid), len(steps), dtype=wp.int32)
    lattice = (ints((grid + wrapped) @ stride), ints(steps @ stride), ints(number.ravel()))
    launch_slices(kernels.lattice_neighbours, len(grid), lattice, (table,))
    found: np.ndarray = table.numpy()
    return found


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
