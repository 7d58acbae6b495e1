"""Meshes of triangles or tetrahedra, and their checks."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy import ndarray
from numpy.linalg import det, inv, norm
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from warp_peri.errors import Arrays, InputError, InSpace, Rows, Shown, Values, hold, warn
from warp_peri.points.arguments import Positive, as_array, checked, typed
from warp_peri.points.points import checked_positions, grid_places

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
MOST_PARTS = {2: 10**6, 3: 12}
"""Of the side of an edge or a face, between points that distances are measured to."""


@typed
@dataclass(frozen=True, eq=False, repr=False)
class Mesh(InSpace, Shown):
    """Triangles or tetrahedra of a body, with an outline or a surface that may be curved.

    Attributes:
        x: corners [length], shape [P, d].
        cells: numbers of their corners, shape [T, d + 1] int; triangles counter-clockwise.
        faces: edges of the outline, or triangles of the surface, by their corners, shape [F, d]
            int; the body is on the left of edges, and inside of faces whose corners turn
            counter-clockwise seen from outside.
        middle: points of the outline halfway along the `curved` edges [length], shape [E, d]; an
            edge is the parabola through its ends and this.
        parts: faces by name, numbers into `faces`, shape [n] int each; those without are REST.
        curved: edges by their corners, shape [E, 2] int; in the plane all `faces`.

    Raises InputError naming the first array of another shape, with values that are not finite, or
    with a number that no corner or face has, and for no cells or faces. `make_mesh` finds the
    outline and refuses overlaps.

    >>> ends = np.array([[0, 1], [1, 2], [2, 0]])  # of a triangle's edges
    >>> x = np.array([[0.0, 0.0], [9.0, 0.0], [0.0, 9.0]])
    >>> mesh = wp.Mesh(x, np.array([[0, 1, 2]]), ends, x[ends].mean(axis=1))
    """

    x: ndarray
    cells: ndarray
    faces: ndarray
    middle: ndarray
    parts: dict[str, ndarray] = field(default_factory=dict)
    curved: ndarray = field(default_factory=lambda: np.zeros((0, 2), int))

    def __post_init__(self) -> None:
        hold(self, x=checked_positions(self.x))
        count, d = self.x.shape
        cells, _, facet, _ = KINDS[d]
        hold(self, cells=checked_numbers(cells, self.cells, ("T", d + 1), count, least=1))
        sides = np.diff(self.x[self.cells], axis=1)
        flat = np.flatnonzero(np.abs(det(sides)) <= FLAT * norm(sides, axis=2).max(axis=1) ** d)
        if len(flat):
            raise InputError(f"{cells}: expected corners around an area or volume, not {flat[0]}")
        faces = checked_numbers(f"{facet}s", self.faces, ("F", d), count, least=1)
        curved = faces if d == 2 else checked_numbers("curved", self.curved, ("E", 2), count)
        middle, parts = checked("middle", self.middle, shape=(len(curved), d)), {}
        for name, part in self.parts.items():
            numbers = checked_numbers(f"part '{name}'", part, ("n",), len(faces), f"{facet}s")
            parts[name] = np.unique(numbers)
        hold(self, faces=faces, curved=curved, middle=middle, parts=parts)

    def summary(self) -> Values:
        """Counts, box and parts of the mesh as plain values."""
        box = np.transpose([self.x.min(axis=0), self.x.max(axis=0)])
        counts = {"corners": len(self.x), KINDS[self.dimension][0]: len(self.cells)}
        return counts | {"box": box, "parts": {n: len(part) for n, part in self.parts.items()}}

    def rows(self) -> Rows:
        found = self.summary()
        box = ", ".join(f"{a:g} to {b:g}" for a, b in found.pop("box"))
        parts = ", ".join(f"{name} ({count})" for name, count in found.pop("parts").items())
        return [*((n, str(count)) for n, count in found.items()), ("box", box), ("parts", parts)]

    @property
    def hole_sizes(self) -> ndarray:
        """Smallest side of the box around each hole or cavity [length], shape [holes]."""
        pairs = np.concatenate([self.faces[:, [a, a - 1]] for a in range(self.dimension)])
        label = joined(len(self.x), pairs)
        turn = det(self.x[self.faces])
        holes = np.flatnonzero(np.bincount(label[self.faces[:, 0]], turn) < 0)
        of, x = label[self.faces.ravel()], self.x[self.faces.ravel()]
        of, x = np.append(of, label[self.curved[:, 0]]), np.concatenate([x, self.middle])
        return np.array([np.ptp(x[of == n], axis=0).min() for n in holes])

    def distance(self, x: ndarray, step: Positive) -> ndarray:
        """Distance [length] of points to the outline, by points of it about `step` apart."""
        d, corners = self.dimension, self.x[self.faces]
        longest = norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
        count = min(int(np.ceil(longest / step)) + 1, MOST_PARTS[d])
        place = grid_places((count + 1,) * (d - 1))
        place = place[place.sum(axis=1) <= count]
        weight = np.column_stack([count - place.sum(axis=1), place]) / count
        at = weight @ corners
        if d == 2:
            bulge = self.middle - corners.mean(axis=1)
            at = at + 4 * weight.prod(axis=1)[:, None] * bulge[:, None]
        return np.asarray(cKDTree(at.reshape(-1, d)).query(checked("x", x, float, ("n", d)))[0])

    def holding(self, x: ndarray) -> ndarray:
        """Number of the straight-sided cell that holds each point, −1 where none does."""
        return cells_holding(self.x[self.cells], checked("x", x, float, ("n", self.dimension)))


@typed
def make_mesh(
    x: Any,
    cells: ArrayLike,
    parts: Mapping[str, ArrayLike] | None = None,
    middle: Mapping[tuple[int, int], ArrayLike] | None = None,
    *,
    inner: bool = False,
) -> Mesh:
    """Make a mesh from corners and triangles or tetrahedra.

    Args:
        x: corners [length], shape [P, d]; those that no cell has are left out.
        cells: corners of each, shape [T, d + 1], in either sense.
        parts: edges of the outline, or triangles of the surface, by name, by their corners, [n, d].
        middle: points halfway along curved edges [length], by the pair of corners.
        inner: facets of parts that are inside are left out with a warning, not refused.

    Corners that lie at one place are taken as one, with a warning. Raises InputError for other
    shapes, corners out of range, cells of no size, more than two cells at a facet, cells that
    overlap, or that meet at a part of a facet, and facets of parts inside the body.
    """
    parts, middle = parts or {}, middle or {}
    x = checked_positions(x)
    d = x.shape[1]
    name, measure, _, whole = KINDS[d]
    t = checked_numbers(name, cells, ("T", d + 1), len(x), least=1)
    size = det(x[t[:, 1:]] - x[t[:, :1]])
    pairs = list(itertools.combinations(range(d + 1), 2))
    lengths = [norm(x[t[:, a]] - x[t[:, b]], axis=1) for a, b in pairs]
    share = np.abs(size) / np.max(lengths, axis=0) ** d
    if not (share > FLAT).all():
        raise InputError(f"{name}: number {np.argmin(share)} has no {measure}")
    used, at = np.unique(t, return_inverse=True)
    new = np.full(len(x) + 1, -1)  # the last of what is no corner
    first, number = np.unique(_welded(x[used], SAME * np.min(lengths)), return_inverse=True)
    new[used] = number
    x, t = x[used[first]], number[at].reshape(-1, d + 1)
    if d == 2:
        t = np.where((size < 0)[:, None], t[:, ::-1], t)
    faces = _outline(x, t)
    kept = {
        n: new[np.clip(checked(f"part '{n}'", part, int, ("n", d)), -1, len(new) - 1)]
        for n, part in parts.items()
        if as_array(f"part '{n}'", part).size
    }
    keys = checked_numbers("middle", [*middle] or t[:0, :2], ("n", 2), len(new) - 1)
    points = [checked("middle", point, float, (d,)) for point in middle.values()]
    bent = dict(zip(map(tuple, np.sort(new[keys]).tolist()), points))
    ends = faces if d == 2 else np.array([*bent], int).reshape(-1, 2)
    halves = x[ends].mean(axis=1)
    for n, (a, b) in enumerate(np.sort(ends, axis=1).tolist()):
        halves[n] = bent.get((a, b), halves[n])
    return Mesh(x, t, faces, halves, _named(faces, kept, whole, inner), ends)


def _outline(x: ndarray, t: ndarray) -> ndarray:
    """Outline edges, or surface faces, of cells t, the body on their left; InputError for cells
    that overlap, or do not share whole facets."""
    d = x.shape[1]
    name, _, facet, _ = KINDS[d]
    every, keys, back, count = facets_of(t)
    if count.max() > 2:
        raise InputError(f"{name}: expected one or two at each {facet}, some {facet} has more")
    across = np.concatenate([t[:, corner] for corner in ACROSS[d]])
    side = det(x[np.c_[keys[back][:, 1:], across]] - x[keys[back][:, :1]])
    shared = np.argsort(back, kind="stable")
    shared = shared[count[back[shared]] == 2].reshape(-1, 2)
    if (over := shared[np.prod(np.sign(side[shared]), axis=1) > 0] % len(t)).size:
        raise InputError(f"{name}: {over[0, 0]} and {over[0, 1]} lie on one side of their {facet}")
    rows = np.flatnonzero(count[back] == 1)
    rows = rows if d == 2 else rows[np.argsort(back[rows])]
    faces = every[rows] if d == 2 else keys[back[rows]]
    if d == 3:
        faces = np.where(side[rows, None] > 0, faces[:, [0, 2, 1]], faces)
    _refuse_covered(x, t, faces, across[rows])
    return faces


def checked_numbers(
    name: str, value: Any, shape: tuple[Any, ...], count: int, what: str = "corners", least: int = 0
) -> ndarray:
    """Check whole numbers, of a shape as for `checked` and `least` rows; InputError for others, and
    unless all are 0 to `count` − 1."""
    found = checked(name, value, int, shape)
    if len(found) < least:
        raise InputError(f"{name}: expected some, got none")
    if found.size and not 0 <= found.min() <= found.max() < count:
        raise InputError(
            f"{name}: expected {what} 0 to {count - 1}, got {found.min()}, {found.max()}"
        )
    return found


def facets_of(t: ndarray) -> tuple[ndarray, ndarray, ndarray, ndarray]:
    """Facets of all cells, the distinct ones by rising corners, indices into these, and counts."""
    every = np.concatenate([t[:, corners] for corners in FACETS[t.shape[1] - 1]])
    keys, back, count = np.unique(
        np.sort(every, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    return every, keys, back.ravel(), count


def joined(count: int, pairs: ndarray) -> ndarray:
    """Group number of each of `count` things joined by pairs [n, 2]."""
    links = coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(count, count))
    return np.asarray(connected_components(links, directed=False)[1])


def _welded(x: ndarray, near: float) -> ndarray:
    """First corner at each corner's place, shape [P]; warns where some coincide."""
    label = joined(len(x), cKDTree(x).query_pairs(near, output_type="ndarray"))
    first = np.unique(label, return_index=True)[1]
    if len(first) < len(x):
        warn(
            f"mesh: {len(x) - len(first)} of {len(x)} corners lie where others do and are taken as "
            "these; a crack needs a width"
        )
    return np.asarray(first[label])


