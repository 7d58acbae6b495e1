"""The loss (10) over all samples and nodes, through the Warp operator and its tape."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from warp_peri.dataset import PointSet
from warp_peri.errors import InputError
from warp_peri.operator import Sweeps, lps_force


def sample_factors(points: PointSet, *, normalise: bool) -> tuple[np.ndarray, float]:
    """Factor of each sample's residual, shape [S], and the mean square of the weighted loads.

    The factor is 1, or 1/‖b‖ over the interior with `normalise`. Raises InputError for a set
    without samples or loads, or a sample without load that is to be normalised.
    """
    if len(points) == 0:
        raise InputError("the training set has no samples")
    load = np.linalg.norm(points.b[:, points.interior].reshape(len(points), -1), axis=1)
    if not load.any():
        raise InputError("the training set has no loads on its interior")
    if not normalise:
        return np.ones(len(points)), float(np.mean(load**2))
    if not load.all():
        raise InputError(f"sample {int(np.argmin(load))} has no load and cannot be normalised")
    return 1 / load, 1.0


class FullLoss:
    """(1/S) Σ_s ‖L u − b‖² over the interior, relative to (1/S) Σ_s ‖b‖².

    Args:
        points: samples on a lattice.
        horizon: δ [Å].
        normalise: divide each sample by ‖b‖ first.
    """

    def __init__(self, points: PointSet, horizon: float, *, normalise: bool = False) -> None:
        factor, scale = sample_factors(points, normalise=normalise)
        self.sweeps = Sweeps(points, horizon)
        self.u = torch.from_numpy(points.u)
        self.b = torch.from_numpy(points.b[:, points.interior])
        self.weight = torch.from_numpy(factor**2 / (scale * len(points)))

    def _squares(self, *parameters: Any) -> torch.Tensor:
        residual = lps_force(self.sweeps, self.u, *parameters) - self.b
        return (residual**2).sum(dim=(1, 2))

    def loss(self, *parameters: Any) -> torch.Tensor:
        """The loss at (λ, μ, α, D), differentiable."""
        return self.weight @ self._squares(*parameters)

    def mean_error(self, *parameters: Any) -> float:
        """E_res, the mean over samples of ‖L u − b‖/‖b‖; samples without load are left out."""
        load = (self.b**2).sum(dim=(1, 2))
        loaded = load > 0
        with torch.no_grad():
            ratio = self._squares(*parameters)[loaded] / load[loaded]
        return float(ratio.sqrt().mean())
