"""Families on a square lattice: bonds, bond classes and quadrature weights.

Bonds are stored row by row (CSR). Every bond belongs to a class; the influence function is
evaluated once per class. On a lattice a class is one symmetry orbit of bonds.
"""

from __future__ import annotations

import bisect
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

from warp_peri.dataset import PointSet
from warp_peri.errors import InputError
from warp_peri.quadrature import quadrature_weights

HORIZON_TOLERANCE = 1e-6
"""The ball is closed: a bond belongs to the family when r ≤ δ (1 + this)."""

LATTICE_TOLERANCE = 1e-6
"""Largest distance of a node from its lattice position, in spacings."""

COLLAR = "interior nodes need complete families out to twice the horizon"


@dataclass(frozen=True)
class BondClasses:
    """Bonds of a full lattice family, sorted into symmetry orbits.

    Attributes:
        spacing: lattice spacing h [Å].
        horizon: δ [Å].
        steps: bond vectors in lattice steps, shape [B, 2], B bonds a family.
        bond_class: class of each bond, shape [B].
        r: bond length of each class [Å], shape [C].
        weight: quadrature weight W of each class [Å²], shape [C].
    """

    spacing: float
    horizon: float
    steps: np.ndarray
    bond_class: np.ndarray
    r: np.ndarray
    weight: np.ndarray

    @property
    def xi(self) -> np.ndarray:
        """Bond vectors ξ [Å] along the lattice's own axes, shape [B, 2]."""
        return self.spacing * self.steps

    @property
    def count(self) -> np.ndarray:
        """Number of bonds of a family in each class, shape [C]."""
        return np.bincount(self.bond_class)


@dataclass(frozen=True)
class Families:
    """Families of the nodes of one point set.

    Attributes:
        classes: the bond classes.
        xi: bond vectors ξ of the full family [Å], shape [B, 2].
        row: first bond of each node, shape [N + 1]; a node without a full family has no bonds.
        neighbour: node at the far end of each bond, shape [E].
        bond: which bond of the full family it is, shape [E]; its class and vector follow.
        inner: nodes whose whole family have full families (where a force is defined), shape [I].
    """

    classes: BondClasses
    xi: np.ndarray
    row: np.ndarray
    neighbour: np.ndarray
    bond: np.ndarray
    inner: np.ndarray

    @property
    def full(self) -> np.ndarray:
        """Nodes with a full family (where a dilatation is defined)."""
        return np.flatnonzero(np.diff(self.row))


def bond_classes(spacing: float, horizon: float) -> BondClasses:
    """Bonds, orbits and weights of the full family on a square lattice.

    Args:
        spacing: lattice spacing h [Å].
        horizon: δ [Å], at least the spacing.

    Raises InputError when the horizon is below one spacing or the weights do not exist.
    """
    if not (np.isfinite(spacing) and spacing > 0):
        raise InputError(f"spacing: expected a lattice spacing > 0 Å, got {spacing}")
    if not (np.isfinite(horizon) and horizon >= spacing):
        raise InputError(f"horizon: expected at least one spacing ({spacing} Å), got {horizon}")
    reach = int(np.floor(horizon / spacing * (1 + HORIZON_TOLERANCE)))
    a, b = np.meshgrid(*2 * [np.arange(-reach, reach + 1)], indexing="ij")
    steps = np.stack([a.ravel(), b.ravel()], axis=1)
    length = np.hypot(*steps.T)
    inside = (length > 0) & (length * spacing <= horizon * (1 + HORIZON_TOLERANCE))
    steps = steps[inside]
    orbit = np.sort(np.abs(steps), axis=1)[:, ::-1]
    order = np.lexsort((orbit[:, 0], (orbit**2).sum(1)))
    steps, orbit = steps[order], orbit[order]
    new = np.ones(len(orbit), bool)
    new[1:] = (orbit[1:] != orbit[:-1]).any(axis=1)
    bond_class = np.cumsum(new) - 1
    weights = quadrature_weights(spacing * steps, horizon)
    weight = np.bincount(bond_class, weights) / np.bincount(bond_class)
    r = spacing * np.hypot(*orbit[new].T)
    return BondClasses(float(spacing), float(horizon), steps, bond_class, r, weight)


