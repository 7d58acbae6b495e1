"""Where the nodes of a Dirichlet problem lie on their lattice: the unknowns, and their collar."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
import torch

from warp_peri.errors import InputError
from warp_peri.operator.stencil import Torus
from warp_peri.points.families import BondClasses, bond_classes, families_of
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.quadrature import DEGREE
from warp_peri.points.samples import PointsLike


@dataclass(frozen=True)
class Domain:
    """The box around the unknowns, and a wider box that holds all displacement they feel.

    Attributes:
        classes: bond classes of the lattice.
        axes: directions of the lattice as columns.
        reach: steps that the operator reaches; the wider box has so many more nodes on each side.
        mask: unknown nodes in the box, shape [n₁, n₂] bool.
        interior: numbers of the interior nodes in the point set.
        collar: nodes of the wider box that are not unknown, in its shape, bool.
        free: places of the interior nodes in the box, flat, in the order of the point set.
        near: nodes of the point set that lie in the wider box, by number.
        place: their places in it, flat.
        torus: a torus that holds the wider box.
    """

    classes: BondClasses
    axes: torch.Tensor
    reach: int
    mask: torch.Tensor
    interior: torch.Tensor
    collar: torch.Tensor
    free: torch.Tensor
    near: torch.Tensor
    place: torch.Tensor
    torus: Torus

    @property
    def wide(self) -> tuple[int, int]:
        """Nodes of the wider box along the axes."""
        return self.mask.shape[0] + 2 * self.reach, self.mask.shape[1] + 2 * self.reach

    @property
    def is_rectangle(self) -> bool:
        """Whether all nodes of the box are unknown."""
        return bool(self.mask.all())

    def widen(self, field: torch.Tensor) -> torch.Tensor:
        """A field [2, n₁, n₂] of the box in the wider box, zero around it."""
        return torch.nn.functional.pad(field, 4 * [self.reach])

    def inner(self, field: torch.Tensor) -> torch.Tensor:
        """The box's part of a field on the torus whose corner is the wider box's; masked."""
        (n, m), R = self.mask.shape, self.reach
        return field[:, R : R + n, R : R + m] * self.mask

    def gather_free(self, values: torch.Tensor) -> torch.Tensor:
        """Vectors of the interior nodes [I, 2] as a field of the box."""
        field = torch.zeros(2, self.mask.numel(), dtype=values.dtype, device=values.device)
        field[:, self.free] = (values @ self.axes).T
        return field.reshape(2, *self.mask.shape)

    def scatter_free(self, field: torch.Tensor) -> torch.Tensor:
        """A field of the box as vectors of the interior nodes [I, 2]."""
        return field.reshape(2, -1)[:, self.free].T @ self.axes.T

    def gather_near(self, values: torch.Tensor) -> torch.Tensor:
        """Vectors of all nodes [N, 2] as a field of the wider box; zero where there is no node."""
        n, m = self.wide
        field = torch.zeros(2, n * m, dtype=values.dtype, device=values.device)
        field[:, self.place] = (values[self.near] @ self.axes).T
        return field.reshape(2, n, m)

    def scatter_near(self, field: torch.Tensor, nodes: int) -> torch.Tensor:
        """A field of the wider box as vectors of all nodes [nodes, 2]; zero at those outside it."""
        n, m = self.wide
        values = torch.zeros(nodes, 2, dtype=field.dtype, device=field.device)
        values[self.near] = field[:, :n, :m].reshape(2, -1)[:, self.place].T @ self.axes.T
        return values


def domain(
    points: PointsLike,
    horizon: float,
    *,
    bond_based: bool = False,
    degree: int = DEGREE,
    device: torch.device,
) -> Domain:
    """Lay the nodes of a lattice out, without a table of their neighbours.

    Raises InputError as families_of does, for the same point sets, and for three dimensions.
    """
    if points.x.shape[1] != 2:
        raise InputError("method: expected lu in three dimensions, for this one is for sheets")
    classes = bond_classes(points.spacing, horizon, degree=degree)
    grid, axes = lattice_steps(points)
    family = int(np.abs(classes.steps).max())
    reach = family if bond_based else 2 * family
    inside = grid[points.interior]
    corner = inside.min(axis=0)
    n, m = inside.max(axis=0) - corner + 1
    grid = grid - corner + reach
    wide = (int(n) + 2 * reach, int(m) + 2 * reach)
    near = np.flatnonzero(((grid >= 0) & (grid < wide)).all(axis=1))
    place = grid[near] @ (wide[1], 1)
    there, asked = np.zeros(wide, bool), np.zeros(wide, bool)
    there.ravel()[place] = True
    asked.ravel()[place[points.interior[near]]] = True
    if np.count_nonzero(there) < len(near) or (_felt(asked, classes, bond_based) & ~there).any():
        families_of(points, horizon, bond_based=bond_based, degree=degree)  # says what is wrong
        raise AssertionError("families_of accepts nodes that are doubled or lack their collar")
    shape = [scipy.fft.next_fast_len(size, real=True) for size in wide]

    def indices(values: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(values.astype(np.int64)).to(device)

    return Domain(
        classes=classes,
        axes=torch.from_numpy(axes).to(device),
        reach=reach,
        mask=torch.from_numpy(asked[reach:-reach, reach:-reach].copy()).to(device),
        interior=indices(np.flatnonzero(points.interior)),
        collar=torch.from_numpy(~asked).to(device),
        free=indices((inside - corner) @ (m, 1)),
        near=indices(near),
        place=indices(place),
        torus=Torus((shape[0], shape[1]), device),
    )


def _felt(asked: np.ndarray, classes: BondClasses, bond_based: bool) -> np.ndarray:
    """Nodes whose displacement a force at the nodes asked for reads; by counting, with FFT."""
    reach = int(np.abs(classes.steps).max())
    shape = [scipy.fft.next_fast_len(size + 2 * reach, real=True) for size in asked.shape]
    ball = np.zeros(shape, np.float32)
    ball[tuple(classes.steps.T)] = ball[0, 0] = 1  # negative steps wrap around
    wave = scipy.fft.rfft2(ball)
    for _ in range(1 if bond_based else 2):
        count = scipy.fft.irfft2(wave * scipy.fft.rfft2(asked.astype(np.float32), s=shape), s=shape)
        asked = count[: asked.shape[0], : asked.shape[1]] > 0.5
    return asked
