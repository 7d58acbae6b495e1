"""The noise-corrected loss: what noise in the displacement adds to a residual, taken off again.

Noise e in u adds E‖L e‖² to the loss (10) and pulls the fit towards a softer solid. L e is linear
in the products c, so that noise alone, swept like data, estimates the addition (theory.md, 36–37).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from warp_peri.errors import InputError
from warp_peri.losses.reduced import ReducedLoss, reduce, with_rows
from warp_peri.points.samples import Samples


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
    """The loss less what the noise adds to it, never below zero.

    With R_e R⁻¹ = U √ν Vᵗ the difference is ‖√(1−ν) Vᵗ R c‖². Where ν > 1 all that is known is
    noise; such directions count nothing, so that the form stays positive semidefinite. No squares
    are subtracted, so that digits are kept.
    """
    size, right = np.linalg.svd(loss.R)[1:]
    kept = size > np.finfo(float).eps * len(size) * size[0]
    whitened = (R_noise @ right[kept].T) / size[kept]
    root, axes = np.linalg.svd(whitened)[1:]
    share = np.zeros(len(axes))
    share[: len(root)] = root**2
    form = np.sqrt(np.maximum(0, 1 - share))[:, None] * (axes * size[kept]) @ right[kept]
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
