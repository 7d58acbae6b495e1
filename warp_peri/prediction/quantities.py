"""Quantities of a displacement, for Answer.of: strain, stress, means, forces."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from warp_peri.errors import InputError
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.prediction.placed import PlacedMembers

Quantity = Callable[[np.ndarray], np.ndarray]


def strain(points: PointsLike, at: ArrayLike) -> Quantity:
    """ε at the nodes nearest to positions [m, d], by central differences, shape [m, d, d].

    Raises InputError for scattered points, and positions whose node lacks a neighbour.
    """
    nodes = nodes_of(points)
    if not nodes.spacing > 0:
        raise InputError("strain: expected a lattice, got scattered points")
    tree = cKDTree(nodes.x)
    middle = tree.query(np.atleast_2d(np.asarray(at, float)))[1]
    steps = nodes.spacing * np.eye(nodes.x.shape[1])
    places = nodes.x[middle][:, None] + steps, nodes.x[middle][:, None] - steps
    far, near = zip(*(tree.query(place) for place in places))
    if max(float(distance.max()) for distance in far) > 1e-3 * nodes.spacing:
        raise InputError("strain: expected positions whose nodes have neighbours along the axes")

    def of(u: np.ndarray) -> np.ndarray:
        slope = (u[near[0]] - u[near[1]]) / (2 * nodes.spacing)
        return np.asarray((slope + slope.swapaxes(-1, -2)) / 2)

    return of


def stress(placed: PlacedMembers, at: ArrayLike) -> Quantity:
    """σ [stress] of the rich member at the interior nodes nearest to positions, [m, d, d]."""
    inside = placed.points.x[placed.points.interior]
    nodes = cKDTree(inside).query(np.atleast_2d(np.asarray(at, float)))[1]
    return lambda u: np.asarray(placed.rich.stress(u))[nodes]


def mean(where: ArrayLike) -> Quantity:
    """Mean displacement of nodes, by a mask [N] or numbers, shape [d]."""
    nodes = np.asarray(where)
    return lambda u: u[nodes].mean(axis=0)


def force(placed: PlacedMembers, start: ArrayLike, end: ArrayLike, *, number: int = 50) -> Quantity:
    """What is carried across a straight cut from one point to another, on its right-hand side:
    the reaction of what lies beyond it [stress · length], shape [2]."""
    a, b = np.asarray(start, float), np.asarray(end, float)
    share = (np.arange(number) + 0.5) / number
    along = b - a
    normal = np.array([along[1], -along[0]]) / number
    of = stress(placed, a + share[:, None] * along)
    return lambda u: np.asarray((of(u) @ normal).sum(axis=0))
