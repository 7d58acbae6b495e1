"""The five-point Laplacian on the interior of a lattice, for lifts and preconditioners."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from warp_peri.tissue.operator import HyperelasticOperator


def laplacian(op: HyperelasticOperator) -> tuple[sp.csr_matrix, sp.csr_matrix]:
    """The five-point Laplacian between interior nodes, and from the collar (columns: all nodes)."""
    steps = op.bonds.steps
    near = np.flatnonzero(np.abs(steps).sum(axis=1) == 1)
    far = op.bonds.neighbour[op.interior][:, near]
    number = np.full(len(op.points.x), -1)
    number[op.interior] = np.arange(len(op.interior))
    rows = np.repeat(np.arange(len(op.interior)), len(near))
    square = op.bonds.spacing**2
    whole = sp.csr_matrix(
        (np.full(len(rows), -1 / square), (rows, far.ravel())),
        shape=(len(op.interior), len(op.points.x)),
    )
    inside = op.points.interior
    own = whole[:, inside] + sp.eye(len(op.interior)) * (len(near) / square)
    collar = whole @ sp.diags((~inside).astype(float))
    return own.tocsr(), collar.tocsr()
