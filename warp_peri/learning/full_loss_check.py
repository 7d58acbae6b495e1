"""Reduced against full loss during every fit: a departure warns, one that matters ends it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
import torch

from warp_peri.lps.model import bernstein_basis
from warp_peri.regression.coordinates import Parameters, Variables
from warp_peri.regression.losses import FullLoss, ReducedLoss

ROUNDING = 1e-13
"""Of a residual, relative to the loads: what is left of an exact fit."""
EPSILON = float(np.finfo(float).eps)
SAFETY = 100.0
"""Times what rounding does: a backward error is an estimate, and processors differ in it."""
MATTERS = 1e-6
"""Relative departure that no rounding explains and that an answer would show."""


class ConsistencyCheck:
    """Holds the reduced loss to the full one and to its gradients."""

    def __init__(self, grids: Sequence[ReducedLoss], full: Sequence[FullLoss]) -> None:
        self.grids, self.full = grids, full
        self.gradient_size: float | None = None

    def check(self, parameters: Parameters) -> None:
        """Compare at one point, on lattices; the first one sets the size of the gradient.

        Warns where they differ by more than SAFETY times what rounding of every parameter does.
        Raises RuntimeError where that is more than MATTERS of the loss or of the gradient as well.
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
        size = self.gradient_size = self.gradient_size or float(reference.norm())
        by_loss, by_gradient = self._rounding(parameters, reference / sizes, sizes)
        by_loss += EPSILON * expected + ROUNDING * np.sqrt(expected) + ROUNDING**2
        held("loss", abs(reduced - expected), by_loss, expected)
        apart = float((gradient - reference).norm())
        held("gradient", apart, EPSILON * size + by_gradient, size)

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


def held(name: str, departure: float, rounding: float, size: float) -> None:
    """Warn of what rounding does not explain, and end what an answer would show.

    Args:
        name: of what was computed twice.
        departure: of the two.
        rounding: backward error of the computation.
        size: of what was computed.

    Raises RuntimeError for a departure beyond SAFETY times the rounding and MATTERS of the size.
    """
    if departure <= SAFETY * rounding:
        return
    text = (
        f"the reduced {name} departs from the full one by {departure:.1e} of {size:.1e}; rounding "
        f"accounts for some {rounding:.1e}"
    )
    if not departure <= MATTERS * size:
        raise RuntimeError(text)
    warnings.warn(text, stacklevel=2)