def _refuse_covered(x: ndarray, t: ndarray, facets: ndarray, across: ndarray) -> None:
    """Raise InputError where a cell lies just beyond the outline or a corner of it: cells overlap,
    or a corner lies amid an edge or face of another."""
    d = x.shape[1]
    some = {2: (0.5, 0.05, 0.275), 3: (1 / 3, 0.05, 0.475)}[d]
    weights = np.unique(
        [p for s in some for p in itertools.permutations([1 - (d - 1) * s, *[s] * (d - 1)])], axis=0
    )
    on = np.einsum("wk,fkd->wfd", weights, x[facets])
    beyond, corners = on + BEYOND * (on - x[across]), x[np.unique(facets)]
    held = cells_holding(x[t], np.concatenate([beyond.reshape(-1, d), corners]), INSIDE)
    if (bad := np.flatnonzero(held >= 0)).size:
        name, _, facet, _ = KINDS[d]
        place = np.concatenate([on.reshape(-1, d), corners])[bad[0]]
        raise InputError(
            f"{name}: at {', '.join(f'{value:.6g}' for value in place)} number {held[bad[0]]} goes "
            f"on beyond another's {facet}: expected cells that share whole {facet}s and do not "
            "overlap"
        )


def _named(facets: ndarray, parts: Arrays, whole: str, inner: bool) -> Arrays:
    """Facets by name, each once; InputError, or a warning, for parts that hold others."""
    number = {tuple(facet): n for n, facet in enumerate(np.sort(facets, axis=1).tolist())}
    named, left = {}, np.ones(len(facets), bool)
    for name, part in parts.items():
        rows = np.sort(part, axis=-1).reshape(-1, facets.shape[1]).tolist()
        of = [number.get(tuple(row), -1) for row in rows]
        kept = np.unique([n for n in of if n >= 0]).astype(int)
        if lost := of.count(-1):
            words = f"part '{name}': expected {whole}, {lost} of {len(of)} are not"
            if not inner:
                raise InputError(words)
            warn(f"{words} and are left out")
        if len(kept) or not lost:
            named[name] = kept
            left[kept] = False
    if left.any():
        named[REST] = np.union1d(named.get(REST, np.zeros(0, int)), np.flatnonzero(left))
    return named


