"""Families of any points: neighbours by a tree, weights family by family in Warp."""

from __future__ import annotations

import numpy as np
import warp as wp
from scipy.spatial import ConvexHull, QhullError, cKDTree

from warp_peri.errors import InputError
from warp_peri.kernels import quadrature as quadrature_kernels
from warp_peri.points.arrays import listed as listed
from warp_peri.points.quadrature import INDEPENDENT, RESIDUAL, conditions, family_weights
from warp_peri.runtime import floats, ints, launch_slices, zeros

FAMILY = 50
"""How much more than a node's sweep its weights take a thread."""


def neighbours(
    x: np.ndarray, reach: float, box: tuple[float, ...] | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points within reach of each point, itself excluded.

    Args:
        x: positions [Å], shape [N, d], d = 2 or 3.
        reach: largest distance that counts [Å].
        box: d periods [Å], more than twice the reach; None when the points are not periodic.

    Returns:
        row [N + 1], neighbour [E], distance [Å] [E], and the bond back of each bond [E]; those of
        point i are row[i] … row[i + 1].

    Raises InputError for a box that is too small, points that are alone, and more bonds than int32
    can number.
    """
    d, at = x.shape[1], x
    if box is not None:
        if not (np.shape(box) == (d,) and np.isfinite(box).all() and 2 * reach < min(box)):
            number = "two" if d == 2 else "three"
            raise InputError(f"box: expected {number} periods above {2 * reach:g}, got {box}")
        at = x % box
        at = np.where(at < box, at, 0.0)  # of −1e-17 it is the period itself
    pairs = cKDTree(at, boxsize=box).query_pairs(reach, output_type="ndarray")
    if 2 * len(pairs) >= 2**31:
        raise InputError(f"points: {2 * len(pairs)} bonds are more than can be numbered (2³¹)")
    start, end = np.concatenate([pairs, pairs[:, ::-1]]).T
    order = np.lexsort((end, start))
    place = np.empty(len(order), np.int32)
    place[order] = np.arange(len(order))
    reverse = np.roll(place, len(pairs))[order]
    count = np.bincount(start, minlength=len(x))
    if not count.all():
        alone = listed(np.flatnonzero(count == 0))
        raise InputError(f"points: isolated, with no other within the horizon: {alone}")
    row = np.concatenate([[0], np.cumsum(count)]).astype(np.int32)
    start, end = start[order], end[order].astype(np.int32)
    return row, end, np.linalg.norm(nearest(x[end] - x[start], box), axis=1), reverse


def nearest(xi: np.ndarray, box: tuple[float, ...] | None) -> np.ndarray:
    """Bond vectors to the nearest images."""
    return xi if box is None else xi - np.round(xi / box) * box


def cut_balls(x: np.ndarray, horizon: float, bonds: int) -> np.ndarray:
    """Nodes whose ball leaves the convex hull of the points by more than one spacing, [N] bool.

    The spacing is that of as many points in a square or cubic lattice. Balls that reach into a
    hole or a bay cannot be told from balls of a coarser cloud, and pass.
    """
    try:
        hull = ConvexHull(x).equations
    except QhullError:  # all points on one line or plane
        return np.ones(len(x), bool)
    d, nodes = x.shape[1], bonds / len(x) + 1
    spacing = horizon * (np.sqrt(np.pi / nodes) if d == 2 else np.cbrt(4 / 3 * np.pi / nodes))
    depth = np.full(len(x), np.inf)
    for normal, offset in zip(hull[:, :d], hull[:, d]):
        depth = np.minimum(depth, -(x @ normal) - offset)
    return np.asarray(depth < horizon - spacing)


def weights(
    x: np.ndarray,
    nodes: np.ndarray,
    row: np.ndarray,
    neighbour: np.ndarray,
    box: tuple[float, ...] | None,
    horizon: float,
    degree: int,
) -> np.ndarray:
    """Quadrature weights of the families of `nodes` [Å^d], zero on all other bonds, shape [E].

    Raises InputError naming the nodes whose family is too poor.
    """
    d = x.shape[1]
    powers, exact = conditions(degree, d)
    vec = wp.types.vector(d, wp.float64)
    links = (floats(x, vec), ints(row), ints(neighbour), vec(*(box or d * (0.0,))))
    found = zeros(len(neighbour)), zeros(len(nodes))
    inputs = (ints(nodes), *links, horizon, INDEPENDENT, floats(exact))
    kernel = quadrature_kernels.family_weights(tuple(powers))
    launch_slices(kernel, len(nodes), inputs, found, weight=FAMILY)
    weight, residual = (array.numpy() for array in found)
    for n in np.flatnonzero(residual < 0):  # normal equations do not do near a line
        bonds = slice(*row[nodes[n] : nodes[n] + 2])
        xi = nearest(x[neighbour[bonds]] - x[nodes[n]], box)
        weight[bonds], residual[n] = family_weights(xi, horizon, degree=degree)
    if len(poor := nodes[~(residual <= RESIDUAL)]):
        raise InputError(
            f"quadrature: no weights are exact for the families of {len(poor)} nodes: "
            f"{listed(np.sort(poor))}; a larger horizon has more bonds"
        )
    return np.asarray(weight)
