"""The range of strains in which a linear model was learned, and a word beyond it."""

from __future__ import annotations

import warnings

import numpy as np

from warp_peri.models.lps import Model
from warp_peri.points.samples import PointsLike
from warp_peri.points.strain import largest_strain

BEYOND = 2.0
"""Strains above this many times those of the training data are worth a warning."""


def warn_beyond(model: Model, points: PointsLike, u: np.ndarray) -> None:
    """Warn when a solution is strained far beyond the data that the model was trained on."""
    if model.trained_strain is None:
        return
    strain = largest_strain(points, u)
    if strain > BEYOND * model.trained_strain:
        warnings.warn(
            f"strain: the solution reaches {100 * strain:.2g} %, the training data "
            f"{100 * model.trained_strain:.2g} %: the model is linear and knows nothing of what "
            "comes beyond",
            stacklevel=3,
        )
