"""How far neighbouring nodes are stretched."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from warp_peri.points.samples import PointsLike


def largest_strain(
    points: PointsLike, u: ArrayLike, nodes: np.ndarray | slice = slice(None)
) -> float:
    """Largest |ξ·(u_j − u_i)|/r² between nodes and their nearest neighbours.

    Args:
        points: a lattice or scattered points; nodes outside the body do not count.
        u: displacement [Å], shape [N, d] or [S, N, d].
        nodes: of the body, that are looked at; all by default.
    """
    body = np.ones(len(points.x), bool) if points.outside is None else ~points.outside
    x = points.x[body]
    count = min(2 * x.shape[1] + 1, len(x))
    r, near = cKDTree(x).query(x[nodes], k=count)
    r, near = r.reshape(-1, count)[:, 1:], near.reshape(-1, count)[:, 1:]
    if points.spacing > 0:
        near = np.where(r < 1.1 * points.spacing, near, np.arange(len(x))[nodes, None])
    xi = x[near] - x[nodes, None]
    square = (xi**2).sum(axis=-1)
    unit = xi / np.where(square > 0, square, np.inf)[..., None]
    fields = np.asarray(u).reshape(-1, *points.x.shape)[:, body]
    return max(
        (
            float(np.abs((unit * (field[near] - field[nodes, None])).sum(axis=-1)).max())
            for field in fields
        ),
        default=0.0,
    )


def lattice_strain(u: np.ndarray, spacing: float) -> float:
    """As largest_strain, of a field [Å] on a periodic lattice, shape [..., n₁, n₂, 2]."""
    pairs = [np.roll(u[..., a], -1, axis=a - 2) - u[..., a] for a in (0, 1)]
    return max(float(np.abs(pair).max(initial=0.0)) for pair in pairs) / spacing


def edge_strain(x: np.ndarray, triangles: np.ndarray, u: np.ndarray) -> float:
    """As largest_strain, between the ends of the edges of triangles.

    Args:
        x: corners [Å], shape [P, 2].
        triangles: their corners, shape [T, 3].
        u: displacement of the corners [Å], shape [P, 2].
    """
    after = np.roll(triangles, -1, axis=1)
    xi, relative = x[after] - x[triangles], u[after] - u[triangles]
    along = (xi * relative).sum(axis=-1) / (xi**2).sum(axis=-1)
    return float(np.abs(along).max(initial=0.0))
