"""Lattice bodies with free surfaces, where bonds are missing, and cracks that cut bonds.

A body needs no collar; the weights of a bond are those of the whole ball.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy import ndarray
from numpy.linalg import eigvalsh, inv, norm
from numpy.typing import ArrayLike

from warp_peri.errors import InputError, InSpace, warn
from warp_peri.points.arguments import Positive, check_nodes, checked, typed, typed_methods
from warp_peri.points.families import HORIZON_TOLERANCE, BondClasses, bond_classes, neighbour_table
from warp_peri.points.points import check_dimensions, checked_positions, grid_places, straight_steps

HAIR = 1e-3
"""How far a crack through a row of nodes is moved to one side, in spacings."""
ON_LINE = 1e-6
"""Distance from a crack at which a node lies on it, in spacings."""
FELT = 2.0
"""Distance within which nodes take a force that acts at a place, in spacings."""


@typed_methods
@dataclass(frozen=True, eq=False)
class LatticeBody(InSpace):
    """Nodes of a square or cubic lattice and the bonds between them.

    Attributes:
        x: positions [length], shape [N, d].
        spacing: h [length].
        classes: bond classes of the whole ball.
        neighbour: node at the end of each bond of the ball, [N, B] int32; −1 where there is none.
        axes: of the lattice, as columns.
        endless: whether it goes on along its last axis, as of lattice_body.
    """

    x: ndarray
    spacing: float
    classes: BondClasses
    neighbour: ndarray
    axes: ndarray
    endless: bool = False

    @property
    def xi(self) -> ndarray:
        """Bond vectors of a node's whole ball [length], shape [B, d]."""
        return np.asarray(self.classes.xi @ self.axes.T)

    @property
    def r(self) -> ndarray:
        """Bond lengths of a node's whole ball [length], shape [B]."""
        return np.asarray(self.classes.r[self.classes.bond_class])

    @property
    def opposite(self) -> ndarray:
        """Number of the bond with the opposite vector, shape [B]."""
        return self.classes.reverse


@typed
def lattice_body(
    x: ArrayLike, spacing: Positive, horizon: Positive, *, endless: bool = False
) -> LatticeBody:
    """Make a body and its bonds on a square or cubic lattice, straight or turned.

    Positions x [length], [N, 2] or [N, 3], are in any order; with `endless` they are one layer of a
    straight body that goes on along its last axis, all layers alike, and bonds beyond its end lead
    to this layer's nodes. Raises InputError for points off the lattice, or given twice.
    """
    x = checked_positions(x)
    classes = bond_classes(spacing, horizon, dimension=x.shape[1])
    grid, axes = straight_steps(x, spacing)
    steps = classes.steps * [*(x.shape[1] - 1) * (1,), 0] if endless else classes.steps
    return LatticeBody(x, float(spacing), classes, neighbour_table(grid, steps), axes, endless)


@typed
def rectangle_nodes(width: Positive, height: Positive, spacing: Positive) -> ndarray:
    """Nodes in the middle of cells that fill a rectangle, as box_nodes."""
    return box_nodes((width, height), spacing)


@typed
def box_nodes(sides: Sequence[float], spacing: Positive) -> ndarray:
    """Nodes in the middle of cells that fill a box about the origin, shape [N, d]. Raises
    InputError when the sides are not whole multiples of the spacing."""
    check_dimensions("sides", len(sides))
    count = np.rint(checked("sides", sides, float, ("d",)) / spacing)
    if (count < 1).any() or np.abs(count * spacing - sides).max() > 1e-6 * spacing:
        got = ", ".join(f"{side:g}" for side in sides)
        raise InputError(f"sides: expected multiples of {spacing:g}, got {got}")
    check_nodes("sides", count)
    return (grid_places(count.astype(int)) - (count - 1) / 2) * spacing


