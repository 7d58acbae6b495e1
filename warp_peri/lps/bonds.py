"""The bonds of a point set on a device: built once, and handed to whatever launches kernels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp

from warp_peri.errors import InputError
from warp_peri.kernels.bonds import bonds
from warp_peri.launch import DEVICE, floats, ints, known_device, zeros
from warp_peri.lps.rows import Rows, rows_of
from warp_peri.points.families import Families, families_of
from warp_peri.points.quadrature import DEGREE
from warp_peri.points.samples import PointsLike

BLOCKS = 8
"""How many there are."""


@dataclass(frozen=True)
class Blocks:
    """Parts of the nodes with complete families, one after another.

    Attributes:
        ends: first node of each block, and the end of the last, shape [BLOCKS + 1].
        bonds: first bond of each and the end, on scattered points.
        spans: what the kernel reads of each: the bond that its sums begin with, and its nodes.
    """

    ends: list[int]
    bonds: list[tuple[int, int]]
    spans: wp.array[Any]


def blocks_of(families: Families, full: np.ndarray, device: str) -> Blocks:
    """Those of the nodes `full`; the sums of a lattice lie in one array, block after block."""
    ends = [len(full) * n // BLOCKS for n in range(BLOCKS + 1)]
    if families.lattice is not None:
        bounds = [-len(families.pattern) * n for n in range(BLOCKS + 1)]
    else:
        bounds = [int(families.row[full[min(end, len(full) - 1)]]) for end in ends]
        bounds[-1] = int(families.row[-1])
    table = np.stack([bounds[:-1], ends[:-1], ends[1:]], axis=1).astype(np.int32)
    spans: Any = wp.array(table, dtype=wp.vec3i, device=device)
    return Blocks(ends, list(pairwise(bounds)), spans)


PRECISIONS = {"float64": wp.float64, "float32": wp.float32}


class Bonds:
    """Families of a point set and what kernels read of them, in one precision.

    Args:
        points: a lattice, or scattered points (spacing 0). Bonds to nodes outside are broken, and
            the dilatation of nodes that had such bonds is corrected (theory.md, 40–41).
        horizon: δ [Å].
        bond_based: λ = μ without a dilatation (theory.md, 42).
        quadrature_degree: of the polynomials that the weights are exact for.
        precision: "float64" or "float32".
        device: where the arrays lie and the kernels run, as Warp names it: "cpu", "cuda:0". The
            families are found on the processor.

    Attributes:
        families: families of all nodes.
        dimension: 2 or 3.
        scalar, vec, mat: types of numbers, vectors and matrices in this precision.
        arrays: what leads every kernel from a node to its bonds, see kernels/bonds.py.
        rows: interior nodes, where forces are evaluated, shape [I].
        full: nodes within δ of them, where dilatations are needed; `cut` are those of them with
            broken bonds, `whole` the others.
        r, weight: length [Å] and quadrature weight [Å^d] of each bond class, shape [C].
        reverse: number of the bond from j back to i; not read on lattices, shape [E].
        kept: tables that launches keep from one evaluation to the next.

    Raises InputError for what families_of refuses, another precision, and an unknown device.
    """

    def __init__(
        self,
        points: PointsLike,
        horizon: float,
        *,
        bond_based: bool = False,
        quadrature_degree: int = DEGREE,
        precision: str = "float64",
        device: str = DEVICE,
    ) -> None:
        if precision not in PRECISIONS:
            raise InputError(f"precision: expected one of {list(PRECISIONS)}, got {precision!r}")
        self.scalar = PRECISIONS[precision]
        self.device = known_device(device)
        self.dimension = points.x.shape[1]
        types = bonds(self.scalar, self.dimension)
        self.vec, self.mat = types.vec, types.mat
        self.families = families = families_of(
            points, horizon, bond_based=bond_based, degree=quadrature_degree
        )
        self.horizon, self.bond_based = float(horizon), bond_based
        self.rows, self.whole = self.ints(families.rows), self.ints(families.whole)
        self.cut = self.ints(families.cut)
        self.full = self.ints(np.sort(np.concatenate([families.whole, families.cut])))
        self.r, self.weight = self.floats(families.r), self.floats(families.weight)
        self.reverse = self.ints(families.reverse)
        self.arrays = self._arrays(types, points.x, points.box)
        self._places = (np.array(points.x) if self.lattice else points.x, points.box)
        self.kept: dict[tuple[bytes, bytes], tuple[wp.array[Any], wp.array[Any]]] = {}

    def _arrays(self, types: Any, x: np.ndarray, box: tuple[float, ...] | None) -> Any:
        """The kernels' struct; of what only the other kind of point set has, one idle entry."""
        families, lattice, d = self.families, self.families.lattice, self.dimension
        bond_class = np.zeros(1) if lattice is None else lattice.bond_class
        pattern = np.ones((1, d)) if lattice is None else families.pattern
        inverse_square = 1 / (pattern**2).sum(axis=1, keepdims=True)
        periods = 2 * d * (0.0,) if box is None else (*box, *(1 / side for side in box))
        arrays = types.BondArrays()
        arrays.lattice = int(self.lattice)
        arrays.row, arrays.neighbour = self.ints(families.row), self.ints(families.neighbour)
        arrays.bond_class = self.ints(bond_class)
        arrays.pattern = floats(np.hstack([pattern, inverse_square]), types.bond, self.device)
        arrays.x = floats(x if lattice is None else np.zeros((1, d)), self.vec, self.device)
        arrays.box = types.box(*(self.scalar(value) for value in periods))
        return arrays

    @property
    def lattice(self) -> bool:
        """Whether the points are a lattice, whose nodes share one pattern of bonds."""
        return self.families.lattice is not None

    @property
    def nodes(self) -> int:
        """Number of nodes N."""
        return len(self.families.row) - 1

    @cached_property
    def laid_out(self) -> Rows | None:
        """A square lattice without broken bonds as rows of a rectangle, for the processor's sweeps
        that take many nodes at a time; None for what else there is.
        """
        if not self.lattice or self.dimension != 2 or self.device != DEVICE or self.bond_based:
            return None
        return rows_of(self.families, *self._places, self.scalar)

    @cached_property
    def blocks(self) -> Blocks:
        """Parts of the nodes `full` in which gradients are summed."""
        return blocks_of(self.families, self.full.numpy(), self.device)

    def floats(self, values: np.ndarray) -> wp.array[Any]:
        """A Warp array in this precision, where the bonds are."""
        return floats(values, self.scalar, self.device)

    def ints(self, values: np.ndarray) -> wp.array[Any]:
        """A Warp array of int32, where the bonds are."""
        return ints(values, self.device)

    def zeros(self, *shape: int, dtype: Any = None, gradient: bool = False) -> wp.array[Any]:
        """A Warp array of zeros, where the bonds are."""
        dtype = dtype or self.scalar
        return zeros(*shape, dtype=dtype, gradient=gradient, device=self.device)

    def forget(self) -> None:
        """Drop what was kept of the last model, so that the next evaluation computes it anew."""
        self.kept.clear()
