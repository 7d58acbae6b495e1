"""The force state between its exact values on a grid of dilatation and extension.

On a lattice ω and |ξ| take one value for a class of bonds, so that the force state of a class is a
function of two numbers. Its values at the corners of the cells that the bonds of some samples fall
into, a few thousand, stand for those of a few hundred thousand bonds; between them it is bilinear.
"""

from __future__ import annotations

import numpy as np
import torch

from warp_peri.neural.bonds import Gather, Scatter
from warp_peri.neural.placed import Placed

CELLS = 16
"""Of the grid, along the range of the dilatation and that of the extension."""
MARGIN = 1 + 1e-4
"""Grids are so much larger than the range of the values."""


def interpolated_force(
    placed: Placed,
    u: torch.Tensor,
    *,
    cells: int = CELLS,
    offset: tuple[float, float] = (0.5, 0.5),
) -> torch.Tensor:
    """Forces on the interior [stress/length], shape [S, I, 2], for u of shape [S, N, 2].

    Args:
        placed: the operator on a lattice.
        u: displacements [length].
        cells: of the grid along each axis, not counting one more.
        offset: share of a cell by which the grid begins before the range; drawn anew in every step
            of a training, corners stand nowhere twice.

    Differentiable in the material's numbers; the error falls with the square of 1/cells.
    """
    bonds, material = placed.bonds, placed.material
    omega, share, r = placed.shares(u.dtype)
    e, theta = Gather.apply(u, share, bonds)  # type: ignore[no-untyped-call]
    kinds = np.arange(len(bonds.xi)) if material.anisotropic else bonds.kind
    first = torch.as_tensor(np.unique(kinds, return_index=True)[1])
    kind = torch.as_tensor(kinds, dtype=torch.int64)
    side = cells + 2
    low, step = _range(theta.detach().abs().max(), cells, offset[0])
    ends = []
    for nodes, places in ((bonds.own, bonds.forward), (bonds.other, bonds.backward)):
        ends.append((kind[places], (theta[:, nodes] - low) / step))
    largest, most = e.detach().abs().amax(dim=0), e.new_zeros(len(first))
    for k, _ in ends:
        most.scatter_reduce_(0, k, largest, "amax")
    least, rise = _range(most, cells, offset[1])
    corners = []
    for k, x in ends:
        y = (e - least[k]) / rise[k]
        column, row = (part.detach().floor().clamp(0, side - 2) for part in (x, y))
        corners.append((((k * side + row.long()) * side + column.long()), x - column, y - row))
    wanted = torch.zeros(len(first) * side * side, dtype=torch.bool)
    beside = (0, 1, side, side + 1)
    for corner, _, _ in corners:
        for shift in beside:
            wanted[corner + shift] = True
    place = wanted.nonzero()[:, 0]
    k, row, column = place // side**2, place // side % side, place % side
    state = material.force_state(
        omega[first][k], low + column * step, least[k] + row * rise[k], r[first][k]
    )
    table = state.new_zeros(len(wanted)).index_copy(0, place, state)
    tension = torch.zeros_like(e)
    for corner, x, y in corners:
        a, b, c, d = (table[corner + shift] for shift in beside)
        tension = tension + (1 - y) * ((1 - x) * a + x * b) + y * ((1 - x) * c + x * d)
    force: torch.Tensor = Scatter.apply(u, tension, bonds)  # type: ignore[no-untyped-call]
    return force


def _range(most: torch.Tensor, cells: int, offset: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Where a grid over values from −most to most begins, and its step."""
    most = most * MARGIN + torch.finfo(most.dtype).tiny
    step = 2 * most / cells
    return -most - offset * step, step