@typed
def penny_corners(radius: Positive) -> ndarray:
    """Corners, 48 of them, of a circular crack about the origin on y = 0, same area, [48, 3]."""
    t = 2 * np.pi * np.arange(48) / 48
    reach = radius * np.sqrt(t[1] / np.sin(t[1]))
    return np.asarray(reach * np.stack([np.cos(t), 0 * t, np.sin(t)], axis=1))


def through(left: float, right: float, side: float, dimension: int) -> list[tuple[float, ...]]:
    """Crack on y = 0 from x = left to right; in space through |z| < side."""
    if dimension == 2:
        return [(left, 0.0), (right, 0.0)]
    return [(left, 0.0, -side), (left, 0.0, side), (right, 0.0, side), (right, 0.0, -side)]


@typed
def point_force(
    x: ndarray, spacing: Positive, place: Sequence[float], force: Sequence[float]
) -> ndarray:
    """Body force density [force / length^d], [N, d], of a force at a place, on a node or not (C27).

    Its work equals the force's (in the plane per thickness) in any affine displacement, by least
    squares of the nodes within two spacings. Raises InputError where these do not span the space.
    """
    x = checked("x", x, float, ("N", "d"))
    d = x.shape[1]
    away = (x - checked("place", place, float, (d,))) / spacing
    pull = checked("force", force, float, (d,))
    square = (away**2).sum(axis=1)
    near = np.flatnonzero(square < FELT**2)
    affine = np.column_stack([np.ones(len(near)), away[near]])
    weight = 1 - square[near] / FELT**2
    moments = (affine.T * weight) @ affine
    if len(near) <= d or eigvalsh(moments)[0] < 1e-6 * len(near):
        raise InputError(f"place: its {len(near)} nodes within {FELT:g} spacings span no space")
    share = weight * (affine @ inv(moments)[0])
    b = np.zeros(x.shape)
    b[near] = share[:, None] * pull / spacing**d
    return b


def crossing_bonds(body: LatticeBody, polyline: ArrayLike, name: str = "crack") -> ndarray:
    """Bonds that a crack along a polyline cuts, shape [N, B] bool; both directions of a bond.

    A bond that meets an end is not cut, one that meets a corner or a mouth is: an end beyond which
    the body has no nodes. A closed polyline has corners only. Nodes on a segment stand on its left,
    with a warning. In space a crack is a flat convex polygon, whose edges cut nothing; nodes on it
    stand where its corners go round against the clock.

    Raises InputError for corners of another shape than [P ≥ 2, 2], in space [P ≥ 3, 3], a segment
    without length, and a polygon that is not flat and convex.
    """
    d = body.dimension
    corners = checked(name, polyline)
    if corners.ndim != 2 or corners.shape[1:] != (d,) or len(corners) < d:
        raise InputError(f"{name}: expected corners of shape [P ≥ {d}, {d}], got {corners.shape}")
    if (np.diff(corners, axis=0) == 0).all(axis=1).any():
        raise InputError(f"{name}: expected segments with a length")
    cut = np.zeros(body.neighbour.shape, bool)
    for face in _segments(body, corners) if d == 2 else _polygon(corners, name):
        _cut_face(body, *face, cut)
    node, bond = np.nonzero(cut)  # rounding at a tip must not leave half a bond
    cut[body.neighbour[node, bond], body.opposite[bond]] = True
    return cut


Face = tuple[ndarray, ndarray, ndarray, ndarray]
"""A flat piece of a crack: corners [P, d], unit normal [d], inward normals of its edges [P, d],
and how far inside of each edge a bond must cross it, in lengths of these normals [P]."""


def _segments(body: LatticeBody, corners: ndarray) -> Iterator[Face]:
    """Iterate over the faces of a polyline, corners and mouths included, tips not."""
    open_ended, last = not np.array_equal(corners[0], corners[-1]), len(corners) - 2
    for number, ends in enumerate(pairwise(corners)):
        along = (step := ends[1] - ends[0]) / np.hypot(*step)
        tips = (
            open_ended and number == 0 and _goes_on(body, ends[0], -along),
            open_ended and number == last and _goes_on(body, ends[1], along),
        )
        slack = np.where(tips, 1e-9, -1e-9) * body.spacing
        yield np.stack(ends), np.array([-along[1], along[0]]), np.stack([along, -along]), slack


