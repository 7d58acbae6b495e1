"""Every second node of a lattice: what a loose tolerance is answered on (theory, Q14, Q15)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import distance_transform_edt, spline_filter

from warp_peri.points.lattice import lattice_steps
from warp_peri.points.points import Points

APART = 2
"""Spacings of the coarse nodes, in those of the problem."""


class EverySecond:
    """Every second node of a lattice in the plane, cubic splines from these to all, means back.

    Args:
        points: a plain lattice.

    Coarse nodes lie on the last line of the collar, where e is zero: one step before the first
    unknown nodes, and every second from there.

    Attributes:
        nodes: the coarse ones, C of them, J unknown.
        chosen: their numbers among all, shape [C].
    """

    def __init__(self, points: Points) -> None:
        self.points, inside = points, points.interior
        grid = lattice_steps(points)[0]
        grid = grid - (grid[inside].min(axis=0) - 1) % APART
        self.chosen = np.flatnonzero((grid % APART == 0).all(axis=1))
        x, interior = points.x[self.chosen], inside[self.chosen]
        self.nodes = replace(points, x=x, interior=interior, spacing=APART * points.spacing)
        place = grid[self.chosen] // APART
        self.shape = tuple(int(n) for n in place.max(axis=0) + 1)
        self.flat = np.ravel_multi_index(tuple(place.T), self.shape)
        self.unknown = self.flat[interior]
        self.wide = tuple(APART * n for n in self.shape)
        self.own = np.ravel_multi_index(tuple(grid[inside].T), self.wide)
        missing = np.ones(self.shape, bool)
        missing.flat[self.flat] = False
        at = distance_transform_edt(missing, return_distances=False, return_indices=True)
        number = np.zeros(self.shape, int)
        number.flat[self.flat] = np.arange(len(self.flat))
        self.nearest = number[tuple(at)]  # splines go on beyond the nodes as they end there

    def spread(self, u: np.ndarray) -> np.ndarray:
        """Of u on the coarse nodes [C, 2] what all unknown nodes have, shape [I, 2]."""
        found = np.empty((len(self.own), 2))
        for axis, one in enumerate(u.T):
            found[:, axis] = halved(spline_filter(one[self.nearest])).ravel()[self.own]
        return found

    def gathered(self, r: np.ndarray) -> np.ndarray:
        """Means of a residual on the unknown nodes [I, 2] at the coarse ones, shape [J, 2]."""
        found = np.empty((len(self.unknown), 2))
        for axis, one in enumerate(r.T):
            field = np.zeros(self.wide)
            field.reshape(-1)[self.own] = one
            found[:, axis] = _averaged(field).ravel()[self.unknown]
        return found


def halved(coefficients: np.ndarray) -> np.ndarray:
    """A cubic B-spline [n, m] at its knots and half way between them, shape [2 n, 2 m]."""
    for _ in (0, 1):
        c = coefficients
        before, after = np.roll(c, 1, axis=0), np.roll(c, -1, axis=0)
        before[0], after[-1] = c[1], c[-2]  # mirrored, as spline_filter takes them
        fine = np.empty((2 * len(c), c.shape[1]))
        fine[0::2] = (before + after + 4 * c) / 6
        fine[1::2] = (before + np.roll(after, -1, axis=0) + 23 * (c + after)) / 48
        coefficients = fine.T
    return coefficients


def _averaged(field: np.ndarray) -> np.ndarray:
    """Means (1, 2, 1)/4 along both axes of [2 n, 2 m] at every second place, shape [n, m]."""
    for _ in (0, 1):
        even, odd = field[0::2], field[1::2]
        mean = even / 2 + odd / 4
        mean[1:] += odd[:-1] / 4
        field = mean.T
    return field
