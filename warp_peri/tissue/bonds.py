"""Whole families on the nodes of a square lattice, for energies of bonds and strains."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from warp_peri.errors import InputError
from warp_peri.points.lattice import neighbour_table, straight_steps
from warp_peri.points.samples import PointsLike
from warp_peri.tissue.solid import half_family

SHORT_REACH = 2**0.5
"""Horizon of the short strain in spacings, (H4)."""
AXIS_TOLERANCE = 1e-3
"""Degrees between the stated axis and that of the lattice."""


@dataclass(frozen=True, eq=False)
class LatticeBonds:
    """Whole families on the nodes of a square lattice, bonds ξ and −ξ of one class.

    Attributes:
        steps: bond vectors in lattice steps, those of the half family first, shape [2 C, 2].
        neighbour: far end of every bond, −1 where there is none, shape [N, 2 C].
        whole: which strains a node has: 1 the strain, 2 the short strain, 3 both, shape [N].
        spacing: of the lattice [length].
        grid: place of every node in lattice steps, shape [N, 2].
        axes: of the lattice, which directions of the solid are told from, as columns.
    """

    steps: np.ndarray
    neighbour: np.ndarray
    whole: np.ndarray
    spacing: float
    grid: np.ndarray
    axes: np.ndarray

    @property
    def xi(self) -> np.ndarray:
        """Bond vectors [length], shape [2 C, 2]."""
        vectors: np.ndarray = self.spacing * self.steps @ self.axes.T
        return vectors

    @property
    def classes(self) -> int:
        """Number of bond classes C."""
        return len(self.steps) // 2

    @cached_property
    def pairs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Every bond once: its ends i and j and its class."""
        i, c = np.nonzero(self.neighbour[:, : self.classes] >= 0)
        return i, self.neighbour[i, c], c


def lattice_bonds(points: PointsLike, reach: float) -> LatticeBonds:
    """Families of `reach` spacings on a lattice.

    The axes are those of the lattice: along the points' axis where it is stated, else at most 45°
    from x.

    Raises InputError for scattered points, an axis beside those of the lattice, or where no
    interior node keeps 2δ from the edge.
    """
    if not points.spacing > 0:
        raise InputError("points: expected a lattice (spacing > 0), got scattered points")
    if points.box is not None or points.outside is not None:
        raise InputError("points: expected neither a box nor nodes outside of the body")
    steps, axes = straight_steps(points.x, points.spacing)
    steps, axes = _along(points.axis, steps, axes)
    half = half_family(reach)
    family = np.concatenate([half, -half])
    neighbour = neighbour_table(steps, family)
    near = (family**2).sum(axis=1) <= SHORT_REACH**2 + 1e-9
    whole: np.ndarray = np.all(neighbour >= 0, axis=1).astype(int)
    whole = whole + 2 * np.all(neighbour[:, near] >= 0, axis=1)
    inner = (neighbour[points.interior] >= 0).all(axis=1)
    far = neighbour[points.interior][inner]
    if not inner.all() or not (whole[far] % 2 == 1).all():
        raise InputError("points: interior nodes need complete families out to twice the horizon")
    return LatticeBonds(family, neighbour, whole, points.spacing, steps, axes)


def _along(
    axis: float | None, steps: np.ndarray, axes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Steps and axes of a lattice by quarter turns of its axes to the stated one."""
    if axis is None:
        return steps, axes
    own = float(np.rad2deg(np.arctan2(axes[1, 0], axes[0, 0])))
    quarters = round((axis - own) / 90)
    if abs(axis - own - 90 * quarters) > AXIS_TOLERANCE:
        raise InputError(
            "axis: directions of a hyperelastic solid are told from an axis of the lattice; "
            f"expected none, or {own:.4g}° and quarter turns from it, got {axis:g}°"
        )
    turn = np.linalg.matrix_power(np.array([[0, -1], [1, 0]]), quarters % 4)
    return steps @ turn, axes @ turn
