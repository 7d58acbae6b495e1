"""How large a horizon the collar of a lattice carries."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt

from warp_peri.points.families import HORIZON_TOLERANCE
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.samples import PointsLike, nodes_of


def carried_horizon(points: PointsLike) -> float:
    """Horizon [Å] below which every interior node of a lattice has its families out to 2δ.

    Half the distance from the interior to the nearest place of the lattice without a node; on a
    periodic sheet a quarter of the smaller period.
    """
    h = points.spacing
    if points.box is not None:
        return float(min(points.box)) / 4
    grid, _ = lattice_steps(nodes_of(points))
    there = np.zeros(grid.max(axis=0) + 3, bool)
    there[tuple((grid + 1).T)] = True
    clear = distance_transform_edt(there)[tuple((grid[points.interior] + 1).T)]
    return float(clear.min()) * h / 2 * (1 - 2 * HORIZON_TOLERANCE)
