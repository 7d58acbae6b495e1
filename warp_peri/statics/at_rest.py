"""The stencil that a material is at rest, from its tangent along a displacement of one node."""

from __future__ import annotations

from typing import Any

import numpy as np

from warp_peri.core.stencil import Stencil
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.points import Points

NOTHING = 1e-12
"""Relative, of tensors that are rounding."""


def probed(operator: Any) -> Stencil:
    """The stencil at rest, along the axes of the operator's own nodes.

    Of a material whose force at a node depends on what lies within two horizons, and is odd in
    displacement at rest.

    Args:
        operator: a placed material with `material`, `points` and `product(u, v)`.
    """
    nodes, d = operator.points, operator.points.x.shape[1]
    h, axes = nodes.spacing, lattice_steps(nodes)[1]
    reach = 2 * int(operator.material.horizon / h + 1e-6)
    grid = np.indices((4 * reach + 1,) * d).reshape(d, -1).T - 2 * reach
    interior = np.abs(grid).max(axis=1) <= reach
    around = Points(h * grid @ axes.T, interior, h, units=nodes.units, axis=nodes.axis)
    placed = operator.material.on(around)
    middle = int(np.flatnonzero((grid == 0).all(axis=1))[0])
    columns, none = [], np.zeros(grid.shape)
    for axis in range(d):
        v = none.copy()
        v[middle] = axes[:, axis]
        columns.append(-placed.product(none, v) @ axes)
    C, at = np.stack(columns, axis=2), grid[interior]
    C = (C + C[::-1]) / 2  # ξ and −ξ
    C = (C + C.swapaxes(1, 2)) / 2
    first = at @ (2 * reach + 1) ** np.arange(d)[::-1] > 0
    kept = first & (np.abs(C).max(axis=(1, 2)) > NOTHING * np.abs(C).max())
    return Stencil(h, at[kept], C[kept])
