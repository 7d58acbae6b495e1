"""Meshes of triangles, quadrilaterals and tetrahedra, from files too."""

from __future__ import annotations

import itertools
import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias
from xml.etree import ElementTree

import h5py
import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from warp_peri.errors import InputError, optional
from warp_peri.files.foreign import check_hdf5, check_xml, content
from warp_peri.points.abaqus import read_abaqus
from warp_peri.points.arrays import checked

REST = "rest"
"""Name of the edges of an outline, or the faces of a surface, that have no other."""
FLAT = 1e-9
"""Size of a cell over that power of its longest side below which it counts as none."""
SAME = 1e-6
"""Corners nearer to each other than this part of the shortest side are one."""
BEYOND, INSIDE = 1e-4, 1e-8
"""How far beyond a cell no other may be, in its heights; depth that counts as inside, likewise."""
KINDS = {
    2: ("triangles", "area", "edge", "edges of the outline"),
    3: ("tetrahedra", "volume", "face", "faces of the surface"),
}
FACETS = {
    2: np.array([[0, 1], [1, 2], [2, 0]]),
    3: np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]),
}
"""Corners of each edge or face of a cell."""
ACROSS = {2: np.array([2, 0, 1]), 3: np.arange(4)}
"""Corner across from each."""
ASKED = 5000
"""Cells that are asked at once what they hold."""
WITHIN = 1e-9
"""How far outside a cell, in its own coordinates, a position may lie that it holds."""


Outlined: TypeAlias = tuple[
    np.ndarray, np.ndarray, np.ndarray, dict[str, np.ndarray], dict[tuple[int, int], np.ndarray]
]
"""Corners of some cell, cells by them, facets that one cell alone has, these by name, and points
halfway along curved edges by the pair of corners, rising. In the plane cells are counter-clockwise
and the body is on the left of its facets."""


def outlined(
    x: Any,
    cells: Any,
    parts: Mapping[str, ArrayLike],
    middle: Mapping[tuple[int, int], ArrayLike],
    d: int,
    *,
    inner: bool = False,
) -> Outlined:
    """The body that cells make, if they are cells of one, and its outline.

    Args:
        x: corners [length], shape [P, d].
        cells: their corners, shape [T, d + 1].
        parts: facets of the outline by name, by their corners, shape [n, d].
        middle: points halfway along curved edges, by the pair of corners.
        d: 2 or 3.
        inner: facets inside the body are taken out of parts, with a warning.

    Corners that lie at one place are taken as one, with a warning. Raises InputError for other
    shapes, corners out of range, cells of no size, more than two cells at a facet, cells that
    overlap, or that meet at a part of a facet, and facets of parts inside the body.
    """
    name, measure, facet, whole = KINDS[d]
    x, t = checked("x", x, shape=("P", d)), checked(name, cells, int, ("T", d + 1))
    if not len(t):
        raise InputError(f"{name}: expected some, got none")
    check_numbers(name, t, len(x))
    size = np.linalg.det(x[t[:, 1:]] - x[t[:, :1]])
    pairs = list(itertools.combinations(range(d + 1), 2))
    lengths = [np.linalg.norm(x[t[:, a]] - x[t[:, b]], axis=1) for a, b in pairs]
    share = np.abs(size) / np.max(lengths, axis=0) ** d
    if not (share > FLAT).all():
        raise InputError(f"{name}: number {int(np.argmin(share))} has no {measure}")
    used, at = np.unique(t, return_inverse=True)
    new = np.full(len(x), -1)
    first, number = np.unique(_welded(x[used], SAME * np.min(lengths)), return_inverse=True)
    new[used] = number
    x, t = x[used[first]], number[at].reshape(-1, d + 1)
    if d == 2:
        t = np.where((size < 0)[:, None], t[:, ::-1], t)
    every, keys, back, count = _facets(t)
    if count.max() > 2:
        raise InputError(f"{name}: expected one or two at each {facet}, some {facet} has more")
    across = np.concatenate([t[:, corner] for corner in ACROSS[d]])
    side = np.linalg.det(x[np.c_[keys[back][:, 1:], across]] - x[keys[back][:, :1]])
    shared = np.argsort(back, kind="stable")
    shared = shared[count[back[shared]] == 2].reshape(-1, 2)
    if (over := shared[np.prod(np.sign(side[shared]), axis=1) > 0] % len(t)).size:
        raise InputError(f"{name}: {over[0, 0]} and {over[0, 1]} lie on one side of their {facet}")
    rows = np.flatnonzero(count[back] == 1)
    rows = rows if d == 2 else rows[np.argsort(back[rows])]
    facets = every[rows] if d == 2 else keys[back[rows]]
    _refuse_covered(x, t, facets, across[rows], d)
    new = np.append(new, -1)  # of what is no corner
    kept = {n: checked(f"part '{n}'", part, int) for n, part in parts.items() if np.size(part)}
    kept = {n: new[np.clip(part, -1, len(new) - 1)] for n, part in kept.items()}
    named = _named(facets, kept, whole, inner)
    ends = {pair: sorted(new[list(pair)].tolist()) for pair in middle}
    bent = {(a, b): np.asarray(middle[pair], float) for pair, (a, b) in ends.items()}
    return x, t, facets, named, bent