def cells_holding(corners: ndarray, x: ndarray, depth: float = -WITHIN) -> ndarray:
    """Number of a cell, of corners [T, d + 1, d], that holds each position [n, d], or −1; `depth`
    is in the cell's own coordinates, which are 0 to 1 across."""
    inverse = inv((corners[:, 1:] - corners[:, :1]).mT)
    middle = corners.mean(axis=1)
    size = norm(corners - middle[:, None], axis=2).max(axis=1) * (1 + WITHIN)
    found, points = np.full(len(x), -1), cKDTree(x)
    for part in np.array_split(np.arange(len(size)), len(size) // ASKED + 1):
        near = points.query_ball_point(middle[part], size[part])
        cell = np.repeat(part, [len(n) for n in near])
        n = np.concatenate(near).astype(int)
        own = np.einsum("nij,nj->ni", inverse[cell], x[n] - corners[cell, 0])
        held = np.minimum(own.min(axis=1), 1 - own.sum(axis=1)) >= depth
        found[n[held]] = cell[held]
    return found


def pieces(cells: ndarray) -> ndarray:
    """Piece number of each cell; cells of a piece are connected by facets."""
    count, (_, keys, facet, _) = len(cells), facets_of(cells)
    pairs = np.stack([np.tile(np.arange(count), cells.shape[1]), count + facet], axis=1)
    return joined(count + len(keys), pairs)[:count]
