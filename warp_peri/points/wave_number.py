"""The shortest waves that a set of loads holds."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from warp_peri.points.arrays import checked
from warp_peri.points.samples import Samples

WAVE_VECTOR = "wave_vector"
"""Per-sample array of a set whose loads are single waves: k [1/Å], shape [S, 2]."""


def largest_wave_number(points: Samples) -> float | None:
    """Largest |k| [1/Å] of the samples' loads; None on scattered points or without loads.

    Of loads at wave vectors their own; of others the root mean square of |k| over the spectrum of
    b, from differences of neighbouring nodes (theory.md, M1).
    """
    if WAVE_VECTOR in points.arrays:
        k = checked(WAVE_VECTOR, points.arrays[WAVE_VECTOR])
        return float(np.linalg.norm(k, axis=-1).max(initial=0.0)) or None
    h = points.spacing
    if h == 0 or points.b is None:
        return None
    r, near = cKDTree(points.x).query(points.x, k=min(5, len(points.x)))
    whole = points.interior & (r <= 1.1 * h).all(axis=1) & (near.shape[1] == 5)
    near = near[whole, 1:]
    largest = 0.0
    for b in points.b:
        size = (b[whole] ** 2).sum()
        if size > 0:
            s = ((b[near] - b[whole, None]) ** 2).sum() / (2 * h**2 * size)
            # of all directions on average s = |k|² − |k|⁴ h²/16
            largest = max(largest, (1 - np.sqrt(max(1 - s * h**2 / 4, 0.0))) * 8 / h**2)
    return float(np.sqrt(largest)) or None
