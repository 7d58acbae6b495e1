"""The range of strains in which a linear model was learned, and a word beyond it."""

from __future__ import annotations

import warnings
from collections.abc import Callable

from warp_peri.lps.model import Model

BEYOND = 2.0
"""Strains above this many times those of the training data are worth a warning."""


def warn_beyond(model: Model, strain: Callable[[], float]) -> None:
    """Warn when a solution is strained far beyond the data that the model was trained on.

    Args:
        model: that may know the strain of these data.
        strain: the solution's largest, worked out where it is needed.
    """
    if model.trained_strain is None:
        return
    largest = strain()
    if largest > BEYOND * model.trained_strain:
        warnings.warn(
            f"strain: the solution reaches {100 * largest:.2g} %, the training data "
            f"{100 * model.trained_strain:.2g} %: the model is linear and knows nothing of what "
            "comes beyond",
            stacklevel=3,
        )
