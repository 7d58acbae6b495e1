"""The direction of a material on points, for laws that depend on it."""

from __future__ import annotations

import warnings
from weakref import WeakValueDictionary

import numpy as np

from warp_peri.points.samples import PointsLike

_said: WeakValueDictionary[int, np.ndarray] = WeakValueDictionary()
"""Positions that a direction was assumed on; gone with the points."""


def unsaid(points: PointsLike) -> bool:
    """Whether nothing was said of the direction on these positions before; now it is."""
    x = points.x
    if _said.get(id(x)) is x:
        return False
    _said[id(x)] = x
    return True


def axis_of(points: PointsLike) -> float:
    """Angle [rad] from the x axis of points to that of the material.

    Where none is stated it is taken as 0, with a warning, once for these points.
    """
    if points.axis is None:
        if unsaid(points):
            warnings.warn(
                "axis: the law depends on direction, and the points do not state that of the "
                "material: taken along x; Points(…, axis=degrees) states it",
                stacklevel=4,
            )
        return 0.0
    return float(np.deg2rad(points.axis))
