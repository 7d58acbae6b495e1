"""Outlines in the plane, meshed by Netgen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy import ndarray
from numpy.linalg import norm

from warp_peri.errors import InputError, hold, optional
from warp_peri.points.arguments import Positive, check_nodes, checked, typed
from warp_peri.points.mesh import Mesh, make_mesh
from warp_peri.points.points import unit_vectors

ROUND = 1e-6
"""How far from a circle, relatively, the ends of its edges may be."""
SMALL = -10
"""Power of two that `size` is of for Netgen, whose meshes are others for large coordinates."""
GRADING = 0.2
"""Netgen's measure of how fast triangles may grow, 0 to 1."""
AROUND = 100
"""Triangles around an outline for each of its edges, or fewer."""


@typed
@dataclass(frozen=True)
class Circle:
    """A circular outline.

    Attributes:
        radius: [Å].
        centre: [Å].
        name: of its edges.
        size: sides of the triangles along it [Å]; None for that of the mesh.
    """

    radius: Positive
    centre: tuple[float, float] = (0.0, 0.0)
    name: str = "hole"
    size: Positive | None = None

    def __post_init__(self) -> None:
        checked("centre", self.centre, float, (2,))
        checked("1 / radius", 1 / self.radius)  # whose square Netgen takes


@typed
@dataclass(frozen=True)
class Polygon:
    """An outline of straight sides.

    Attributes:
        corners: [Å], counter-clockwise or not; at least three, the first once more or not.
        names: of the sides, from each corner to the next; one for all where it is one.
        size: sides of the triangles along it [Å]; None for that of the mesh.

    Raises InputError for what encloses no area, and another number of names.
    """

    corners: tuple[tuple[float, float], ...]
    names: tuple[str, ...] = ("side",)
    size: Positive | None = None

    def __post_init__(self) -> None:
        x = checked("corners", self.corners, float, ("n", 2))
        if len(x) > 3 and np.abs(x[-1] - x[0]).max() <= ROUND * np.ptp(x, axis=0).max():  # a ring
            x = x[:-1]
        hold(self, corners=tuple(map(tuple, x.tolist())))
        count = len(self.corners)
        if count < 3:
            raise InputError(f"corners: expected three at least, got {count}")
        texts = all(isinstance(name, str) for name in self.names)
        if len(self.names) not in (1, count) or not texts:
            raise InputError(f"names: expected {count} texts, one a side, got {self.names}")
        if not abs(self.area) > ROUND * np.ptp(self.corners, axis=0).max() ** 2:
            raise InputError(f"corners: expected corners around an area, got {self.area:g}")
        if (meet := _meeting(x)).size:
            raise InputError(f"corners: expected sides apart, {meet[0]} and {meet[1]} meet")

    @property
    def area(self) -> float:
        """Signed area, above zero where corners turn counter-clockwise."""
        here, there = np.asarray(self.corners), np.roll(self.corners, -1, axis=0)
        return float((here[:, 0] * there[:, 1] - here[:, 1] * there[:, 0]).sum() / 2)


def _meeting(x: ndarray) -> ndarray:
    """The first two sides of a polygon, not one after the other, that meet, or nothing."""
    ends = np.stack([x, np.roll(x, -1, axis=0)])
    along = ends[1] - ends[0]
    away = ends[:, None] - ends[0, :, None]  # of each end from each side's start
    turn = along[:, 0, None] * away[..., 1] - along[:, 1, None] * away[..., 0]
    beside = turn.prod(axis=0) > 0
    beside |= (ends.min(axis=0)[:, None] > ends.max(axis=0)).any(axis=2)
    near = np.abs(np.subtract.outer(*2 * [np.arange(len(x))])) % (len(x) - 1) <= 1
    return np.concatenate([[], *np.argwhere(~(beside | beside.T | near))[:1]]).astype(int)


Outline = Circle | Polygon


@typed
def box(width: Positive, height: Positive, size: Positive | None = None) -> Polygon:
    """Make a rectangle about the origin; its sides are bottom, right, top and left."""
    a, c = width / 2, height / 2
    corners = ((-a, -c), (a, -c), (a, c), (-a, c))
    return Polygon(corners, ("bottom", "right", "top", "left"), size)


