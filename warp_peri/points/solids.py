"""Simple bodies in space, and their tetrahedra by Netgen (the extra `bodies`)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.points.outlines import GRADING
from warp_peri.points.tetrahedra import Tetrahedra, make_tetrahedra

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
    try:
        from netgen import csg
    except ImportError:
        raise InputError(
            "netgen-mesher is not installed: pip install 'warp_peri[bodies]'"
        ) from None
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