def lattice_families(
    points: PointSet, horizon: float, *, box: tuple[float, float] | None = None
) -> Families:
    """Families of every node of a square lattice that has a complete one.

    Args:
        points: a point set with spacing > 0; its lattice may be rotated.
        horizon: δ [Å].
        box: periods (Lx, Ly) along the axes [Å], whole multiples of the spacing and more than 2δ;
            None when the set is not periodic.

    Raises InputError for scattered points, points off the lattice, duplicate points, a horizon
    below the spacing, and interior nodes that lack the 2δ collar (with the largest horizon that
    would fit).
    """
    h = points.spacing
    if h == 0:
        raise InputError("points: expected a lattice (spacing > 0), got scattered points")
    classes = bond_classes(h, horizon)
    axes = _axes(points.x, h)
    x = points.x @ axes  # coordinates along the lattice
    grid = np.rint((x - x[0]) / h).astype(np.int64)
    if np.abs(x - x[0] - h * grid).max() > LATTICE_TOLERANCE * h:
        raise InputError(f"points: expected a square lattice of spacing {h} Å")
    grid -= grid.min(0)
    reach = int(np.abs(classes.steps).max())
    if box is None:
        size = grid.max(0) + 1 + 2 * reach
        grid = grid + reach
    else:
        if not np.array_equal(axes, np.eye(2)):
            raise InputError("box: expected a lattice along the axes, got a rotated one")
        fits = np.shape(box) == (2,) and np.isfinite(box).all()
        size = np.rint(np.divide(box, h)).astype(np.int64) if fits else np.zeros(2, np.int64)
        if not fits or np.abs(size * h - box).max() > 1e-6 * h or (size <= 2 * reach).any():
            raise InputError(
                f"box: expected two whole multiples of {h} Å above {2 * reach * h} Å, got {box}"
            )
        grid = grid % size
    number = np.full(size, -1, dtype=np.int64)
    number[tuple(grid.T)] = np.arange(len(x))
    if np.count_nonzero(number >= 0) != len(x):
        raise InputError(f"points: {len(x) - np.count_nonzero(number >= 0)} duplicates")

    table = np.empty((len(x), len(classes.steps)), dtype=np.int64)
    for column, step in enumerate(classes.steps):
        table[:, column] = number[tuple(((grid + step) % size).T)]
    full = np.all(table >= 0, axis=1)
    inner = full.copy()
    inner[full] = full[table[full]].all(axis=1)
    lacking = points.interior & ~inner
    if lacking.any():
        raise InputError(
            f"{COLLAR}: {np.count_nonzero(lacking)} of {np.count_nonzero(points.interior)} have "
            f"not at horizon {horizon:g} Å; {_largest_horizon(grid, points.interior, h)}"
        )
    row = np.concatenate([[0], np.cumsum(np.where(full, table.shape[1], 0))])
    bond = np.tile(np.arange(table.shape[1]), np.count_nonzero(full))
    xi = classes.xi @ axes.T
    return Families(classes, xi, row, table[full].ravel(), bond, np.flatnonzero(inner))


def _axes(x: np.ndarray, spacing: float) -> np.ndarray:
    """Directions of the lattice as columns, from the mean angle of nearest-neighbour bonds."""
    i, j = cKDTree(x).query_pairs(spacing * (1 + LATTICE_TOLERANCE), output_type="ndarray").T
    step = (x[j] - x[i]) @ (1, 1j)
    if len(step) == 0:
        raise InputError(
            f"points: expected a square lattice of spacing {spacing} Å, but no two "
            "points are that close"
        )
    angle = np.angle((step**4).sum()) / 4  # the fourth power is blind to quarter turns
    if abs(angle) < 1e-12:
        return np.eye(2)
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _largest_horizon(grid: np.ndarray, interior: np.ndarray, spacing: float) -> str:
    """Say what horizon the collar would carry, of those for which there are quadrature weights."""
    rows, columns = grid.max(0) - grid.min(0) + 1
    present: np.ndarray = np.zeros((rows, columns), bool)
    asked: np.ndarray = np.zeros((rows, columns), bool)
    present[tuple((grid - grid.min(0)).T)] = True
    asked[tuple((grid[interior] - grid.min(0)).T)] = True
    reach = min(present.shape) // 4 + 1  # twice this leaves any node of the set
    length = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1])
    present, asked = np.pad(present, 2 * reach), np.pad(asked, 2 * reach)

    def fits(horizon: float) -> bool:
        ball = length <= horizon * (1 + HORIZON_TOLERANCE)
        needed = binary_dilation(binary_dilation(asked, ball), ball)
        return not (needed & ~present).any()

    candidates = np.unique(length[(length >= 2) & (length <= reach)])
    number = bisect.bisect_left(candidates, True, key=lambda horizon: not fits(horizon))
    if number == 0:
        return "no horizon of two spacings or more fits"
    return f"the largest that fits is {candidates[number - 1] * spacing:g} Å"