def check_numbers(name: str, numbers: np.ndarray, count: int, what: str = "corners") -> None:
    """Raise InputError unless all are 0 to `count` − 1."""
    if numbers.size and not 0 <= (least := numbers.min()) <= (most := numbers.max()) < count:
        raise InputError(f"{name}: expected {what} 0 to {count - 1}, got {least}, {most}")


def _facets(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Facets of all cells, those that differ by rising corners, which each is, and how often."""
    every = np.concatenate([t[:, corners] for corners in FACETS[t.shape[1] - 1]])
    keys, back, count = np.unique(
        np.sort(every, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    return every, keys, back.ravel(), count


def _welded(x: np.ndarray, near: float) -> np.ndarray:
    """For each corner the first that lies at its place, shape [P]; a warning where some do."""
    pairs = cKDTree(x).query_pairs(near, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(len(x), len(x)))
    count, label = connected_components(links, directed=False)
    if count < len(x):
        warnings.warn(
            f"mesh: {len(x) - count} of {len(x)} corners lie where others do and are taken as "
            "these; a crack needs a width",
            stacklevel=4,
        )
    first = np.unique(label, return_index=True)[1]
    return np.asarray(first[label])


def _refuse_covered(
    x: np.ndarray, t: np.ndarray, facets: np.ndarray, across: np.ndarray, d: int
) -> None:
    """Raise InputError where there is a cell just beyond the outline, or at a corner of it.

    Then cells overlap; or one has a corner amid an edge or a face of another, which are not joined.
    """
    some = {2: (0.5, 0.05, 0.275), 3: (1 / 3, 0.05, 0.475)}[d]
    weights = np.unique(
        [p for s in some for p in itertools.permutations([1 - (d - 1) * s, *[s] * (d - 1)])], axis=0
    )
    corners = np.unique(facets)
    on = np.einsum("wk,fkd->wfd", weights, x[facets])
    beyond = on + BEYOND * (on - x[across])
    held = Finder(x, t).holding(np.concatenate([beyond.reshape(-1, d), x[corners]]), INSIDE)
    bad = np.flatnonzero(held >= 0)
    if bad.size:
        name, _, facet, _ = KINDS[d]
        place = np.concatenate([on.reshape(-1, d), x[corners]])[bad[0]]
        raise InputError(
            f"{name}: at {', '.join(f'{value:.6g}' for value in place)} number {held[bad[0]]} goes "
            f"on beyond another's {facet}: expected cells that share whole {facet}s and do not "
            "overlap"
        )


def _named(
    facets: np.ndarray, parts: Mapping[str, np.ndarray], whole: str, inner: bool
) -> dict[str, np.ndarray]:
    """Facets by name, each once; InputError, or a warning, for parts that hold others."""
    number = {tuple(facet): n for n, facet in enumerate(np.sort(facets, axis=1).tolist())}
    named, taken = {}, np.zeros(len(facets), bool)
    for name, part in parts.items():
        of = [
            number.get(tuple(one), -1)
            for one in np.sort(part, axis=-1).reshape(-1, facets.shape[1]).tolist()
        ]
        kept = np.unique([n for n in of if n >= 0]).astype(int)
        if lost := of.count(-1):
            words = f"part '{name}': expected {whole}, {lost} of {len(of)} are not"
            if not inner:
                raise InputError(words)
            warnings.warn(f"{words} and are left out", stacklevel=4)
        if len(kept) or not lost:
            named[name] = kept
            taken[kept] = True
    if not taken.all():
        named[REST] = np.union1d(named.get(REST, np.zeros(0, int)), np.flatnonzero(~taken))
    return named


class Finder:
    """Which cell of a body holds a position.

    Args:
        x: corners [length], shape [P, d].
        cells: by their corners, shape [T, d + 1].
    """

    def __init__(self, x: np.ndarray, cells: np.ndarray) -> None:
        corners = x[cells]
        self.first = corners[:, 0]
        self.inverse = np.linalg.inv(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))
        self.middle = corners.mean(axis=1)
        size = np.linalg.norm(corners - self.middle[:, None], axis=2).max(axis=1) * (1 + WITHIN)
        rank = np.ceil(2 * np.log2(size)).astype(int)
        self.classes = [(2.0 ** (n / 2), np.flatnonzero(rank == n)) for n in np.unique(rank)]

    def holding(self, x: np.ndarray, depth: float = -WITHIN) -> np.ndarray:
        """Number of a cell that holds each position so deep in its own coordinates, or −1."""
        found, points = np.full(len(x), -1), cKDTree(x)
        for size, some in self.classes:  # a cell is asked for what lies as near as its own corners
            for part in np.array_split(some, len(some) // ASKED + 1):
                near = points.query_ball_point(self.middle[part], size)
                cell = np.repeat(part, [len(n) for n in near])
                n = np.concatenate(near).astype(int)
                own = np.einsum("nij,nj->ni", self.inverse[cell], x[n] - self.first[cell])
                held = np.minimum(own.min(axis=1), 1 - own.sum(axis=1)) >= depth
                found[n[held]] = cell[held]
        return found


def pieces(cells: np.ndarray) -> np.ndarray:
    """Number of the piece of the body that each cell belongs to; those of a piece share facets."""
    count, (_, keys, facet, _) = len(cells), _facets(cells)
    of = np.tile(np.arange(count), cells.shape[1]), count + facet
    links = coo_array((np.ones(len(facet)), of), shape=(count + len(keys),) * 2)
    return np.asarray(connected_components(links, directed=False)[1][:count])


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

    Warns and raises InputError as `points.mesh.outlined`.
    """
    corners, t, faces, named, bent = outlined(x, cells, parts or {}, middle or {}, 3, inner=inner)
    curved = np.array(list(bent), dtype=int).reshape(-1, 2)
    points = np.array(list(bent.values()), dtype=float).reshape(-1, 3)
    return Tetrahedra(corners, t, faces, named, curved, points)


CORNERS = {
    **{"triangle": 3, "triangle6": 3, "quad": 4, "quad8": 4, "quad9": 4, "tetra": 4, "tetra10": 4},
    **{"pyramid": 5, "pyramid13": 5, "pyramid14": 5, "wedge": 6, "wedge15": 6, "wedge18": 6},
    **{"hexahedron": 8, "hexahedron20": 8, "hexahedron27": 8},
}
"""Of cells, by meshio's names; they come first, by VTK's order."""
FACES = {
    5: ([0, 1, 2, 3], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]),
    6: ([0, 1, 2], [3, 4, 5], [0, 1, 4, 3], [1, 2, 5, 4], [2, 0, 3, 5]),
    8: ([0, 1, 2, 3], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]),
}
"""Of pyramids, prisms and hexahedra, by how many corners they have."""
FORMATS = {".msh": "gmsh", ".vtk": "vtk", ".vtu": "vtu", ".xdmf": "xdmf", ".inp": "abaqus"}
"""Meshes that are read, by how their files' names end."""
GROUPS = (":physical", ":ref", "cell_tags")
"""How data of cells end that are numbers of groups, in files that meshio made of others too."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of a body, with an outline that may be curved.

    Attributes:
        x: corners [length], shape [P, 2].
        triangles: numbers of their corners, shape [T, 3] int, counter-clockwise.
        edges: the outline's edges by their corners, shape [E, 2] int, the body on their left.
        middle: points of the outline halfway along the edges [length], shape [E, 2]; an edge is
            the parabola through its ends and this.
        parts: edges by name, numbers into `edges`, shape [n] int each; those that have no name are
            REST.

    Raises InputError naming the first array of another shape, with values that are not finite, or
    with a number that no corner or edge has. `make_mesh` finds the outline and refuses overlaps.

    >>> ends = np.array([[0, 1], [1, 2], [2, 0]])  # of a triangle's edges
    >>> x = np.array([[0.0, 0.0], [9.0, 0.0], [0.0, 9.0]])
    >>> mesh = wp.Mesh(x, np.array([[0, 1, 2]]), ends, x[ends].mean(axis=1))
    """

    x: np.ndarray
    triangles: np.ndarray
    edges: np.ndarray
    middle: np.ndarray
    parts: dict[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        corners = len(checked("x", self.x, shape=("P", 2)))
        check_numbers("triangles", checked("triangles", self.triangles, int, ("T", 3)), corners)
        check_numbers("edges", checked("edges", self.edges, int, ("E", 2)), corners)
        checked("middle", self.middle, shape=(len(self.edges), 2))
        for name, part in self.parts.items():
            name = f"part '{name}'"
            check_numbers(name, checked(name, part, int, ("n",)), len(self.edges), "edges")

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

    Warns and raises InputError as `points.mesh.outlined`.
    """
    corners, cells, edges, named, bent = outlined(
        x, triangles, parts or {}, middle or {}, 2, inner=inner
    )
    middles = corners[edges].mean(axis=1)
    for n, (a, b) in enumerate(edges.tolist()):
        middles[n] = bent.get((min(a, b), max(a, b)), middles[n])
    return Mesh(corners, cells, edges, middles, named)


def load_mesh(path: str | os.PathLike[str]) -> Mesh | Tetrahedra:
    """A mesh of Gmsh (.msh), VTK (.vtk, .vtu), XDMF or Abaqus (.inp, one flat part), in Å.

    Tetrahedra, or hexahedra, prisms and pyramids, which are cut into them, of second order too, of
    which the corners count; or triangles and quadrilaterals (cut in two), straight or of second
    order, whose edges' midpoints are kept on the outline. Parts of the outline are the lines'
    physical names, sets or numbers of groups, of a surface those of its triangles and
    quadrilaterals, and Abaqus's sets of nodes; what is named inside the body is left out with a
    warning.

    Raises InputError for another format, a file that is not read, without meshio (the extra
    `bodies`), with cells of other kinds or none, for triangles that are not plane, for what
    `points.abaqus.read_abaqus` does not read, and as `points.mesh.outlined`.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such mesh file")
    form = FORMATS.get(path.suffix.lower())
    if form is None:
        raise InputError(
            f"{path}: expected a mesh in {', '.join(FORMATS)}; convert it with meshio, then check "
            "the groups"
        )
    try:
        if form == "abaqus":
            return _body_of(read_abaqus(content(path).decode("utf-8", "replace")))
        if form in ("vtu", "xdmf"):
            _check_arrays(path)
        meshio = optional("meshio", "meshio is not installed: pip install 'warp_peri[bodies]'")
        read = meshio.read(path, file_format=form)
    except InputError as error:
        raise InputError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None
    except (Exception, SystemExit) as error:  # meshio leaves the program on some files
        raise InputError(f"{path}: not a mesh of {form} ({error})") from None
    try:
        return _body_of(read)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _check_arrays(path: Path) -> None:
    """InputError for XML with entities, and for arrays of XDMF that are not in HDF5 beside it."""
    check_xml(path, text := content(path))
    if path.suffix.lower() == ".vtu":
        return
    try:
        items = [item for item in ElementTree.fromstring(text).iter() if item.tag == "DataItem"]
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: expected XML ({error})") from None
    held = {(i.text or "").strip().split(":")[0] for i in items if i.get("Format") == "HDF"}
    if any(i.get("Format") not in (None, "XML", "HDF") for i in items):
        raise InputError(f"{path}: expected arrays in the file or in HDF5, got others")
    for name in held:
        if Path(name).name != name or not (beside := path.with_name(name)).is_file():
            raise InputError(f"{path}: expected its arrays in HDF5 beside it, got {name!r}")
        try:
            with h5py.File(beside, "r") as file:
                check_hdf5(file, beside.stat().st_size)
        except (InputError, OSError) as error:
            raise InputError(f"{beside}: {error}") from None


def _body_of(read: Any) -> Mesh | Tetrahedra:
    """The body of a meshio mesh; InputError for one with cells of other kinds."""
    points = np.asarray(read.points, dtype=float)
    kinds = {block.type for block in read.cells if block.dim > 1}
    for block in read.cells:
        if not np.size(block.data) or np.shape(block.data)[1] < CORNERS.get(block.type, 1):
            raise InputError(f"expected whole cells, got a block of {block.type} that is cut off")
    if not kinds or not kinds <= set(CORNERS):
        kinds = kinds - set(CORNERS) or {block.type for block in read.cells}
        raise InputError(
            "expected triangles and quadrilaterals, or tetrahedra, hexahedra, prisms and pyramids, "
            "and no other cells, got " + (", ".join(sorted(kinds)) or "nothing")
        )
    if any(block.dim == 3 for block in read.cells):
        _join(read, points)
    solids = [np.asarray(c.data)[:, : CORNERS[c.type]] for c in read.cells if c.dim == 3]
    if solids:
        cells = _once(read, [_in_tetrahedra(cells) for cells in solids])
        return make_tetrahedra(points, cells, _named_groups(read, cells), inner=True)
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
    cells = _once(read, triangles)
    return make_mesh(x, cells, _named_groups(read, cells), middle, inner=True)


def _join(read: Any, points: np.ndarray) -> None:
    """Give all cells that share a place its first corner, so that both sides of a face cut alike.

    Warns as _welded. Raises InputError for corners out of range, as `outlined`.
    """
    solids = [np.asarray(b.data)[:, : CORNERS[b.type]] for b in read.cells if b.dim == 3]
    used = np.unique(np.concatenate([cells.ravel() for cells in solids]))
    if not (used.size and used[0] >= 0 and used[-1] < len(points) and np.isfinite(points).all()):
        return  # which is told of later
    shortest = np.inf
    for cells in solids:
        a, b = np.array([*itertools.combinations(range(cells.shape[1]), 2)]).T
        side = np.linalg.norm(points[cells[:, a]] - points[cells[:, b]], axis=2)
        some = side[side > SAME * side.max(axis=1, keepdims=True)]  # not those of no length
        shortest = min(shortest, float(some.min(initial=np.inf)))
    if not shortest < np.inf:
        return
    first = np.arange(len(points))
    first[used] = used[_welded(points[used], SAME * shortest)]
    for block in read.cells:
        block.data = first[np.asarray(block.data)]


def _in_triangles(faces: np.ndarray) -> np.ndarray:
    """Triangles [n, 3] of faces with three or four corners, [F, 3] or [F, 4].

    Quadrilaterals are cut from their corner of least number, so that both sides cut alike.
    """
    first, count = np.argmin(faces, axis=1)[:, None], faces.shape[1]
    turned = np.take_along_axis(faces, (first + np.arange(count)) % count, axis=1)
    return np.concatenate([turned[:, [0, k, k + 1]] for k in range(1, count - 1)])


def _in_tetrahedra(cells: np.ndarray) -> np.ndarray:
    """Tetrahedra [n, 4] of cells: from the corner of least number to the faces without it.

    Raises InputError for a cell that leaves none.
    """
    if cells.shape[1] == 4:
        return cells
    apex, found, left = cells.min(axis=1, keepdims=True), [], np.zeros(len(cells), bool)
    for face in FACES[cells.shape[1]]:
        away = (cells[:, face] != apex).all(axis=1)
        across = _in_triangles(cells[away][:, face])
        cut = np.hstack([np.tile(apex[away], (len(face) - 2, 1)), across])
        whole = _whole(cut)
        left[np.tile(np.flatnonzero(away), len(face) - 2)[whole]] = True
        found.append(cut[whole])
    if not left.all():
        raise InputError(
            f"cells: number {np.argmin(left)} of those with {cells.shape[1]} corners has no volume"
        )
    return np.concatenate(found)


def _whole(cells: np.ndarray) -> np.ndarray:
    """Which cells have no corner twice."""
    return np.asarray((np.diff(np.sort(cells, axis=1), axis=1) > 0).all(axis=1))


def _halves(x: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Quadrilaterals [T, 4] cut in two, [n, 3], at the corner that is turned in where one is.

    Those that have a corner twice are one triangle.
    """
    cuts = quads[:, [[[0, 1, 2], [0, 2, 3]], [[1, 2, 3], [1, 3, 0]]]]
    size = np.linalg.det(x[cuts[..., 1:]] - x[cuts[..., :1]])
    least = (size * np.sign(size.sum(axis=2, keepdims=True))).min(axis=2)
    second = (least[:, 0] <= 0) & (least[:, 1] > 0)
    halves = np.where(second[:, None, None], cuts[:, 1], cuts[:, 0])
    every = np.swapaxes(halves, 0, 1).reshape(-1, 3)
    return np.asarray(every[_whole(every)])


def _once(read: Any, cells: list[np.ndarray]) -> np.ndarray:
    """All cells; those that Gmsh writes once for each of their groups, once."""
    every = np.concatenate(cells)
    if "gmsh:physical" not in read.cell_data:
        return every
    return np.asarray(every[np.sort(np.unique(np.sort(every, 1), axis=0, return_index=True)[1])])


def _named_groups(read: Any, body: np.ndarray) -> dict[str, np.ndarray]:
    """Lines or triangles of a meshio mesh by name: its sets, and its groups by name or number.

    Of a set of nodes the sides of the body's outline with all their corners in it.
    """
    dim = body.shape[1] - 2
    sets: dict[str, list[np.ndarray]] = {}
    names = {int(v[0]): [name] for name, v in read.field_data.items() if v[1] == dim}
    groups = [key for key in read.cell_data if key.endswith(GROUPS)]
    for number, block in enumerate(read.cells):
        if block.dim != dim:
            continue
        found = np.asarray(block.data)[:, : CORNERS.get(block.type, 2)]
        for key in groups:
            tags = np.asarray(read.cell_data[key][number])
            for tag in np.unique(tags[tags != 0]).tolist():
                for name in names.get(tag, names.get(-tag, [str(abs(tag))])):
                    sets.setdefault(name, []).append(found[tags == tag])
        for name, kept in read.cell_sets.items():
            if not name.startswith("gmsh:") and kept[number] is not None and len(kept[number]):
                sets.setdefault(name, []).append(found[kept[number]])
    unnamed = sum(len(block.data) for block in read.cells if block.dim == dim)
    _, outer, _, count = _facets(body)
    for name, nodes in read.point_sets.items():
        if not name.startswith("gmsh:"):
            sides = outer[(count == 1) & np.isin(outer, nodes).all(axis=1)]
            if not len(sides):
                warnings.warn(f"{name}: no side of the outline is between its nodes", stacklevel=5)
            sets.setdefault(name, []).append(sides)
    if unnamed and not sets:
        warnings.warn(
            f"none of the {unnamed} {'faces' if dim == 2 else 'lines'} in the file is in a group: "
            f"all parts are '{REST}'; vtu, vtk and xdmf keep no sets, .msh and .inp do",
            stacklevel=5,
        )
    cut = _in_triangles if dim == 2 else np.asarray
    every = {name: np.concatenate([*map(cut, facets)]) for name, facets in sets.items()}
    return {name: facets[_whole(facets)] for name, facets in every.items()}
