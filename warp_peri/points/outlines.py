"""Meshes from outlines in the plane and from solids in space."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_peri.errors import InputError, optional
from warp_peri.points.mesh import Mesh, Tetrahedra, make_mesh, make_tetrahedra

GRADING = 0.2
"""Netgen's measure of how fast triangles may grow, 0 to 1."""

WITHOUT = "netgen-mesher is not installed: pip install 'warp_peri[bodies]'"


@dataclass(frozen=True)
class Circle:
    """A round outline.

    Attributes:
        radius: [Å].
        centre: [Å].
        name: of its edges.
        size: sides of the triangles along it [Å]; None for that of the mesh.
    """

    radius: float
    centre: tuple[float, float] = (0.0, 0.0)
    name: str = "hole"
    size: float | None = None


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
    size: float | None = None


Outline = Circle | Polygon


def box(width: float, height: float, size: float | None = None) -> Polygon:
    """A rectangle about the origin; its sides are bottom, right, top and left."""
    a, c = width / 2, height / 2
    corners = ((-a, -c), (a, -c), (a, c), (-a, c))
    return Polygon(corners, ("bottom", "right", "top", "left"), size)


def mesh_outline(outer: Outline, holes: Sequence[Outline] = (), *, size: float) -> Mesh:
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
    lengths = [size, *(o.radius for o in outlines if isinstance(o, Circle))]
    lengths += [o.size for o in outlines if o.size is not None]
    if not all(np.isfinite(length) and length > 0 for length in lengths):
        raise InputError(f"outline: expected radii and sizes > 0, got {lengths}")
    geometry = netgen.SplineGeometry()
    for outline in outlines:
        _add(geometry, outline, size, inside=outline is outer)
    try:
        made = geometry.GenerateMesh(maxh=float(size), grading=GRADING)
    except Exception as error:  # Netgen's own kind
        raise InputError(f"outline: Netgen cannot mesh it ({error})") from None
    x = np.array([point.p[:2] for point in made.Points()])
    triangles = [[p.nr - 1 for p in element.points] for element in made.Elements2D()]
    parts: dict[str, list[list[int]]] = {}
    for element in made.Elements1D():
        ends = [p.nr - 1 for p in element.points]
        parts.setdefault(made.GetBCName(element.index - 1), []).append(ends)
    if not triangles:
        raise InputError("outline: Netgen finds nothing inside it")
    edges = {name: np.array(pairs) for name, pairs in parts.items()}
    return make_mesh(x, np.array(triangles), edges, _curved(x, outlines, edges))


def _add(geometry: object, outline: Outline, size: float, *, inside: bool) -> None:
    """One closed curve, the body on its inside or its outside."""
    asked = {"maxh": float(outline.size or size)}
    if isinstance(outline, Circle):
        sides = (1, 0) if inside else (0, 1)
        geometry.AddCircle(  # type: ignore[attr-defined]
            c=outline.centre,
            r=outline.radius,
            leftdomain=sides[0],
            rightdomain=sides[1],
            bc=outline.name,
            **asked,
        )
        return
    corners = np.asarray(outline.corners, dtype=float)
    names = outline.names if len(outline.names) > 1 else outline.names * len(corners)
    if corners.ndim != 2 or corners.shape[1:] != (2,) or len(corners) < 3:
        raise InputError(f"polygon: expected corners [n ≥ 3, 2], got {list(corners.shape)}")
    if len(names) != len(corners):
        raise InputError(f"polygon: expected a name for each of {len(corners)} sides, got {names}")
    turn = np.roll(corners, -1, axis=0)
    left = (corners[:, 0] * turn[:, 1] - corners[:, 1] * turn[:, 0]).sum() > 0
    sides = (1, 0) if left == inside else (0, 1)
    numbers = [geometry.AppendPoint(*corner) for corner in corners.tolist()]  # type: ignore[attr-defined]
    for start, end, name in zip(numbers, numbers[1:] + numbers[:1], names):
        geometry.Append(  # type: ignore[attr-defined]
            ["line", start, end], leftdomain=sides[0], rightdomain=sides[1], bc=name, **asked
        )


