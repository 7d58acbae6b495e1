"""The noise-corrected loss: what noise in the displacement adds to a residual, taken off again.

Noise e in u adds E‖L e‖² to the loss (10) and pulls the fit towards a softer solid. L e is linear
in the products c, so that noise alone, swept like data, estimates the addition (theory.md, 36–37).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from warp_peri.errors import InputError
from warp_peri.points.samples import Samples
from warp_peri.regression.reduced import ReducedLoss, reduce, with_rows

KNOWN = 0.1
"""Directions of which a larger part of the data's squares than 1 − KNOWN is noise are left out."""


def noise_loss(noise: Samples, points: Samples, horizon: float, weight: np.ndarray) -> np.ndarray:
    """Factor R_e of what the noise adds to a reduced loss: ‖R_e c‖² is its expectation.

    Args:
        noise: fields of noise alone, on the nodes of `points`; its loads are not looked at.
        points: the training samples; each is taken to carry noise of the same size.
        horizon: δ [Å].
        weight: of each training sample, shape [S].

    Returns:
        Triangular, of the shape of the ReducedLoss of `points`.

    Raises InputError for noise without fields or on other nodes.
    """
    check_noise(noise, points)
    bare = Samples(noise.points, noise.u, np.zeros_like(noise.u))
    each = np.full(len(noise), weight.sum() / len(noise))
    return reduce(bare, horizon, each).R


def corrected(loss: ReducedLoss, R_noise: np.ndarray) -> ReducedLoss:
    """The loss less what the noise adds to it: a square and a constant, both not below zero.

    Loads carry no noise, so that ‖F c + l‖² − ‖R_e c‖² is a quadratic form of the products c that
    has the minimum of ‖√(1−ν) Vᵗ F c + (1−ν)^(−½) Uᵗ l‖² (theory.md, 37). Directions of which
    less than KNOWN is not noise count nothing. No squares are subtracted, so that digits are kept.
    """
    load, width = loss.R[:, -1], loss.R.shape[1] - 1
    left, size, right = np.linalg.svd(loss.R[:, :-1], full_matrices=False)
    kept = size > np.finfo(float).eps * width * size[0]
    left, size, right = left[:, kept], size[kept], right[kept]
    root, axes = np.linalg.svd((R_noise[:, :-1] @ right.T) / size)[1:]
    share = np.zeros(len(axes))
    share[: len(root)] = root**2
    along = axes @ (left.T @ load)
    known = 1 - share > KNOWN
    gain = np.sqrt(1 - share[known])
    form = np.zeros((len(gain) + 1, width + 1))
    form[:-1, :-1] = gain[:, None] * (axes[known] * size) @ right
    form[:-1, -1] = along[known] / gain
    rest = load @ load - (form[:-1, -1] ** 2).sum()  # a constant: of no weight in the minimum
    form[-1, -1] = np.sqrt(max(0.0, rest))
    return dataclasses.replace(loss, R=with_rows(np.zeros_like(loss.R), form))


def check_noise(noise: Samples, points: Samples) -> None:
    """Raise InputError when noise does not belong to a training set."""
    if len(noise) == 0:
        raise InputError("noise: expected at least one field, got none")
    if noise.x.shape != points.x.shape or not np.array_equal(noise.interior, points.interior):
        raise InputError(
            f"noise: expected the {len(points.x)} nodes of the training set, got {len(noise.x)}"
        )
    if not np.allclose(noise.x, points.x, rtol=0, atol=1e-6 * points.spacing):
        raise InputError("noise: expected the nodes of the training set, got others")