@typed
def mesh_outline(outer: Outline, holes: Sequence[Outline] = (), *, size: Positive) -> Mesh:
    """Mesh the area between an outline and holes in it by triangles, the circles' edges curved.

    Args:
        outer: of the body.
        holes: none may meet another or the outer outline.
        size: sides of the triangles [Å] where the outlines ask for nothing.

    Raises InputError for sizes not positive, outlines that cannot be meshed, and without Netgen.
    """
    without = "netgen-mesher is not installed: pip install 'warp_peri[bodies]'"
    netgen = optional("netgen.geom2d", without)
    outlines = (outer, *holes)
    _check_apart(*outlines)
    check_nodes("size", np.ptp(_rim(outer), axis=0) / size)
    by = math.ldexp(1.0, SMALL - math.frexp(size)[1])
    geometry = netgen.SplineGeometry()
    for outline in outlines:
        check_nodes("size", (np.ptp(_rim(outline)) / (outline.size or np.inf), AROUND))
        _add(geometry, outline, size, by, inside=outline is outer)
    try:
        made = geometry.GenerateMesh(maxh=by * size, grading=GRADING)
    except Exception as error:  # Netgen's own kind
        raise InputError(f"outline: Netgen cannot mesh it ({error})") from None
    x = np.array([point.p for point in made.Points()])[:, :2] / by
    cells = np.array([[p.nr - 1 for p in cell.points] for cell in made.Elements2D()])
    if not len(cells):
        raise InputError("outline: Netgen finds nothing inside it")
    parts: dict[str, list[list[int]]] = {}
    for side in made.Elements1D():
        parts.setdefault(made.GetBCName(side.index - 1), []).append([p.nr - 1 for p in side.points])
    middle = {}
    for one in (one for one in outlines if isinstance(one, Circle)):
        away = x - one.centre
        on = np.abs(norm(away, axis=1) - one.radius) < ROUND * one.radius
        for a, c in parts[one.name]:
            if on[a] and on[c]:
                out = away[a] + away[c]
                middle[a, c] = one.centre + one.radius * out / norm(out)
    return make_mesh(x, cells, parts, middle)


def _rim(outline: Outline) -> ndarray:
    """Closed polyline along an outline, [n, 2]."""
    if isinstance(outline, Polygon):
        return np.array([*outline.corners, outline.corners[0]])
    return outline.radius * unit_vectors(np.linspace(0, 2 * np.pi, 200)) + outline.centre


def _check_apart(outer: Outline, *holes: Outline) -> None:
    """Raise InputError for holes that meet the outer outline or another: Netgen would not end."""
    from matplotlib.path import Path as Curve

    body, *rims = map(_rim, (outer, *holes))
    for n, rim in enumerate(rims):
        inside = Curve(body).contains_points(rim).all()
        crosses = Curve(body).intersects_path(Curve(rim), filled=False)
        if not inside or crosses or any(Curve(rim).intersects_path(Curve(r)) for r in rims[:n]):
            raise InputError(f"holes: expected holes inside that meet nothing, got {holes[n]}")


def _add(geometry: Any, outline: Outline, size: float, by: float, *, inside: bool) -> None:
    """Add a closed curve to a geometry, `by` times as large, the body on its inside or outside."""
    left = inside == (isinstance(outline, Circle) or outline.area > 0)
    maxh = by * (outline.size or size)
    sides = {"leftdomain": int(left), "rightdomain": int(not left), "maxh": maxh}
    if isinstance(outline, Circle):
        centre = tuple(by * np.asarray(outline.centre))
        geometry.AddCircle(c=centre, r=by * outline.radius, bc=outline.name, **sides)
        return
    names = [*outline.names] * (1 if len(outline.names) > 1 else len(outline.corners))
    numbers = [geometry.AppendPoint(*one) for one in by * np.asarray(outline.corners)]
    for start, end, name in zip(numbers, numbers[1:] + numbers[:1], names):
        geometry.Append(["line", start, end], bc=name, **sides)
