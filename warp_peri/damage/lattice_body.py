"""A body on a lattice with free surfaces, and the polylines that cut its bonds.

Unlike the families of a Dirichlet problem a body needs no collar: where it ends, bonds are missing.
The weights of a bond are those of the whole ball.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.errors import InputError
from warp_peri.points.families import HORIZON_TOLERANCE, BondClasses, bond_classes
from warp_peri.points.lattice import neighbour_table, straight_steps

HAIR = 1e-3
"""How far a crack through a row of nodes is moved to one side, in spacings."""
ON_LINE = 1e-6
"""Distance from a crack at which a node lies on it, in spacings."""


@dataclass(frozen=True, eq=False)
class LatticeBody:
    """Nodes of a square lattice and the bonds between them.

    Attributes:
        x: positions [length], shape [N, 2].
        spacing: h [length].
        classes: bond classes of the whole ball.
        neighbour: node at the end of each bond of the ball, shape [N, B] int32; −1 where the body
            has none.
        axes: of the lattice, as columns.
    """

    x: np.ndarray
    spacing: float
    classes: BondClasses
    neighbour: np.ndarray
    axes: np.ndarray = field(default_factory=lambda: np.eye(2))

    @property
    def xi(self) -> np.ndarray:
        """Bond vectors of the ball [length], shape [B, 2]."""
        vectors: np.ndarray = self.classes.xi @ self.axes.T
        return vectors

    @property
    def r(self) -> np.ndarray:
        """Bond lengths of the ball [length], shape [B]."""
        lengths: np.ndarray = self.classes.r[self.classes.bond_class]
        return lengths

    @property
    def opposite(self) -> np.ndarray:
        """Number of the bond with the opposite vector, shape [B]."""
        order = np.lexsort(self.classes.steps.T)
        numbers = np.empty(len(order), dtype=np.int64)
        numbers[order] = order[::-1]
        return numbers


def lattice_body(x: ArrayLike, spacing: float, horizon: float) -> LatticeBody:
    """The bonds of a body on a square lattice, straight or turned.

    Args:
        x: positions [length], shape [N, 2], in any order.
        spacing: h [length].
        horizon: δ [length].

    Raises InputError for points off the lattice, given twice, or too many to be numbered.
    """
    x = np.array(x, dtype=float)
    if x.ndim != 2 or x.shape[1:] != (2,) or len(x) == 0 or not np.isfinite(x).all():
        raise InputError(f"x: expected finite positions of shape [N, 2], got {list(x.shape)}")
    classes = bond_classes(spacing, horizon)
    grid, axes = straight_steps(x, spacing)
    if len(x) * len(classes.steps) >= 2**31:
        raise InputError(f"x: {len(x)} nodes have more bonds than can be numbered (2³¹)")
    return LatticeBody(x, float(spacing), classes, neighbour_table(grid, classes.steps), axes)


def rectangle(width: float, height: float, spacing: float) -> np.ndarray:
    """Nodes in the middle of square cells that fill a rectangle about the origin, shape [N, 2].

    Raises InputError when the sides are not whole multiples of the spacing.
    """
    count = np.rint(np.divide((width, height), spacing)).astype(int)
    if (count < 1).any() or np.abs(count * spacing - (width, height)).max() > 1e-6 * spacing:
        raise InputError(f"sides: expected multiples of {spacing:g}, got {width:g}, {height:g}")
    axes = [(np.arange(n) - (n - 1) / 2) * spacing for n in count]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)


def crossing_bonds(body: LatticeBody, polyline: ArrayLike) -> np.ndarray:
    """Bonds that a crack along a polyline cuts, shape [N, B] bool; both directions of a bond.

    A bond that meets an end of the polyline is not cut, one that meets a corner is; a polyline that
    comes back to its start has corners only. Where a
    segment runs through nodes, these nodes stand on its left: the segment is moved by a hair, with
    a warning.

    Args:
        body: the body.
        polyline: corners [length], shape [P, 2], P ≥ 2.

    Raises InputError for another shape or a segment without length.
    """
    try:
        corners = np.array(polyline, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"crack: expected corners of shape [P, 2], got {polyline!r}") from None
    if corners.ndim != 2 or corners.shape[1:] != (2,) or len(corners) < 2:
        raise InputError(f"crack: expected corners of shape [P ≥ 2, 2], got {list(corners.shape)}")
    if not np.isfinite(corners).all() or (np.diff(corners, axis=0) == 0).all(axis=1).any():
        raise InputError("crack: expected finite corners, and segments with a length")
    cut = np.zeros(body.neighbour.shape, bool)
    last = len(corners) - 2
    open_ended = not np.array_equal(corners[0], corners[-1])
    for number, (start, end) in enumerate(pairwise(corners)):
        tips = (open_ended and number == 0, open_ended and number == last)
        _cut_segment(body, start, end, tips, cut)
    node, bond = np.nonzero(cut)  # rounding at a tip must not leave half a bond
    cut[body.neighbour[node, bond], body.opposite[bond]] = True
    return cut


def _cut_segment(
    body: LatticeBody, start: np.ndarray, end: np.ndarray, tips: tuple[bool, bool], cut: np.ndarray
) -> None:
    """Mark the bonds across one segment; at its tips, not at its corners, the ends are open."""
    reach = body.classes.horizon * (1 + HORIZON_TOLERANCE)
    low, high = np.minimum(start, end) - reach, np.maximum(start, end) + reach
    near = np.flatnonzero(((body.x >= low) & (body.x <= high)).all(axis=1))
    along = end - start
    length = float(np.hypot(*along))
    normal = np.array([-along[1], along[0]]) / length
    height = (body.x[near] - start) @ normal
    within = (body.x[near] - start) @ along / length
    hit = (np.abs(height) < ON_LINE * body.spacing) & (within > 0) & (within < length)
    if hit.any():
        warnings.warn(
            f"crack: {np.count_nonzero(hit)} nodes lie on it; it is moved by {HAIR:g} spacings "
            "to their right",
            stacklevel=4,
        )
        height = height + HAIR * body.spacing
    rise = body.xi @ normal
    other = height[:, None] + rise
    with np.errstate(divide="ignore", invalid="ignore"):
        share = height[:, None] / -rise
    place = (within[:, None] + share * (body.xi @ along / length)) / length
    slack = 1e-9 * body.spacing / length
    lowest, highest = (slack if tips[0] else -slack), 1 - (slack if tips[1] else -slack)
    across = (height[:, None] * other < 0) & (place > lowest) & (place < highest)
    cut[near] |= across & (body.neighbour[near] >= 0)


def cracked(body: LatticeBody, cracks: Sequence[ArrayLike]) -> np.ndarray:
    """The body's neighbours with the bonds across cracks broken (−1 − j), shape [N, B] int32.

    Args:
        body: the body.
        cracks: polylines [length], shape [P, 2] each.
    """
    neighbour = body.neighbour.copy()
    for polyline in cracks:
        cut = crossing_bonds(body, polyline)
        neighbour[cut] = np.where(neighbour[cut] >= 0, -1 - neighbour[cut], neighbour[cut])
    return neighbour