def _polygon(corners: ndarray, name: str) -> Iterator[Face]:
    """Yield the face of a flat convex polygon in space, whose edges cut nothing."""
    size, normal = size_and_normal(corners)
    if not size > 0 or np.abs((corners - corners[0]) @ normal).max() > ON_LINE * size**0.5:
        raise InputError(f"{name}: expected the corners of a flat polygon with an area")
    inward = np.cross(normal, np.roll(corners, -1, axis=0) - corners)
    if (corners @ inward.T - (inward * corners).sum(axis=1)).min() < -1e-9 * size:
        raise InputError(f"{name}: expected a convex polygon, corners in order; cut it in parts")
    yield corners, normal, inward, np.full(len(corners), 1e-9 * size)


def _cut_face(
    body: LatticeBody,
    corners: ndarray,
    normal: ndarray,
    inward: ndarray,
    slack: ndarray,
    cut: ndarray,
) -> None:
    """Mark the bonds across a Face; nodes on it stand on the side of its normal."""
    near, offset = _near(body, corners), (inward * corners).sum(axis=1)
    x, h = body.x[near], body.spacing
    height = (x - corners[0]) @ normal
    hit = np.abs(height) < ON_LINE * h
    hit &= (x @ inward.T - offset > np.maximum(slack, 0)).all(axis=1)
    if hit.any():
        warn(f"crack: {hit.sum()} nodes lie on it; it is moved by {HAIR:g} spacings to its right")
        height = height + HAIR * h
    rise = body.xi @ normal
    for bond in np.flatnonzero(rise):
        across = np.flatnonzero(
            (height * (height + rise[bond]) < 0) & (body.neighbour[near, bond] >= 0)
        )
        place = x[across] - (height[across] / rise[bond])[:, None] * body.xi[bond]
        cut[near[across[(place @ inward.T - offset > slack).all(axis=1)]], bond] = True


def size_and_normal(corners: ndarray) -> tuple[float, ndarray]:
    """Length and left normal of a polyline, or area and normal of a polygon; zeros without size."""
    if corners.shape[1] == 2:
        along = corners[-1] - corners[0]
        length = float(np.hypot(*np.diff(corners, axis=0).T).sum())
        return length, np.array([-along[1], along[0]]) / (np.hypot(*along) or 1.0)
    away = corners - corners[0]
    area = np.cross(away, np.roll(away, -1, axis=0)).sum(axis=0) / 2
    size = float(norm(area))
    return size, area / (size or 1.0)


def _goes_on(body: LatticeBody, tip: ndarray, along: ndarray) -> bool:
    """Whether the body has nodes beyond the end of a crack; else that is a mouth."""
    away = body.x[_near(body, tip[None])] - tip
    return bool((away @ along > ON_LINE * body.spacing).any())


def _near(body: LatticeBody, corners: ndarray) -> ndarray:
    """Numbers of the nodes with bonds that may lead beyond these corners."""
    reach = body.classes.horizon * (1 + HORIZON_TOLERANCE)
    low, high = corners.min(axis=0) - reach, corners.max(axis=0) + reach
    return np.flatnonzero(((body.x >= low) & (body.x <= high)).all(axis=1))


def cracked(body: LatticeBody, cracks: Sequence[ArrayLike]) -> ndarray:
    """Neighbours of a body with the bonds across cracks broken (−1 − j), shape [N, B] int32."""
    if not np.iterable(cracks):
        raise InputError(f"cracks: expected a list of polylines, got {cracks!r:.50}")
    cut = np.zeros(body.neighbour.shape, bool)
    for polyline in cracks:
        cut |= (own := crossing_bonds(body, polyline))
        if not own.any():
            warn("crack: cuts no bond of the body")
    return np.where(cut, -1 - body.neighbour, body.neighbour)
