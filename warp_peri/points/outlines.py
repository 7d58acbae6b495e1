"""Simple outlines, and their triangles by Netgen (the extra `bodies`; LGPL, all in one wheel)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warp_peri.errors import InputError
from warp_peri.points.mesh import Mesh, make_mesh

GRADING = 0.2
"""Netgen's measure of how fast triangles may grow, 0 to 1."""


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
    try:
        from netgen.geom2d import SplineGeometry
    except ImportError:
        raise InputError(
            "netgen-mesher is not installed: pip install 'warp_peri[bodies]'"
        ) from None
    outlines = (outer, *holes)
    lengths = [size, *(o.radius for o in outlines if isinstance(o, Circle))]
    lengths += [o.size for o in outlines if o.size is not None]
    if not all(np.isfinite(length) and length > 0 for length in lengths):
        raise InputError(f"outline: expected radii and sizes > 0, got {lengths}")
    geometry = SplineGeometry()
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
