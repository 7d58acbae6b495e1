"""How far a sheet is stretched, and a word beyond the stretch that its material was learned at."""

from __future__ import annotations

import warnings

import numpy as np

from warp_peri.tissue.operator import HyperelasticOperator
from warp_peri.tissue.solid import HyperelasticSolid

BEYOND = 1.1
"""Stretches less one above this many times those of the training data are worth a warning."""


def largest_stretch(op: HyperelasticOperator, u: np.ndarray) -> float:
    """Largest principal stretch of the nodal strain in fields u [length], shape [..., N, 2]."""
    E = op.strain(u).reshape(-1, 3)
    mean, half = (E[:, 0] + E[:, 1]) / 2, np.hypot((E[:, 0] - E[:, 1]) / 2, E[:, 2] / 2)
    return float(np.sqrt(1 + 2 * (mean + half).max()))


def warn_beyond(solid: HyperelasticSolid, op: HyperelasticOperator, u: np.ndarray) -> None:
    """Warn when fields are stretched beyond the data that a solid was learned from."""
    if solid.stretch is None:
        return
    largest = largest_stretch(op, u)
    if largest - 1 > BEYOND * (solid.stretch - 1):
        warnings.warn(
            f"stretch: the fields reach {largest:.4g}, the training data {solid.stretch:.4g}: "
            "nothing is known of the material beyond",
            stacklevel=3,
        )
