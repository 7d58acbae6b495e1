"""Nodes near the edge of a domain, solved for exactly beside the filter (docs/solves.md).

Far from the edge the inverse symbol on a torus is the inverse, whatever λ is. At the edge it cuts
off a displacement whose dilatation costs λ. So the nodes of a strip along the edge are eliminated
by LU, and conjugate gradients run on the rest.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import torch
from scipy.ndimage import distance_transform_cdt

from warp_peri.stability.inertia import symmetric_factors
from warp_peri.statics.domain import Domain


class Strip:
    """z = E A_ss⁻¹ Eᵗ r on the strip s of a domain.

    Args:
        domain: where the nodes lie.
        A: the stencil of the model [TPa/Å²], shape [2, 2, 2R + 1, 2R + 1], on the processor.
        width: of the strip, in nodes.
    """

    def __init__(self, domain: Domain, A: torch.Tensor, width: int) -> None:
        mask = domain.mask.cpu().numpy()
        depth = distance_transform_cdt(np.pad(mask, 1), "chessboard")[1:-1, 1:-1]
        near = mask & (depth <= width)
        self.place = torch.from_numpy(np.flatnonzero(near)).to(domain.mask.device)
        self.factors = symmetric_factors(block(A.numpy(), near))

    def __call__(self, r: torch.Tensor) -> torch.Tensor:
        """The displacement [2, n₁, n₂] that leaves no residual on the strip, zero elsewhere."""
        right = r.flatten(1)[:, self.place].T.cpu().numpy()
        answer = self.factors.solve(np.ascontiguousarray(right).ravel()).reshape(-1, 2)
        z = torch.zeros_like(r)
        z.flatten(1)[:, self.place] = torch.from_numpy(answer.T.copy()).to(r)
        return z


def block(A: np.ndarray, mask: np.ndarray) -> sp.csc_array:
    """The operator of a stencil on the nodes of a mask, shape [2 n, 2 n]."""
    number = np.full(mask.shape, -1)
    number[mask] = np.arange(np.count_nonzero(mask))
    nodes, reach = np.argwhere(mask), A.shape[-1] // 2
    rows, columns, values = [], [], []
    for step in np.argwhere(A.any(axis=(0, 1))):
        there = nodes + step - reach
        inside = ((there >= 0) & (there < mask.shape)).all(axis=1)
        row = np.flatnonzero(inside)
        column = number[tuple(there[row].T)]
        row, column = row[column >= 0], column[column >= 0]
        for a in (0, 1):
            for b in (0, 1):
                rows.append(2 * row + a)
                columns.append(2 * column + b)
                values.append(np.full(len(row), A[a, b, step[0], step[1]]))
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return sp.csc_array(entries, shape=2 * (2 * len(nodes),))
