"""Triangles or tetrahedra of any body: what is checked before they are one, and their outline."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Mapping
from typing import Any, TypeAlias

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
    if t.min() < 0 or t.max() >= len(x):
        raise InputError(f"{name}: expected corners 0 to {len(x) - 1}, got {t.min()}, {t.max()}")
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
