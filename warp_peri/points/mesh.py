"""A body as triangles: its outline, the named parts of it, and its file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from warp_peri.errors import InputError
from warp_peri.points.cells import REST as REST
from warp_peri.points.cells import outlined
from warp_peri.points.tetrahedra import Tetrahedra, make_tetrahedra

CORNERS = {"triangle": 3, "triangle6": 3, "quad": 4, "quad8": 4, "quad9": 4}
"""Of cells in the plane, by meshio's names."""
GROUPS = (":physical", ":ref", "cell_tags")
"""How data of cells end that are numbers of groups: of Gmsh, of Medit and others, of Salome."""


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
    middle: Mapping[tuple[int, int], ArrayLike] | None = None,
    *,
    inner: bool = False,
) -> Mesh:
    """A mesh from corners and triangles.

    Args:
        x: corners [Å], shape [P, 2]; those that no triangle has are left out.
        triangles: corners of each, shape [T, 3], in either sense.
        parts: edges of the outline by name, pairs of corners, shape [n, 2].
        middle: points halfway along curved edges [Å], by the pair of corners, the smaller first.
        inner: edges of parts that are inside are left out with a warning, not refused.

    Warns and raises InputError as `points.cells.outlined`.
    """
    corners, cells, edges, named, bent = outlined(
        x, triangles, parts or {}, middle or {}, 2, inner=inner
    )
    middles = corners[edges].mean(axis=1)
    for n, (a, b) in enumerate(edges.tolist()):
        middles[n] = bent.get((min(a, b), max(a, b)), middles[n])
    return Mesh(corners, cells, edges, middles, named)


def load_mesh(path: str | os.PathLike[str]) -> Mesh | Tetrahedra:
    """A mesh of any format that meshio reads, positions in Å.

    Tetrahedra, of second order too, of which the corners count; or triangles and quadrilaterals
    (cut in two), straight or of second order, whose edges' midpoints are kept on the outline. Parts
    of the outline are the lines' physical names, sets or numbers of groups, of a surface those of
    the triangles; what is named inside the body is left out with a warning.

    Raises InputError for a file that is not read, without meshio (the extra `bodies`), with cells
    of other kinds or none, for triangles that are not plane, and as `points.cells.outlined`.
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
    try:
        return _body_of(read)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _body_of(read: Any) -> Mesh | Tetrahedra:
    """The body of a meshio mesh; InputError for one with cells of other kinds."""
    points = np.asarray(read.points, dtype=float)
    kinds = {block.type for block in read.cells if block.dim > 1}
    solid = any(block.dim == 3 for block in read.cells)
    known = {"tetra", "tetra10", "triangle", "triangle6"} if solid else set(CORNERS)
    if not kinds or not kinds <= known:
        kinds = kinds - known or {block.type for block in read.cells}
        raise InputError(
            "expected triangles and quadrilaterals, or tetrahedra, and no other cells, got "
            + (", ".join(sorted(kinds)) or "nothing")
        )
    if solid:
        solids = [np.asarray(c.data)[:, :4] for c in read.cells if c.dim == 3]
        return make_tetrahedra(points, _once(read, solids), _named(read, "triangle", 3), inner=True)
    if points.shape[1] == 3 and np.ptp(points[:, 2]) > 1e-9 * np.ptp(points, axis=0).max():
        raise InputError(f"expected a plane mesh, z varies by {np.ptp(points[:, 2]):g}")
    x, triangles = points[:, :2], []
    middle: dict[tuple[int, int], np.ndarray] = {}
    for block in read.cells:
        if block.dim != 2:
            continue
        n, cells = CORNERS[block.type], np.asarray(block.data)
        triangles.append(cells[:, :3] if n == 3 else _halves(x, cells[:, :4]))
        if cells.shape[1] > n:
            for k in range(n):
                ends = np.sort(cells[:, [k, (k + 1) % n]], axis=1)
                middle |= {tuple(pair): x[m] for pair, m in zip(ends.tolist(), cells[:, n + k])}
    return make_mesh(x, _once(read, triangles), _named(read, "line", 2), middle, inner=True)


def _halves(x: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Quadrilaterals [T, 4] cut in two, [n, 3], at the corner that is turned in where one is.

    Those that have a corner twice are one triangle.
    """
    cuts = quads[:, [[[0, 1, 2], [0, 2, 3]], [[1, 2, 3], [1, 3, 0]]]]
    size = np.linalg.det(x[cuts[..., 1:]] - x[cuts[..., :1]])
    least = (size * np.sign(size.sum(axis=2, keepdims=True))).min(axis=2)
    second = (least[:, 0] <= 0) & (least[:, 1] > 0)
    halves = np.where(second[:, None, None], cuts[:, 1], cuts[:, 0])
    halves = np.swapaxes(halves, 0, 1).reshape(-1, 3)
    return np.asarray(halves[(np.diff(np.sort(halves, axis=1), axis=1) > 0).all(axis=1)])


def _once(read: Any, cells: list[np.ndarray]) -> np.ndarray:
    """All cells; those that Gmsh writes once for each of their groups, once."""
    every = np.concatenate(cells)
    if "gmsh:physical" not in read.cell_data:
        return every
    return np.asarray(every[np.sort(np.unique(np.sort(every, 1), axis=0, return_index=True)[1])])


def _named(read: Any, kind: str, corners: int) -> dict[str, np.ndarray]:
    """Lines or triangles of a meshio mesh by name: its sets, and its groups by name or number."""
    sets: dict[str, list[np.ndarray]] = {}
    names = {int(v[0]): [name] for name, v in read.field_data.items() if v[1] == corners - 1}
    names |= getattr(read, "cell_tags", {})
    groups = [key for key in read.cell_data if key.endswith(GROUPS)]
    for number, block in enumerate(read.cells):
        if not block.type.startswith(kind):
            continue
        found = np.asarray(block.data)[:, :corners]
        for key in groups:
            tags = np.asarray(read.cell_data[key][number])
            for tag in np.unique(tags[tags != 0]).tolist():
                for name in names.get(tag, names.get(-tag, [str(abs(tag))])):
                    sets.setdefault(name, []).append(found[tags == tag])
        for name, kept in read.cell_sets.items():
            if not name.startswith("gmsh:") and kept[number] is not None and len(kept[number]):
                sets.setdefault(name, []).append(found[kept[number]])
    return {name: np.concatenate(facets) for name, facets in sets.items()}
