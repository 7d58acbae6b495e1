"""The tangent of a hyperelastic solid as a sparse matrix, for direct solves of small bodies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
import warp as wp

from warp_peri.kernels.hyperelastic.corner_tangent import corner_tangents
from warp_peri.kernels.hyperelastic.rows import Window, tangent_rows
from warp_peri.launch import ints, launch, zeros
from warp_peri.tissue.operator import HyperelasticOperator


@dataclass(frozen=True, eq=False)
class TangentPattern:
    """What the tangent is made of, apart from the field: build once for an operator.

    Attributes:
        op: the operator.
        window: where the nodes around another stand in its row, as the kernel reads it.
        width: number of places in a row.
        rows: interior nodes.
        taken: places that are entries of the matrix, row by row.
        columns: their columns.
        ends: where rows begin among them.
    """

    op: HyperelasticOperator
    window: Any
    width: int
    rows: Any
    taken: np.ndarray
    columns: np.ndarray
    ends: np.ndarray

    @classmethod
    def of(cls, op: HyperelasticOperator) -> TangentPattern:
        """The pattern of an operator."""
        steps, interior, C = op.bonds.steps, op.interior, op.bonds.classes
        near = np.flatnonzero((op.weight[:, 3:] != 0).any(axis=1))
        linked = np.flatnonzero(op.deviation >= 0)
        reach = 2 * int(np.abs(steps).max())
        side = 2 * reach + 1
        stride = np.array([side, 1])
        window: Any = Window()
        window.shift, window.centre = ints(steps @ stride), reach * side + reach
        window.near, window.linked = (ints(np.concatenate([p, p + C])) for p in (near, linked))
        place = op.bonds.grid - op.bonds.grid.min(axis=0)
        number = np.full(place.max(axis=0) + 1 + 2 * reach, -1)
        number[tuple((place[interior] + reach).T)] = np.arange(len(interior))
        offsets = reached(steps, near, np.union1d(near, linked))
        far = np.stack([number[tuple((place[interior] + reach + o).T)] for o in offsets], axis=1)
        row, which = np.nonzero(far >= 0)
        block = row * side**2 + window.centre + offsets[which] @ stride
        axis = np.arange(2)
        taken = 4 * block[:, None, None] + 2 * axis[:, None] + axis
        rows = np.broadcast_to(2 * row[:, None, None] + axis[:, None], taken.shape).ravel()
        columns = np.broadcast_to(2 * far[row, which][:, None, None] + axis, taken.shape).ravel()
        order = np.lexsort((columns, rows))
        ends = np.searchsorted(rows[order], np.arange(2 * len(interior) + 1))
        return cls(
            op, window, side**2, ints(interior), taken.ravel()[order],
            columns[order].astype(np.int32), ends.astype(np.int32),
        )  # fmt: skip

    def matrix(self, u: np.ndarray, c: np.ndarray) -> sp.csc_matrix:
        """K between interior nodes at a field u of shape [N, 2], (H10), shape [2 I, 2 I]."""
        size = len(self.ends) - 1
        # symmetric: rows stand for columns
        return sp.csc_matrix((self._entries(u, c), self.columns, self.ends), shape=(size, size))

    def _entries(self, u: np.ndarray, c: np.ndarray) -> np.ndarray:
        """Entries of the matrix, row by row."""
        op = self.op
        field, terms, E, G, H = op.curved_states(u, c)
        pair = wp.types.matrix((2, 2), op.scalar)
        K = zeros(len(op.interior), self.width, dtype=pair)
        inputs = [op.lattice, terms, self.rows, self.window, field, E, G, H]
        launch(tangent_rows(op.scalar), len(op.interior), inputs, [K])
        if op.dictionary.cornered:
            inputs = [op.lattice, terms, self.rows, self.window, field]
            launch(corner_tangents(op.scalar).rows, len(op.interior), inputs, [K])
        entries: np.ndarray = K.numpy().reshape(-1)[self.taken]
        return entries


def reached(steps: np.ndarray, near: np.ndarray, linked: np.ndarray) -> np.ndarray:
    """Offsets of nodes that share an energy with a node: by two bonds, or by three short ones."""
    C, zero = len(steps) // 2, np.zeros((1, 2), int)
    family = np.concatenate([zero, steps])
    short, link = (np.concatenate([zero, steps[p], steps[p + C]]) for p in (near, linked))
    two = (family[:, None] + family).reshape(-1, 2)
    three = (short[:, None, None] + link[:, None] + short).reshape(-1, 2)
    offsets: np.ndarray = np.unique(np.concatenate([two, three]), axis=0)
    return offsets
