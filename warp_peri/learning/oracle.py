"""The full loss as the oracle of the reduced one, during every fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from warp_peri.learning.parameters import Parameters, Variables
from warp_peri.losses.full import FullLoss
from warp_peri.losses.reduced import ReducedLoss
from warp_peri.models.influence import bernstein_basis

AGREEMENT = 1e-10
"""Reduced and full loss must agree to this, relative; their gradients to this times the
gradient's norm at the start."""
ROUNDING = 1e-13


class Oracle:
    """Holds the reduced loss to the full one and to the gradients of Warp's tape."""

    def __init__(self, grids: Sequence[ReducedLoss], full: Sequence[FullLoss]) -> None:
        self.grids, self.full = grids, full
        self.gradient_size: float | None = None

    def check(self, at: Parameters) -> None:
        """Compare at one point, on lattices; the first one sets the size of the gradient.

        Raises RuntimeError where they differ by more than AGREEMENT allows.
        """
        if not self.grids:
            return
        variables = Variables(at, positive=False, parametrisation="projected")
        results = []
        for loss in (
            variables.loss(self.grids),
            torch.stack([one.loss(*variables.leaves) for one in self.full]).sum(),
        ):
            lam, mu, alpha, *kernels = torch.autograd.grad(loss, variables.leaves)
            # The scale of D has no effect: its gradient is that by D of the volume of D = 1.
            kernels = [
                part * self._volume(at.alpha, D) for part, D in zip(kernels, variables.leaves[3:])
            ]
            parts = torch.cat([part.reshape(-1) for part in (lam, mu, alpha, *kernels)])
            results.append((loss.item(), parts.detach()))
        (found, gradient), (expected, reference) = results
        self.gradient_size = self.gradient_size or float(reference.norm())
        # Rounding in the residual, relative to the loads, is all that is left of an exact fit.
        allowed = AGREEMENT * expected + ROUNDING * np.sqrt(expected) + ROUNDING**2
        if abs(found - expected) > allowed:
            raise RuntimeError(
                f"the reduced loss {found:.15e} departs from the full {expected:.15e}"
            )
        difference = float((gradient - reference).norm())
        if difference > AGREEMENT * self.gradient_size:
            raise RuntimeError(
                f"the reduced gradient departs from Warp's tape by {difference:.1e}, "
                f"the gradient at the start is {self.gradient_size:.1e}"
            )

    def _volume(self, alpha: float, D: torch.Tensor) -> float:
        """Weighted volume of a kernel over that of K = r^(−α)."""
        one = self.grids[0].classes
        terms = one.count * one.weight * one.r ** (2 - alpha)
        basis = bernstein_basis(one.r, one.horizon, len(D) - 1)
        return float(abs(terms @ (basis @ D.detach().numpy())) / terms.sum())
