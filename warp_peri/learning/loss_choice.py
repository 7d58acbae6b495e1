"""Which loss a fit takes, by what the data say about their noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warp_peri.errors import InputError
from warp_peri.learning.optimum import constrained_optimum
from warp_peri.learning.options import LOSSES
from warp_peri.learning.parameters import Parameters
from warp_peri.losses.reduced import ReducedLoss
from warp_peri.losses.response import WAVE_VECTOR, products
from warp_peri.models.lps import Model
from warp_peri.points.samples import Samples
from warp_peri.stability.conditions import Conditions

SMALL_SHARE = 0.01
"""A residual loss is taken as it is when noise is less than this of its squares."""


@dataclass(frozen=True)
class LossChoice:
    """A loss and, in words, why it was taken."""

    name: str
    reason: str


def choose_loss(
    asked: str,
    sets: Sequence[Samples],
    grids: Sequence[ReducedLoss],
    noise: Sequence[np.ndarray],
    conditions: Sequence[Conditions],
    horizon: float,
    start: Parameters,
    *,
    responds: bool = True,
) -> LossChoice:
    """The loss that was asked for, or for "auto" the one that the noise calls for.

    Args:
        asked: one of LOSSES.
        sets: training sets.
        grids: their reduced losses; none for scattered points.
        noise: what noise adds to each (see noise_loss); empty when nothing is known of it.
        conditions: what the model is to keep.
        horizon: of the model.
        start: where its optimum is looked for from.
        responds: whether the method can take the output-error loss.

    Raises InputError for a loss that these data or the method cannot have.
    """
    if asked not in LOSSES:
        raise InputError(f"loss: expected one of {', '.join(LOSSES)}, got {asked!r}")
    if asked == "corrected" and not noise:
        raise InputError("loss: 'corrected' needs fields of noise")
    if asked == "output" and not responds:
        raise InputError("loss: 'output' is not for the two-stage method")
    if not grids and asked in ("corrected", "output"):
        raise InputError(f"loss: scattered points have 'residual' only, got {asked!r}")
    if asked != "auto":
        return LossChoice(asked, "asked for")
    if not noise:
        return LossChoice("residual", "no fields of noise were given")
    share = noise_share(grids, noise, conditions, horizon, start)
    found = f"noise is {100 * share:.3g} % of the squared residual at its optimum"
    if share < SMALL_SHARE:
        return LossChoice("residual", found)
    if responds and all(WAVE_VECTOR in points.arrays for points in sets):
        return LossChoice("output", f"{found}; loads are single waves")
    return LossChoice("corrected", found)


def noise_share(
    grids: Sequence[ReducedLoss],
    noise: Sequence[np.ndarray],
    conditions: Sequence[Conditions],
    horizon: float,
    start: Parameters,
) -> float:
    """Part of the squared residual that is noise, at the optimum of the residual."""
    at = constrained_optimum(grids, start, conditions).parameters
    model = Model(at.lam, at.mu, at.alpha, at.D, horizon)
    c = [products(model, grid.classes) for grid in grids]
    whole = sum(np.sum((grid.R @ one) ** 2) for grid, one in zip(grids, c))
    return float(sum(np.sum((R @ one) ** 2) for R, one in zip(noise, c)) / whole)
