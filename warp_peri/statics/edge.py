"""Nodes near the edge of a body, solved for exactly beside a filter (docs/solves.md).

Far from the edge the inverse symbol on a torus is the inverse, whatever λ is. At the edge it cuts
off a displacement whose dilatation costs λ. So the nodes within one reach of the edge are
eliminated by LU, and conjugate gradients run on the rest.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.ndimage import distance_transform_cdt

from warp_peri.core.grid import Grid
from warp_peri.core.stencil import Stencil
from warp_peri.stability.inertia import symmetric_factors


class Edge:
    """z = E A_ee⁻¹ Eᵗ r on the nodes e within a reach of the edge, zero elsewhere."""

    def __init__(self, grid: Grid, stencil: Stencil) -> None:
        mask = grid.mask()
        depth = distance_transform_cdt(np.pad(mask, 1), "chessboard")[(slice(1, -1),) * mask.ndim]
        self.near = mask & (depth <= grid.reach)
        self.factors = symmetric_factors(block(stencil, self.near))

    def __call__(self, r: np.ndarray) -> np.ndarray:
        """The displacement [d, *shape] that leaves no residual on the edge."""
        return solved(self.factors, self.near, r)


def solved(factors: Any, mask: np.ndarray, r: np.ndarray) -> np.ndarray:
    """The planes [d, *shape] on a mask that factors of its block give for r, zero elsewhere."""
    z = np.zeros_like(r)
    z[:, mask] = factors.solve(np.ascontiguousarray(r[:, mask].T).ravel()).reshape(-1, len(r)).T
    return z


def block(stencil: Stencil, mask: np.ndarray) -> sp.csc_array:
    """The operator between the nodes of a mask, shape [d n, d n]."""
    d, here = stencil.dimension, np.argwhere(mask)
    number = np.full(mask.shape, -1)
    number[mask] = np.arange(len(here))
    rows, columns = [np.arange(len(here))], [np.arange(len(here))]
    values = [np.broadcast_to(2 * stencil.tensors.sum(axis=0), (len(here), d, d))]
    both = np.concatenate([stencil.steps, -stencil.steps])
    for step, C in zip(both, np.concatenate([stencil.tensors] * 2)):
        there = here + step
        inside = np.flatnonzero(((there >= 0) & (there < mask.shape)).all(axis=1))
        other = number[tuple(there[inside].T)]
        rows.append(inside[other >= 0])
        columns.append(other[other >= 0])
        values.append(np.broadcast_to(-C, (len(rows[-1]), d, d)))
    row, column, value = map(np.concatenate, (rows, columns, values))
    i, j = np.indices((d, d)).reshape(2, -1)
    at = ((d * row[:, None] + i).ravel(), (d * column[:, None] + j).ravel())
    return sp.csc_array((value.ravel(), at), shape=2 * (d * len(here),))
