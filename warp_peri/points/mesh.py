"""A body as triangles: its outline, the named parts of it, and its file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from warp_peri.errors import InputError
from warp_peri.points.tetrahedra import REST, Tetrahedra, checked_cells, make_tetrahedra


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of a body, with an outline that may be curved.

    Attributes:
        x: corners [Å], shape [P, 2].
        triangles: their corners, shape [T, 3], counter-clockwise.
        edges: the outline's edges by their corners, shape [E, 2], the body on their left.
        middle: points of the outline halfway along the edges [Å], shape [E, 2]; an edge is the
            parabola through its ends and this.
        parts: edges by name, numbers into `edges`; those that have no name are REST.
    """

    x: np.ndarray
    triangles: np.ndarray
    edges: np.ndarray
    middle: np.ndarray
    parts: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def cells(self) -> np.ndarray:
        """The triangles, under the name that a body in space has too."""
        return self.triangles

    @property
    def faces(self) -> np.ndarray:
        """The outline's edges, likewise."""
        return self.edges

    @property
    def curved(self) -> np.ndarray:
        """Edges that have a `middle`, by their corners, the smaller first: all of the outline."""
        return np.sort(self.edges, axis=1)

    @cached_property
    def loops(self) -> np.ndarray:
        """Number of the closed curve that each edge belongs to, shape [E]."""
        weight = np.ones(len(self.edges))
        size = (len(self.x), len(self.x))
        _, label = connected_components(coo_array((weight, tuple(self.edges.T)), shape=size))
        numbers: np.ndarray = np.unique(label[self.edges[:, 0]], return_inverse=True)[1]
        return numbers

    @property
    def loop_sizes(self) -> np.ndarray:
        """Smaller side of the box around each closed curve of the outline [Å]."""
        sides = [
            np.ptp(self.along(np.array([0.0, 0.5]), self.loops == n), axis=0).min()
            for n in range(self.loops.max() + 1)
        ]
        return np.array(sides)

    @property
    def hole_sizes(self) -> np.ndarray:
        """Smaller side of the box around each hole [Å], shape [holes]."""
        start, end = self.x[self.edges[:, 0]], self.x[self.edges[:, 1]]
        turn = start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]
        return np.asarray(self.loop_sizes[np.bincount(self.loops, turn) < 0])

    def along(self, places: np.ndarray, kept: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Points of edges [Å] at places 0 to 1 along each, shape [edges · places, 2]."""
        start, end = self.x[self.edges[kept, 0]], self.x[self.edges[kept, 1]]
        s = places[None, :, None]
        bulge = self.middle[kept] - (start + end) / 2
        points = start[:, None] * (1 - s) + end[:, None] * s + 4 * s * (1 - s) * bulge[:, None]
        return np.asarray(points.reshape(-1, 2))

    def distance(self, x: np.ndarray, step: float) -> np.ndarray:
        """Distance [Å] of points to the outline, by points of it no further than `step` apart."""
        lengths = np.hypot(*(self.x[self.edges[:, 1]] - self.x[self.edges[:, 0]]).T)
        count = int(np.ceil(lengths.max() / step)) + 1
        distances: np.ndarray = cKDTree(self.along(np.arange(count) / count)).query(x)[0]
        return distances

    def holding(self, x: np.ndarray) -> np.ndarray:
        """Number of the straight-sided triangle that holds each point, −1 where none does."""
        from matplotlib.tri import Triangulation

        finder = Triangulation(self.x[:, 0], self.x[:, 1], self.triangles).get_trifinder()
        return np.asarray(finder(x[:, 0], x[:, 1]))


def make_mesh(
    x: ArrayLike,
    triangles: ArrayLike,
    parts: Mapping[str, ArrayLike] | None = None,
    middle: dict[tuple[int, int], np.ndarray] | None = None,
) -> Mesh:
    """A mesh from corners and triangles.

    Args:
        x: corners [Å], shape [P, 2]; those that no triangle has are left out.
        triangles: corners of each, shape [T, 3], in either sense.
        parts: edges of the outline by name, pairs of corners, shape [n, 2].
        middle: points halfway along curved edges [Å], by the pair of corners, the smaller first.

    Raises InputError for triangles without area, corners out of range, an edge of more than two
    triangles, and named edges that are not of the outline.
    """
    x, t, area = checked_cells(x, triangles, 2)
    t = np.where((area < 0)[:, None], t[:, ::-1], t)
    every = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    pairs = np.sort(every, axis=1)
    _, back, count = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
    if count.max() > 2:
        raise InputError("triangles: expected one or two at each edge, some edge has more")
    edges = every[count[back.ravel()] == 1]
    return _numbered(x, t, edges, parts or {}, middle or {})


def _numbered(
    x: np.ndarray,
    triangles: np.ndarray,
    edges: np.ndarray,
    parts: Mapping[str, ArrayLike],
    middle: dict[tuple[int, int], np.ndarray],
) -> Mesh:
    """The mesh with the edges of its parts numbered, and without corners that nothing has."""
    keys = [(min(pair), max(pair)) for pair in edges.tolist()]
    number = {key: n for n, key in enumerate(keys)}
    middles = (x[edges[:, 0]] + x[edges[:, 1]]) / 2
    for key, point in middle.items():
        if key in number:
            middles[number[key]] = point
    named: dict[str, np.ndarray] = {}
    for name, pairs in parts.items():
        of = [number.get((min(p), max(p)), -1) for p in np.asarray(pairs).reshape(-1, 2).tolist()]
        if -1 in of:
            raise InputError(f"part '{name}': expected edges of the outline, some are inside")
        named[name] = np.array(sorted(of), dtype=int)
    taken = np.zeros(len(edges), bool)
    for of_part in named.values():
        taken[of_part] = True
    if not taken.all():
        named[REST] = np.union1d(named.get(REST, np.zeros(0, int)), np.flatnonzero(~taken))
    used, renumbered = np.unique(triangles, return_inverse=True)
    new = np.full(len(x), -1)
    new[used] = np.arange(len(used))
    return Mesh(x[used], renumbered.reshape(-1, 3), new[edges], middles, named)


def load_mesh(path: str | os.PathLike[str]) -> Mesh | Tetrahedra:
    """A mesh of any format that meshio reads, positions in Å.

    Tetrahedra where there are some, of second order too, of which the corners count; else triangles
    and quadrilaterals (cut in two), straight or of second order, whose edges' midpoints are kept on
    the outline. Parts of the outline are the lines' physical names or sets, of a surface those of
    the triangles.

    Raises InputError for a file that is not read, without meshio (the extra `bodies`), without
    tetrahedra and not plane, or without any of these cells.
    """
    try:
        import meshio
    except ImportError:
        raise InputError("meshio is not installed: pip install 'warp_peri[bodies]'") from None
    if not Path(path).is_file():
        raise InputError(f"{path}: no such mesh file")
    try:
        read = meshio.read(path)
    except (Exception, SystemExit) as error:  # meshio leaves the program on some files
        raise InputError(f"{path}: not a mesh that meshio reads ({error})") from None
    points = np.asarray(read.points, dtype=float)
    solid = [np.asarray(c.data)[:, :4] for c in read.cells if c.type in ("tetra", "tetra10")]
    if solid:
        try:
            return make_tetrahedra(points, np.concatenate(solid), _named(read, "triangle", 3))
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    if points.shape[1] == 3 and np.ptp(points[:, 2]) > 1e-9 * np.ptp(points, axis=0).max():
        raise InputError(f"{path}: expected a plane mesh, z varies by {np.ptp(points[:, 2]):g}")
    x, triangles = points[:, :2], []
    middle: dict[tuple[int, int], np.ndarray] = {}
    for block in read.cells:
        corners = {"triangle": 3, "triangle6": 3, "quad": 4, "quad8": 4, "quad9": 4}
        if block.type not in corners:
            continue
        n, cells = corners[block.type], np.asarray(block.data)
        triangles += [cells[:, [0, k, k + 1]] for k in range(1, n - 1)]
        if cells.shape[1] > n:
            for k in range(n):
                ends = np.sort(cells[:, [k, (k + 1) % n]], axis=1)
                middle |= {tuple(pair): x[m] for pair, m in zip(ends.tolist(), cells[:, n + k])}
    if not triangles:
        kinds = ", ".join(sorted({block.type for block in read.cells})) or "nothing"
        raise InputError(f"{path}: expected triangles or quadrilaterals, got {kinds}")
    try:
        return make_mesh(x, np.concatenate(triangles), _named(read, "line", 2), middle)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _named(read: object, kind: str, corners: int) -> dict[str, np.ndarray]:
    """Lines or triangles of a meshio mesh by name: its sets, or Gmsh's physical groups."""
    sets: dict[str, list[np.ndarray]] = {}
    cells, data = read.cells, read.cell_data  # type: ignore[attr-defined]
    groups = read.field_data.items()  # type: ignore[attr-defined]
    names = {int(value[0]): name for name, value in groups if value[1] == corners - 1}
    for number, block in enumerate(cells):
        if not block.type.startswith(kind):
            continue
        found = np.asarray(block.data)[:, :corners]
        if "gmsh:physical" in data:
            for tag in np.unique(data["gmsh:physical"][number]):
                if tag in names:
                    sets.setdefault(names[tag], []).append(
                        found[data["gmsh:physical"][number] == tag]
                    )
            continue
        for name, kept in read.cell_sets.items():  # type: ignore[attr-defined]
            if kept[number] is not None and len(kept[number]):
                sets.setdefault(name, []).append(found[kept[number]])
    return {name: np.concatenate(pairs) for name, pairs in sets.items()}
