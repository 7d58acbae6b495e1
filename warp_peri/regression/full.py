"""The loss (10) over all samples and nodes, through the Warp operator and its tape."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from warp_peri.errors import InputError
from warp_peri.models.solid import Solid
from warp_peri.operator.bonds import Bonds
from warp_peri.operator.lps import lps_force
from warp_peri.points.samples import Samples


def sample_weights(sets: Sequence[Samples], *, normalise: bool) -> list[np.ndarray]:
    """Weight of each sample's ‖L u − b‖² in the loss, one array of shape [S] a set.

    The loss is Σ f² ‖L u − b‖² / Σ f² ‖b‖² over the samples of all sets, f = 1, or 1/‖b‖ with
    `normalise`. Raises InputError for a set without samples or loads, or a sample without load
    that is to be normalised.
    """
    factors, total = [], 0.0
    for points in sets:
        if len(points) == 0:
            raise InputError("the training set has no samples")
        load = np.linalg.norm(points.loads[:, points.interior].reshape(len(points), -1), axis=1)
        if not load.any():
            raise InputError("the training set has no loads on its interior")
        if normalise and not load.all():
            raise InputError(f"sample {int(np.argmin(load))} has no load and cannot be normalised")
        factors.append(1 / load if normalise else np.ones(len(points)))
        total += float(((factors[-1] * load) ** 2).sum())
    return [factor**2 / total for factor in factors]


class FullLoss:
    """Σ_s weight_s ‖L u − b‖² over the interior of one set.

    Args:
        points: samples on a lattice.
        horizon: δ [Å].
        weight: of each sample, shape [S].
    """

    def __init__(self, points: Samples, horizon: float, weight: np.ndarray) -> None:
        self.bonds = Bonds(points, horizon)
        self.u = torch.tensor(points.u)  # a copy: the set may be read-only
        self.b = torch.tensor(points.loads[:, points.interior])
        self.weight = torch.from_numpy(weight)

    def _squares(self, *parameters: Any) -> torch.Tensor:
        residual = lps_force(self.bonds, self.u, Solid(*parameters)) - self.b
        return (residual**2).sum(dim=(1, 2))

    def loss(self, *parameters: Any) -> torch.Tensor:
        """The loss at (λ, μ, α, D), differentiable."""
        return self.weight @ self._squares(*parameters)

    def errors(self, *parameters: Any) -> np.ndarray:
        """‖L u − b‖/‖b‖ of each sample that has a load."""
        load = (self.b**2).sum(dim=(1, 2))
        loaded = load > 0
        with torch.no_grad():
            return (self._squares(*parameters)[loaded] / load[loaded]).sqrt().numpy()
