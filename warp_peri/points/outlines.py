"""Meshes from outlines in the plane and from solids in space."""

from __future__ import annotations

import itertools
import operator
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from warp_peri.errors import InputError, optional
from warp_peri.points.arguments import Positive, typed
from warp_peri.points.mesh import Mesh, make_mesh

GRADING = 0.2
"""Netgen's measure of how fast triangles may grow, 0 to 1."""

WITHOUT = "netgen-mesher is not installed: pip install 'warp_peri[bodies]'"


@typed
@dataclass(frozen=True)
class Circle:
    """A round outline.

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


@typed
@dataclass(frozen=True)
class Polygon:
    """An outline of straight sides.

    Attributes:
        corners: [Å], counter-clockwise or not; at least three.
        names: of the sides, from each corner to the next; one for all where it is one.
        size: sides of the triangles along it [Å]; None for that of the mesh.
    """

    corners: tuple[tuple[float, float], ...]
    names: tuple[str, ...] = ("side",)
    size: Positive | None = None


Outline = Circle | Polygon


@typed
def box(width: Positive, height: Positive, size: Positive | None = None) -> Polygon:
    """A rectangle about the origin; its sides are bottom, right, top and left."""
    a, c = width / 2, height / 2
    corners = ((-a, -c), (a, -c), (a, c), (-a, c))
    return Polygon(corners, ("bottom", "right", "top", "left"), size)


@typed
def mesh_outline(outer: Outline, holes: Sequence[Outline] = (), *, size: Positive) -> Mesh:
    """Triangles between an outline and holes in it, the circles' edges curved.

    Args:
        outer: of the body.
        holes: none may meet another or the outer outline.
        size: sides of the triangles [Å] where the outlines ask for nothing.

    Raises InputError for sizes that are not positive, a polygon that is none, outlines that cannot
    be meshed, and without Netgen.
    """
    netgen = optional("netgen.geom2d", WITHOUT)
    outlines = (outer, *holes)
    geometry = netgen.SplineGeometry()
    for outline in outlines:
        _add(geometry, outline, size, inside=outline is outer)
    circles = [one for one in outlines if isinstance(one, Circle)]
    return _meshed("outline", geometry, size, circles, 2)


def _meshed(what: str, geometry: Any, size: float, balls: list[Any], d: int) -> Mesh:
    """A geometry's mesh, with points of the circles or spheres halfway along their edges."""
    try:
        made = geometry.GenerateMesh(maxh=float(size), grading=GRADING)
    except Exception as error:  # Netgen's own kind
        raise InputError(f"{what}: Netgen cannot mesh it ({error})") from None
    x = np.array([point.p for point in made.Points()])[:, :d]
    *_, sides, body = (made.Elements1D, made.Elements2D, made.Elements3D)[:d]
    cells = np.array([[p.nr - 1 for p in cell.points] for cell in body()])
    if not len(cells):
        raise InputError(f"{what}: Netgen finds nothing inside it")
    parts: dict[str, list[list[int]]] = {}
    for side in sides():
        corners = sorted(p.nr - 1 for p in side.points)
        parts.setdefault(made.GetBCName(side.index - 1), []).append(corners)
    middle: dict[tuple[int, int], np.ndarray] = {}
    for one in balls:
        away = x - one.centre
        on = np.abs(np.linalg.norm(away, axis=1) - one.radius) < ROUND * one.radius
        for side in parts[one.name]:
            for a, c in itertools.combinations(side, 2):
                if on[a] and on[c]:
                    out = away[a] + away[c]
                    middle[a, c] = one.centre + one.radius * out / np.linalg.norm(out)
    return make_mesh(x, cells, parts, middle)


def _add(geometry: Any, outline: Outline, size: float, *, inside: bool) -> None:
    """One closed curve, the body on its inside or its outside."""
    maxh = float(outline.size or size)
    if isinstance(outline, Circle):
        sides = {"leftdomain": int(inside), "rightdomain": int(not inside), "maxh": maxh}
        geometry.AddCircle(c=outline.centre, r=outline.radius, bc=outline.name, **sides)
        return
    corners = np.asarray(outline.corners, dtype=float)
    names = outline.names if len(outline.names) > 1 else outline.names * len(corners)
    if corners.ndim != 2 or corners.shape[1:] != (2,) or len(corners) < 3:
        raise InputError(f"polygon: expected corners [n ≥ 3, 2], got {list(corners.shape)}")
    if len(names) != len(corners):
        raise InputError(f"polygon: expected a name for each of {len(corners)} sides, got {names}")
    turn = np.roll(corners, -1, axis=0)
    area = (corners[:, 0] * turn[:, 1] - corners[:, 1] * turn[:, 0]).sum() / 2
    if not abs(area) > ROUND * np.ptp(corners, axis=0).max() ** 2:
        raise InputError(f"polygon: expected corners around an area, got {area:g}")
    left = (area > 0) == inside
    sides = {"leftdomain": int(left), "rightdomain": int(not left), "maxh": maxh}
    numbers = [geometry.AppendPoint(*corner) for corner in corners.tolist()]
    for start, end, name in zip(numbers, numbers[1:] + numbers[:1], names):
        geometry.Append(["line", start, end], bc=name, **sides)


SIDES = ("left", "right", "front", "back", "bottom", "top")
"""Of a block: the ends of its first, second and third axis."""


ROUND = 1e-6
"""How far from a circle or a sphere, relatively, the ends of its edges may be."""


@typed
@dataclass(frozen=True)
class Sphere:
    """A ball, or a round void, whose faces are curved.

    Attributes:
        radius: [length].
        centre: [length].
        name: of its surface.
        size: of the faces along it [length]; None for that of the mesh.
    """

    radius: Positive
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    name: str = "void"
    size: Positive | None = None


@typed
@dataclass(frozen=True)
class Block:
    """A block about the origin, its faces named SIDES.

    Attributes:
        sides: lengths along the axes.
    """

    sides: tuple[float, float, float]


@typed
def mesh_solid(outer: Sphere | Block, voids: Sequence[Sphere] = (), *, size: Positive) -> Mesh:
    """Tetrahedra between a surface and voids in it.

    Args:
        outer: of the body; none of the voids may meet it or another.
        voids: inside.
        size: of the cells [length] where the surfaces ask for nothing.

    Raises InputError for sizes that are not positive, a body that cannot be meshed, and without
    Netgen.
    """
    csg = optional("netgen.csg", WITHOUT)
    balls = [one for one in (outer, *voids) if isinstance(one, Sphere)]
    solids = [
        csg.Sphere(csg.Pnt(*one.centre), one.radius).bc(one.name).maxh(float(one.size or size))
        for one in balls
    ]
    if isinstance(outer, Block):
        if not min(outer.sides) > 0:
            raise InputError(f"solid: expected sides > 0, got {outer.sides}")
        out = np.kron(np.eye(3), [[-1.0], [1.0]])
        half = np.array(outer.sides) / 2
        planes = [csg.Plane(csg.Pnt(*(n * half)), csg.Vec(*n)) for n in out]
        faces = [plane.bc(name) for plane, name in zip(planes, SIDES)]
        solids.insert(0, reduce(operator.mul, faces))
    geometry = csg.CSGeometry()
    geometry.Add(reduce(operator.sub, solids))
    return _meshed("solid", geometry, size, balls, 3)