def _curved(
    x: np.ndarray, outlines: Sequence[Outline], edges: dict[str, np.ndarray]
) -> dict[tuple[int, int], np.ndarray]:
    """Points of the circles halfway along their edges."""
    middle = {}
    for circle in (o for o in outlines if isinstance(o, Circle)):
        away = x - circle.centre
        on = np.abs(np.hypot(*away.T) - circle.radius) < 1e-6 * circle.radius
        for pair in np.sort(edges[circle.name], axis=1).tolist():
            if on[pair].all():
                half = away[pair].sum(axis=0)
                point = np.asarray(circle.centre) + circle.radius * half / np.hypot(*half)
                middle[pair[0], pair[1]] = point
    return middle


SIDES = ("left", "right", "front", "back", "bottom", "top")
"""Of a block: the ends of its first, second and third axis."""


ROUND = 1e-6
"""How far from a sphere, relatively, the corners of its faces may be."""


@dataclass(frozen=True)
class Sphere:
    """A ball, or a round void, whose faces are curved.

    Attributes:
        radius: [length].
        centre: [length].
        name: of its surface.
        size: of the faces along it [length]; None for that of the mesh.
    """

    radius: float
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    name: str = "void"
    size: float | None = None


@dataclass(frozen=True)
class Block:
    """A block about the origin, its faces named SIDES.

    Attributes:
        sides: lengths along the axes.
    """

    sides: tuple[float, float, float]


def mesh_solid(outer: Sphere | Block, voids: Sequence[Sphere] = (), *, size: float) -> Tetrahedra:
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
    lengths = [size, *(ball.radius for ball in balls)]
    lengths += [ball.size for ball in balls if ball.size is not None]
    lengths += list(outer.sides) if isinstance(outer, Block) else []
    if not all(np.isfinite(length) and length > 0 for length in lengths):
        raise InputError(f"solid: expected lengths > 0, got {lengths}")

    def ball(one: Sphere) -> Any:
        made = csg.Sphere(csg.Pnt(*one.centre), one.radius).bc(one.name)
        return made.maxh(float(one.size or size))

    body: Any = ball(outer) if isinstance(outer, Sphere) else None
    if isinstance(outer, Block):
        half = np.array(outer.sides) / 2
        for n, name in enumerate(SIDES):
            out = np.zeros(3)
            out[n // 2] = 2 * (n % 2) - 1
            plane = csg.Plane(csg.Pnt(*(out * half)), csg.Vec(*out)).bc(name)
            body = plane if body is None else body * plane
    for one in voids:
        body = body - ball(one)
    geometry = csg.CSGeometry()
    geometry.Add(body)
    try:
        made = geometry.GenerateMesh(maxh=float(size), grading=GRADING)
    except Exception as error:  # Netgen's own kind
        raise InputError(f"solid: Netgen cannot mesh it ({error})") from None
    x = np.array([point.p for point in made.Points()])
    cells = np.array([[p.nr - 1 for p in cell.points] for cell in made.Elements3D()])
    if not len(cells):
        raise InputError("solid: Netgen finds nothing inside it")
    parts: dict[str, list[list[int]]] = {}
    for face in made.Elements2D():
        corners = [p.nr - 1 for p in face.points]
        parts.setdefault(made.GetBCName(face.index - 1), []).append(corners)
    middle: dict[tuple[int, int], np.ndarray] = {}
    for one in balls:
        centre = np.array(one.centre)
        for face in parts[one.name]:
            for pair in itertools.combinations(sorted(face), 2):
                out = x[list(pair)].mean(axis=0) - centre
                on = x[list(pair)] - centre
                if np.allclose(np.linalg.norm(on, axis=1), one.radius, rtol=ROUND):  # of this ball
                    middle[pair] = centre + one.radius * out / np.linalg.norm(out)
    named = {name: np.array(faces) for name, faces in parts.items()}
    return make_tetrahedra(x, cells, named, middle)
