"""Fields in series along bonds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

SAMPLES = 32
"""Places along a bond at which a field is read."""


def mean_inverse(values: Callable[[float], np.ndarray]) -> np.ndarray:
    """Mean along bonds of 1/field, whose values at a share of each bond's length are given."""
    places = (np.arange(SAMPLES) + 0.5) / SAMPLES
    return np.asarray(sum(1 / values(float(place)) for place in places) / SAMPLES)
