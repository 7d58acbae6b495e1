"""L u while the model stays as it is: what every bond does is kept in a table."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from warp_peri.kernels.lps import force as lps
from warp_peri.kernels.lps.tables import tables
from warp_peri.launch import empty, launch_slices
from warp_peri.models.solid import Solid
from warp_peri.operator.bonds import Bonds
from warp_peri.operator.launches import influence, surface_shape


class Tabulated:
    """The force of one influence function, or two, as tables of its bonds.

    Args:
        bonds: of any point set, on the processor.

    Call it with u, shape [S, N] of vectors, and a solid of plain numbers: returns L u, shape [S, I]
    of vectors. The tables are made anew whenever α or a coefficient differs from those they were
    made for; λ and μ are no part of them. They take 8 (d + 1) bytes a bond in double precision.
    """

    def __init__(self, bonds: Bonds) -> None:
        self.bonds, self.kernels = bonds, tables(bonds.scalar, bonds.dimension)
        self._made_for: tuple[bytes, ...] | None = None
        self._table: Any = None
        self._dilatational: tuple[wp.array[Any], wp.array[Any]] | None = None

    def __call__(self, u: wp.array[Any], solid: Solid) -> wp.array[Any]:
        bonds, samples = self.bonds, len(u)
        lam, mu, alpha, *coefficients = (
            bonds.floats(np.atleast_1d(np.asarray(value, float))) for value in solid.values()
        )
        key = tuple(array.numpy().tobytes() for array in (alpha, *coefficients))
        if key != self._made_for:
            self._make(alpha, coefficients)
            self._made_for = key
        theta = bonds.zeros(samples, bonds.nodes)
        if not bonds.bond_based:
            self._launch(self.kernels.dilatation, bonds.whole, (u,), theta)
            if self._dilatational is not None:
                kernel = lps.sweeps(bonds.scalar, bonds.dimension).surface_dilatation
                inputs = (bonds.cut, bonds.arrays, *self._dilatational, u)
                launch_slices(kernel, len(bonds.cut), inputs, (theta,), samples=samples)
        Lu = empty(samples, len(bonds.rows), dtype=bonds.vec, device=bonds.device)
        self._launch(self.kernels.force, bonds.rows, (lam, mu, u, theta), Lu)
        return Lu

    def _launch(
        self, kernel: Any, nodes: wp.array[Any], inputs: tuple[Any, ...], output: wp.array[Any]
    ) -> None:
        inputs = (nodes, self._table, *inputs)
        launch_slices(kernel, len(nodes), inputs, (output,), samples=len(output))

    def _make(self, alpha: wp.array[Any], coefficients: list[wp.array[Any]]) -> None:
        bonds, families = self.bonds, self.bonds.families
        made = [influence(bonds, alpha, D) for D in coefficients]
        bonds.forget()  # what the tables are made of is not read again
        (kw, m), (kd, md) = made[0], made[-1]
        table = self.kernels.Table()
        broken = families.neighbour < 0
        table.row, table.ends = bonds.arrays.row, bonds.arrays.neighbour
        if broken.any():
            owner = np.repeat(np.arange(bonds.nodes), np.diff(families.row))
            table.ends = bonds.ints(np.where(broken, owner, families.neighbour))
        edges = len(families.neighbour)
        table.vectors, table.numbers = bonds.zeros(edges, dtype=bonds.vec), bonds.zeros(edges)
        inputs = (bonds.full, bonds.arrays, kw, m, kd, md)
        outputs = (table.vectors, table.numbers)
        launch_slices(self.kernels.filled, len(bonds.full), inputs, outputs)
        self._table = table
        self._dilatational = (kd, surface_shape(bonds, kd)) if len(bonds.cut) else None
