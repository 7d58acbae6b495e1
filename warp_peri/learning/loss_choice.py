"""Which loss a fit takes, by what the data say about their noise."""

from __future__ import annotations

import numpy as np

from warp_peri.errors import InputError
from warp_peri.learning import LOSSES
from warp_peri.learning.response import products
from warp_peri.learning.result import LossChoice
from warp_peri.learning.training_data import TrainingData
from warp_peri.lps.model import Model
from warp_peri.points.samples import WAVE_VECTOR
from warp_peri.regression.coordinates import Parameters
from warp_peri.regression.optimum import constrained_optimum

SMALL_SHARE = 0.01
"""A residual loss is taken as it is when noise is less than this of its squares."""


def choose_loss(
    asked: str, data: TrainingData, start: Parameters, *, responds: bool = True
) -> LossChoice:
    """The loss that was asked for, or for "auto" the one that the noise calls for.

    Args:
        asked: one of LOSSES.
        data: training data, with what is known of their noise.
        start: where the optimum of the residual is looked for from.
        responds: whether the method can take the output-error loss.

    Raises InputError for a loss that these data or the method cannot have.
    """
    if asked not in LOSSES:
        raise InputError(f"loss: expected one of {', '.join(LOSSES)}, got {asked!r}")
    if asked == "corrected" and not data.added:
        raise InputError("loss: 'corrected' needs fields of noise")
    if asked == "output" and not responds:
        raise InputError("loss: 'output' is not for the two-stage method")
    if not data.grids and asked in ("corrected", "output"):
        raise InputError(f"loss: scattered points have 'residual' only, got {asked!r}")
    if asked != "auto":
        return LossChoice(asked, "asked for")
    if not data.added:
        return LossChoice("residual", "no fields of noise were given")
    share = noise_share(data, start)
    why = f"noise is {100 * share:.3g} % of the squared residual at its optimum"
    if share < SMALL_SHARE:
        return LossChoice("residual", why)
    if responds and all(WAVE_VECTOR in points.arrays for points in data.sets):
        return LossChoice("output", f"{why}; loads are single waves")
    return LossChoice("corrected", why)


def noise_share(data: TrainingData, start: Parameters) -> float:
    """Part of the squared residual that is noise, at the optimum of the residual."""
    optimum = constrained_optimum(data.grids, start, data.conditions).parameters
    model = Model(optimum.lam, optimum.mu, optimum.alpha, optimum.D, data.horizon)
    c = [products(model, grid.classes) for grid in data.grids]
    whole = sum(np.sum((grid.R @ values) ** 2) for grid, values in zip(data.grids, c))
    return float(sum(np.sum((R @ values) ** 2) for R, values in zip(data.added, c)) / whole)
