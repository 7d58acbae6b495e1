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

from warp_peri.errors import InputError
from warp_peri.points.arrays import checked

REST = "rest"
"""Name of the edges of an outline, or the faces of a surface, that have no other."""
FLAT = 1e-9
"""Size of a cell over that power of its longest side below which it counts as none."""
OPPOSITE = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""Corners of the face across from each corner."""
ASKED = 5000
"""Cells that are asked at once what they hold."""
WITHIN = 1e-9
"""How far outside a cell, in its own coordinates, a position may lie that it holds."""


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
        middle, inverse, classes = self._finder
        found, points = np.full(len(x), -1), cKDTree(x)
        for size, some in classes:  # a cell is asked for what lies as near as its own corners
            for part in np.array_split(some, len(some) // ASKED + 1):
                near = points.query_ball_point(middle[part], size)
                cell = np.repeat(part, [len(n) for n in near])
                n = np.concatenate(near).astype(int)
                own = np.einsum("nij,nj->ni", inverse[cell], x[n] - self.x[self.cells[cell, 0]])
                held = np.minimum(own.min(axis=1), 1 - own.sum(axis=1)) >= -WITHIN
                found[n[held]] = cell[held]
        return found

    @cached_property
    def _finder(self) -> tuple[np.ndarray, np.ndarray, list[tuple[float, np.ndarray]]]:
        """Middles of the cells, what takes a position to a cell's own coordinates, and cells with
        corners no further than so much from their middle."""
        corners = self.x[self.cells]
        sides = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
        middle = corners.mean(axis=1)
        size = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1) * (1 + WITHIN)
        rank = np.ceil(2 * np.log2(size)).astype(int)
        classes = [(2.0 ** (n / 2), np.flatnonzero(rank == n)) for n in np.unique(rank)]
        return middle, np.linalg.inv(sides), classes


KINDS = {2: ("triangles", "area", 2), 3: ("tetrahedra", "volume", 6)}


def checked_cells(
    x: ArrayLike, cells: ArrayLike, d: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners [P, d], cells [T, d + 1] and their sizes [T], negative where turned over.

    Raises InputError for other shapes, corners out of range and cells of no size.
    """
    name, measure, parts = KINDS[d]
    x, t = checked("x", x, float), np.asarray(cells)
    whole = t.ndim == 2 and t.shape[1] == d + 1 and len(t) > 0 and t.dtype.kind in "iu"
    if x.ndim != 2 or x.shape[1] != d or not whole:
        raise InputError(
            f"mesh: expected corners [P, {d}] and {name} [T, {d + 1}], got {list(x.shape)} and "
            f"{list(t.shape)}"
        )
    if t.min() < 0 or t.max() >= len(x):
        raise InputError(f"{name}: expected corners 0 to {len(x) - 1}, got {t.min()}, {t.max()}")
    sides = x[t[:, 1:]] - x[t[:, :1]]
    size = np.linalg.det(sides) / parts
    share = np.abs(size) / np.linalg.norm(sides, axis=2).max(axis=1) ** d
    if not (share > FLAT).all():
        raise InputError(f"{name}: number {int(np.argmin(share))} has no {measure}")
    return x, t, np.asarray(size)


def make_tetrahedra(
    x: ArrayLike,
    cells: ArrayLike,
    parts: Mapping[str, ArrayLike] | None = None,
    middle: Mapping[tuple[int, int], ArrayLike] | None = None,
) -> Tetrahedra:
    """A body from corners and tetrahedra.

    Args:
        x: corners [length], shape [P, 3]; those that no cell has are left out.
        cells: corners of each, shape [T, 4].
        parts: faces of the surface by name, triples of corners, shape [n, 3].
        middle: points halfway along curved edges of the surface [length], by the pair of corners.

    Raises InputError for cells without volume, corners out of range, a face of more than two
    cells, and named faces that are not of the surface.
    """
    x, t, _ = checked_cells(x, cells, 3)
    used, numbered = np.unique(t, return_inverse=True)
    x, t = x[used], numbered.reshape(-1, 4)
    every = np.sort(t[:, OPPOSITE].reshape(-1, 3), axis=1)
    faces, count = np.unique(every, axis=0, return_counts=True)
    if count.max() > 2:
        raise InputError("tetrahedra: expected one or two at each face, some face has more")
    faces = faces[count == 1]
    number = {key: n for n, key in enumerate(map(tuple, faces.tolist()))}
    place = dict(zip(used.tolist(), range(len(used))))
    named: dict[str, np.ndarray] = {}
    for name, given in (parts or {}).items():
        triples = [
            tuple(sorted(place.get(c, -1) for c in face))
            for face in np.asarray(given).reshape(-1, 3).tolist()
        ]
        if missing := sum(face not in number for face in triples):
            raise InputError(
                f"part '{name}': expected faces of the surface, {missing} of {len(triples)} are not"
            )
        named[name] = np.array(sorted({number[face] for face in triples}), dtype=int)
    rest = np.setdiff1d(np.arange(len(faces)), np.concatenate([*named.values(), []]).astype(int))
    if len(rest):
        named[REST] = np.union1d(named.get(REST, np.zeros(0, int)), rest)
    bent = {tuple(sorted(place[c] for c in pair)): at for pair, at in (middle or {}).items()}
    curved = np.array(list(bent), dtype=int).reshape(-1, 2)
    points = np.array(list(bent.values()), dtype=float).reshape(-1, 3)
    return Tetrahedra(np.asarray(x), np.asarray(t), faces, named, curved, points)
