"""A body in space as tetrahedra: its surface and the named parts of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from warp_peri.points.cells import Finder, outlined


@dataclass(frozen=True, eq=False)
class Tetrahedra:
    """Tetrahedra of a body, with a surface that may be curved.

    Attributes:
        x: corners [length], shape [P, 3].
        cells: their corners, shape [T, 4].
        faces: triangles of the surface by their corners, shape [F, 3].
        parts: faces by name, numbers into `faces`; those that have no name are REST.
        curved: edges of the surface by their corners, shape [E, 2], the smaller first.
        middle: points of the surface halfway along them [length], shape [E, 3]; an edge is the
            parabola through its ends and this, all others are straight.
    """

    x: np.ndarray
    cells: np.ndarray
    faces: np.ndarray
    parts: dict[str, np.ndarray] = field(default_factory=dict)
    curved: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), int))
    middle: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def hole_sizes(self) -> np.ndarray:
        """Smallest side of the box around each cavity [length], shape [holes]."""
        size = (len(self.x),) * 2
        ends = self.faces[:, [0, 1]].T, self.faces[:, [1, 2]].T
        pairs = tuple(np.concatenate(both) for both in zip(*ends))
        _, label = connected_components(coo_array((np.ones(len(pairs[0])), pairs), shape=size))
        own = label[self.faces[:, 0]]
        sides = [np.ptp(self.x[self.faces[own == n].ravel()], axis=0) for n in np.unique(own)]
        smallest = np.array([side.min() for side in sides])
        return np.delete(smallest, np.argmax([side.max() for side in sides]))  # the outer surface

    def distance(self, x: np.ndarray, step: float) -> np.ndarray:
        """Distance [length] of points to the surface, by points of it about `step` apart."""
        corners = self.x[self.faces]
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
        count = min(int(np.ceil(longest / step)) + 1, 12)
        part = [(i, j) for i in range(count + 1) for j in range(count + 1 - i)]
        weight = np.array([(i, j, count - i - j) for i, j in part]) / count
        found: np.ndarray = cKDTree((weight @ corners).reshape(-1, 3)).query(x)[0]
        return found

    def holding(self, x: np.ndarray) -> np.ndarray:
        """Number of a tetrahedron that holds each point, −1 where none does."""
        return self._finder.holding(x)

    @cached_property
    def _finder(self) -> Finder:
        return Finder(self.x, self.cells)


def make_tetrahedra(
    x: ArrayLike,
    cells: ArrayLike,
    parts: Mapping[str, ArrayLike] | None = None,
    middle: Mapping[tuple[int, int], ArrayLike] | None = None,
    *,
    inner: bool = False,
) -> Tetrahedra:
    """A body from corners and tetrahedra.

    Args:
        x: corners [length], shape [P, 3]; those that no cell has are left out.
        cells: corners of each, shape [T, 4].
        parts: faces of the surface by name, triples of corners, shape [n, 3].
        middle: points halfway along curved edges of the surface [length], by the pair of corners.
        inner: faces of parts that are inside are left out with a warning, not refused.

    Warns and raises InputError as `points.cells.outlined`.
    """
    corners, t, faces, named, bent = outlined(x, cells, parts or {}, middle or {}, 3, inner=inner)
    curved = np.array(list(bent), dtype=int).reshape(-1, 2)
    points = np.array(list(bent.values()), dtype=float).reshape(-1, 3)
    return Tetrahedra(corners, t, faces, named, curved, points)
