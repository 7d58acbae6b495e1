"""The tangent of a hyperelastic solid as a sparse matrix, for direct solves of small bodies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
import warp as wp
from scipy.linalg import lapack

from warp_peri.kernels.hyperelastic.rows import tangent_rows
from warp_peri.launch import ints, launch, zeros
from warp_peri.operator.hyperelastic import HyperelasticOperator
from warp_peri.stability.inertia import definite_factors

DENSE = 1200
"""Unknowns up to which a tangent is eliminated as a full matrix: it has hundreds in each row."""


@dataclass(frozen=True, eq=False)
class TangentPattern:
    """What the tangent is made of, apart from the field: build once for an operator.

    Attributes:
        op: the operator.
        centre: place of a node in the window of its row.
        width: number of nodes in a window.
        arrays: interior nodes, shifts of the bonds in the window, bonds of the short strain, as
            the kernel reads them.
        taken: entries of the windows that are entries of the matrix, row by row.
        columns: their columns.
        ends: where rows begin among them.
    """

    op: HyperelasticOperator
    centre: int
    width: int
    arrays: tuple[Any, Any, Any]
    taken: np.ndarray
    columns: np.ndarray
    ends: np.ndarray

    @classmethod
    def of(cls, op: HyperelasticOperator) -> TangentPattern:
        """The pattern of an operator."""
        steps, interior = op.bonds.steps, op.interior
        reach = 2 * int(np.abs(steps).max())
        side = 2 * reach + 1
        shift = steps @ np.array([side, 1])
        centre = reach * side + reach
        near = np.flatnonzero((op.weight[:, 3:] != 0).any(axis=1))
        near = np.concatenate([near, near + op.bonds.classes])
        place = np.rint((op.points.x - op.points.x.min(axis=0)) / op.bonds.spacing).astype(int)
        number = np.full(place.max(axis=0) + 1 + 2 * reach, -1)
        number[tuple((place[interior] + reach).T)] = np.arange(len(interior))
        family = np.concatenate([steps, [[0, 0]]])
        offsets = np.unique((family[:, None] + family).reshape(-1, 2), axis=0)
        far = np.stack([number[tuple((place[interior] + reach + o).T)] for o in offsets], axis=1)
        row, which = np.nonzero(far >= 0)
        window = centre + offsets[which] @ np.array([side, 1])
        two = np.arange(2)
        # entries by row node, axis, column node, axis
        taken = 4 * (row * side**2 + window)[:, None, None] + 2 * two[:, None] + two
        columns = 2 * far[row, which][:, None, None] + two + 0 * two[:, None]
        rows = 2 * row[:, None, None] + two[:, None] + 0 * two
        order = np.lexsort((columns.ravel(), rows.ravel()))
        ends = np.searchsorted(rows.ravel()[order], np.arange(2 * len(interior) + 1))
        arrays = ints(interior), ints(shift), ints(near)
        return cls(
            op, centre, side**2, arrays, taken.ravel()[order],
            columns.ravel()[order].astype(np.int32), ends.astype(np.int32),
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
        rows, shift, near = self.arrays
        pair = wp.types.matrix((2, 2), op.scalar)
        K = zeros(len(op.interior), self.width, dtype=pair)
        inputs = [op.lattice, terms, rows, shift, near, self.centre, field, E, G, H]
        launch(tangent_rows(op.scalar), len(op.interior), inputs, [K])
        entries: np.ndarray = K.numpy().reshape(-1)[self.taken]
        return entries


class FullFactors:
    """Cholesky's factors of a full matrix."""

    def __init__(self, factor: np.ndarray) -> None:
        self.factor = factor

    def solve(self, y: np.ndarray) -> np.ndarray:
        """K⁻¹ y."""
        x: np.ndarray = lapack.dpotrs(self.factor, y, lower=1)[0].reshape(y.shape)
        return x


def positive_factors(K: sp.csc_matrix) -> Any:
    """Factors with a `solve` of a symmetric matrix where it is positive definite, else None."""
    if K.shape[0] > DENSE:
        return definite_factors(K)
    factor, fault = lapack.dpotrf(K.toarray(order="F"), lower=1, overwrite_a=1, clean=0)
    return None if fault else FullFactors(factor)
