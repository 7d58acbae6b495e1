"""The direction of a material on points, for laws that depend on it."""

from __future__ import annotations

import warnings

import numpy as np

from warp_peri.points.samples import PointsLike

_said: list[str] = []


def axis_of(points: PointsLike) -> float:
    """Angle [rad] from the x axis of points to that of the material.

    Where none is stated it is taken as 0, with a warning, once.
    """
    if points.axis is None:
        if not _said:
            _said.append("axis")
            warnings.warn(
                "axis: the law depends on direction, and the points do not state that of the "
                "material: taken along x; Points(…, axis=degrees) states it",
                stacklevel=4,
            )
        return 0.0
    return float(np.deg2rad(points.axis))
