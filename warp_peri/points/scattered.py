"""Families of any points: neighbours by a cell list, weights family by family, both in Warp."""

from __future__ import annotations

import numpy as np
import warp as wp
from scipy.spatial import ConvexHull, QhullError

from warp_peri.errors import InputError
from warp_peri.kernels import neighbours as kernels
from warp_peri.kernels import quadrature as quadrature_kernels
from warp_peri.launch import floats, ints, launch, launch_slices, zeros
from warp_peri.points.arrays import listed as listed
from warp_peri.points.quadrature import INDEPENDENT, RESIDUAL, conditions, family_weights

BATCH_BONDS = 10_000
"""Bonds whose weights are solved for at once by the SVD, where normal equations will not do."""
FAMILY = 50
"""How much more than a node's sweep its weights take a thread."""


def neighbours(
    x: np.ndarray, reach: float, box: tuple[float, ...] | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points within reach of each point, itself excluded.

    Args:
        x: positions [Å], shape [N, d], d = 2 or 3.
        reach: largest distance that counts [Å].
        box: d periods [Å], more than twice the reach; None when the points are not periodic.

    Returns:
        row [N + 1], neighbour [E] and distance [Å] [E]; those of point i are row[i] … row[i + 1].

    Raises InputError for a box that is too small, or more bonds than int32 can number.
    """
    if not (np.isfinite(reach) and reach > 0):
        raise InputError(f"horizon: expected a length > 0, got {reach}")
    corner = x.min(axis=0)
    extent = x.max(axis=0) - corner
    d = x.shape[1]
    if box is not None:
        if not (np.shape(box) == (d,) and np.isfinite(box).all() and (2 * reach < min(box))):
            number = "two" if d == 2 else "three"
            raise InputError(f"box: expected {number} periods above {2 * reach:g}, got {box}")
        extent = np.array(box, dtype=float)
    most = len(x) ** (1 / d) + 1  # no more cells than points, or nearly so
    widest = extent / (reach * (1 + 1e-9))  # no rounding puts near points two cells apart
    cells = np.maximum(np.minimum(widest, most * 2).astype(int), 1)
    position = (x - corner) / np.where(extent > 0, extent, 1)
    position = position % 1 if box is not None else position
    cell = np.minimum((position * cells).astype(np.int32), cells - 1)
    flat = np.ravel_multi_index(tuple(cell.T), tuple(cells))
    start = np.concatenate([[0], np.cumsum(np.bincount(flat, minlength=cells.prod()))])
    vec, layer = wp.types.vector(d, wp.float64), (0, 3 - d)
    cell = wp.array(np.pad(cell, ((0, 0), layer)), dtype=wp.vec3i, device="cpu")
    counts = wp.vec3i(*np.pad(cells, layer, constant_values=1).tolist())
    links = (floats(x, vec), cell, counts, ints(start), ints(np.argsort(flat, kind="stable")))
    period = vec(*(box or d * (0.0,)))
    kernel = kernels.near_points(d)
    count = zeros(len(x) + 1, dtype=wp.int32)
    nothing = (zeros(1, dtype=wp.int32), zeros(1))
    launch(kernel, len(x), (*links, period, reach, 0), (count, *nothing))
    row = np.cumsum(count.numpy(), dtype=np.int64)
    if row[-1] >= 2**31:
        raise InputError(f"points: {row[-1]} bonds are more than can be numbered (2³¹)")
    bonds = (ints(row), zeros(row[-1], dtype=wp.int32), zeros(row[-1]))
    launch(kernel, len(x), (*links, period, reach, 1), bonds)
    return row.astype(np.int32), bonds[1].numpy(), bonds[2].numpy()


def reverse_bonds(row: np.ndarray, neighbour: np.ndarray) -> np.ndarray:
    """The bond from j to i for each bond from i to j, shape [E]."""
    reverse = zeros(len(neighbour), dtype=wp.int32)
    launch(kernels.reverse_bonds, len(row) - 1, (ints(row), ints(neighbour)), (reverse,))
    bonds: np.ndarray = reverse.numpy()
    return bonds


def refuse_alone(row: np.ndarray) -> None:
    """Refuse points without a neighbour, naming them."""
    alone = np.flatnonzero(np.diff(row) == 0)
    if len(alone) == len(row) - 1:
        raise InputError(
            "horizon: expected at least the spacing of the points, but no two are that close"
        )
    if len(alone):
        raise InputError(f"points: isolated, with no other within the horizon: {listed(alone)}")


def bonds_of(
    x: np.ndarray,
    nodes: np.ndarray,
    row: np.ndarray,
    neighbour: np.ndarray,
    box: tuple[float, ...] | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bond vectors of some nodes [Å], shape [E', d], their bonds [E'], and family sizes [nodes]."""
    size = row[nodes + 1] - row[nodes]
    bond = np.repeat(row[nodes] - np.cumsum(size) + size, size) + np.arange(size.sum())
    xi = x[neighbour[bond]] - x[np.repeat(nodes, size)]
    if box is not None:
        xi -= np.round(xi / box) * box
    return xi, bond, size


def cut_balls(x: np.ndarray, horizon: float, bonds: int) -> np.ndarray:
    """Nodes whose ball leaves the convex hull of the points by more than one spacing.

    The spacing is that of as many points in a square or cubic lattice. Balls that reach into a
    hole or a bay cannot be told from balls of a coarser cloud, and pass.
    """
    try:
        hull = ConvexHull(x).equations
    except QhullError:  # all points on one line or plane
        return np.arange(len(x))
    d, nodes = x.shape[1], bonds / len(x) + 1
    spacing = horizon * (np.sqrt(np.pi / nodes) if d == 2 else np.cbrt(4 / 3 * np.pi / nodes))
    depth = np.full(len(x), np.inf)
    for normal, offset in zip(hull[:, :d], hull[:, d]):
        depth = np.minimum(depth, -(x @ normal) - offset)
    return np.flatnonzero(depth < horizon - spacing)


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
    settings = (horizon, INDEPENDENT, floats(exact))
    found = zeros(len(neighbour)), zeros(len(nodes))
    kernel = quadrature_kernels.family_weights(tuple(powers))
    launch_slices(kernel, len(nodes), (ints(nodes), *links, *settings), found, weight=FAMILY)
    weight, residual = (array.numpy() for array in found)
    rest, poor = nodes[residual < 0], [nodes[~(residual <= RESIDUAL)]]
    size = row[rest + 1] - row[rest]
    by_size = rest[np.argsort(size, kind="stable")]
    first = 0
    while first < len(by_size):
        last = first + max(1, BATCH_BONDS // int(row[by_size[first] + 1] - row[by_size[first]]))
        some = by_size[first:last]
        first = last
        xi, bond, some_size = bonds_of(x, some, row, neighbour, box)
        place = np.arange(some_size.max()) < some_size[:, None]
        padded = np.zeros((*place.shape, d))
        padded[place] = xi
        by_svd, left = family_weights(padded, horizon, degree=degree)
        weight[bond] = by_svd[place]
        poor.append(some[~(left <= RESIDUAL)])
    wrong = np.sort(np.concatenate(poor))
    if len(wrong):
        raise InputError(
            f"quadrature: no weights are exact for the families of {len(wrong)} nodes: "
            f"{listed(wrong)}; a larger horizon has more bonds"
        )
    answer: np.ndarray = weight
    return answer
