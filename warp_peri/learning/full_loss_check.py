"""The full loss as the oracle of the reduced one, during every fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from warp_peri.losses.full import FullLoss
from warp_peri.losses.reduced import ReducedLoss
from warp_peri.models.influence import bernstein_basis
from warp_peri.regression.parameters import Parameters, Variables

AGREEMENT = 1e-10
"""Reduced and full loss must agree to this, relative; their gradients to this times the
gradient's norm at the start."""
ROUNDING = 1e-13
EPSILON = float(np.finfo(float).eps)


class Oracle:
    """Holds the reduced loss to the full one and to the gradients of Warp's tape."""

    def __init__(self, grids: Sequence[ReducedLoss], full: Sequence[FullLoss]) -> None:
        self.grids, self.full = grids, full
        self.gradient_size: float | None = None

    def check(self, parameters: Parameters) -> None:
        """Compare at one point, on lattices; the first one sets the size of the gradient.

        Raises RuntimeError where they differ by more than AGREEMENT allows, and by more than what
        rounding leaves of a kernel whose terms cancel.
        """
        if not self.grids:
            return
        variables = Variables(parameters, positive=False, parametrisation="projected")
        sizes = self._sizes(parameters)
        results = []
        for loss in (
            variables.loss(self.grids),
            torch.stack([term.loss(*variables.leaves) for term in self.full]).sum(),
        ):
            parts = torch.autograd.grad(loss, variables.leaves)
            gradient = torch.cat([part.reshape(-1) for part in parts]) * sizes
            results.append((loss.item(), gradient))
        (reduced, gradient), (expected, reference) = results
        self.gradient_size = self.gradient_size or float(reference.norm())
        # Rounding in the residual, relative to the loads, is all that is left of an exact fit.
        by_loss, by_gradient = self._rounding(parameters, reference / sizes, sizes)
        allowed = AGREEMENT * expected + ROUNDING * np.sqrt(expected) + ROUNDING**2 + by_loss
        if not abs(reduced - expected) <= allowed:
            raise RuntimeError(
                f"the reduced loss {reduced:.15e} departs from the full {expected:.15e}"
            )
        difference = float((gradient - reference).norm())
        if not difference <= AGREEMENT * self.gradient_size + by_gradient:
            raise RuntimeError(
                f"the reduced gradient departs from Warp's tape by {difference:.1e}, "
                f"the gradient at the start is {self.gradient_size:.1e}, and rounding of a kernel "
                f"whose terms cancel accounts for {by_gradient:.1e}"
            )

    def _sizes(self, parameters: Parameters) -> torch.Tensor:
        """Units that derivatives are compared in, one for each parameter.

        λ and μ by μ; D by that of a weighted volume of D = 1, since its scale has no effect.
        """
        parts = [torch.tensor([parameters.mu, parameters.mu, 1.0], dtype=torch.float64)]
        for D in (
            (parameters.D,)
            if parameters.D_dilatation is None
            else (parameters.D, parameters.D_dilatation)
        ):
            parts.append(
                torch.full((len(D),), self._volume(parameters.alpha, D), dtype=torch.float64)
            )
        return torch.cat(parts)

    def _rounding(
        self, parameters: Parameters, gradient: torch.Tensor, sizes: torch.Tensor
    ) -> tuple[float, float]:
        """What relative rounding of every parameter does to the loss and to its gradient.

        Terms D_k B_k of either sign cancel in K; the sums lose as much as D itself would.
        """
        variables = Variables(parameters, positive=False, parametrisation="projected")
        numbers = [leaf.detach() for leaf in variables.leaves]
        flat = torch.cat([number.reshape(-1) for number in numbers])

        def loss(flat: torch.Tensor) -> torch.Tensor:
            parts = flat.split([number.numel() for number in numbers])
            shaped = [part.reshape(number.shape) for part, number in zip(parts, numbers)]
            return torch.stack([grid.loss(*shaped) for grid in self.grids]).sum()

        bend = torch.autograd.functional.hessian(loss, flat)
        by_gradient = (sizes[:, None] * bend * flat).norm()
        return EPSILON * float((gradient * flat).norm()), EPSILON * float(by_gradient)

    def _volume(self, alpha: float, D: np.ndarray) -> float:
        """Weighted volume of a kernel over that of K = r^(−α)."""
        classes = self.grids[0].classes
        terms = classes.count * classes.weight * classes.r ** (2 - alpha)
        basis = bernstein_basis(classes.r, classes.horizon, len(D) - 1)
        return float(abs(terms @ (basis @ D)) / terms.sum())
