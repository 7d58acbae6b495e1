"""Whole families on the nodes of a square lattice, for energies of bonds and strains."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from warp_peri.errors import InputError
from warp_peri.points.samples import PointsLike
from warp_peri.tissue.solid import half_family

SHORT_REACH = 2**0.5
"""Horizon of the short strain in spacings, (H4)."""


@dataclass(frozen=True, eq=False)
class LatticeBonds:
    """Whole families on the nodes of a square lattice, bonds ξ and −ξ of one class.

    Attributes:
        steps: bond vectors in lattice steps, those of the half family first, shape [2 C, 2].
        neighbour: far end of every bond, −1 where there is none, shape [N, 2 C].
        whole: which strains a node has: 1 the strain, 2 the short strain, 3 both, shape [N].
        spacing: of the lattice [length].
    """

    steps: np.ndarray
    neighbour: np.ndarray
    whole: np.ndarray
    spacing: float

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

    Raises InputError for scattered points, or where no interior node keeps 2δ from the edge.
    """
    if not points.spacing > 0:
        raise InputError("points: expected a lattice (spacing > 0), got scattered points")
    if points.box is not None or points.outside is not None:
        raise InputError("points: expected neither a box nor nodes outside of the body")
    place = (points.x - points.x.min(axis=0)) / points.spacing
    steps = np.rint(place).astype(int)
    if np.abs(place - steps).max() > 1e-6:
        raise InputError("points: expected nodes on a square lattice along the axes")
    half = half_family(reach)
    family = np.concatenate([half, -half])
    pad = int(np.abs(family).max())
    number = np.full(steps.max(axis=0) + 1 + 2 * pad, -1)
    number[tuple((steps + pad).T)] = np.arange(len(steps))
    neighbour = np.stack([number[tuple((steps + pad + step).T)] for step in family], axis=1)
    near = (family**2).sum(axis=1) <= SHORT_REACH**2 + 1e-9
    whole: np.ndarray = np.all(neighbour >= 0, axis=1).astype(int)
    whole = whole + 2 * np.all(neighbour[:, near] >= 0, axis=1)
    inner = (neighbour[points.interior] >= 0).all(axis=1)
    far = neighbour[points.interior][inner]
    if not inner.all() or not (whole[far] % 2 == 1).all():
        raise InputError("points: interior nodes need complete families out to twice the horizon")
    return LatticeBonds(family, neighbour, whole, points.spacing)
