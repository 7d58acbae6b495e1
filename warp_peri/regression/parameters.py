"""Numbers of a solid while they are learned: plain values, and torch leaves with their bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch

from warp_peri.lps.shapes import InfluenceFunction
from warp_peri.points.families import BondClasses
from warp_peri.regression.losses import FullLoss, ReducedLoss, class_weights

SMALLEST_MODULUS, LARGEST_ALPHA = 1e-3, 3 - 1e-3
"""μ and λ + μ [TPa] stay above the first, α below the second."""


@dataclass(frozen=True)
class Parameters:
    """λ, μ [TPa], α, D of one stage, inside their bounds, and the loss on the way there.

    D_dilatation holds the coefficients of the dilatation's own influence function, if it has one;
    shape is the influence function that D stands for, if its parameters are what is learned.
    """

    lam: float
    mu: float
    alpha: float
    D: np.ndarray
    losses: list[float] = field(default_factory=list, repr=False)
    D_dilatation: np.ndarray | None = None
    shape: InfluenceFunction | None = None

    @property
    def dilatation(self) -> np.ndarray:
        """Coefficients of the dilatation's influence function, shape [M + 1]."""
        return self.D if self.D_dilatation is None else self.D_dilatation


class Variables:
    """λ, μ, α, D as torch leaves for Adam.

    Args:
        start: their values.
        positive: keep D ≥ 0.
        parametrisation: "relu" is the printed one (4.8): the loss sees ReLU(μ), ReLU(λ + μ) −
            ReLU(μ), 3 − ReLU(3 − α) and, for a positive kernel, ReLU(D). A ReLU has no gradient
            once its argument is negative, and λ + μ, which every run drives to zero early in
            stage 1, stays there for good. "projected" keeps the same bounds by moving the leaves
            back after every step.
    """

    def __init__(self, start: Parameters, *, positive: bool, parametrisation: str) -> None:
        values = [start.lam, start.mu, start.alpha, start.D]
        if start.D_dilatation is not None:
            values.append(start.D_dilatation)
        self.leaves = [torch.tensor(value, dtype=torch.float64) for value in values]
        for leaf in self.leaves:
            leaf.requires_grad_()
        self.positive, self.relu = positive, parametrisation == "relu"

    def bounded(self) -> list[torch.Tensor]:
        """λ, μ, α, D and, if it is learned, D of the dilatation, as the loss sees them."""
        if not self.relu:
            return self.leaves
        lam, mu, alpha, *kernels = self.leaves
        stiff = torch.relu(mu)
        if self.positive:
            kernels = [torch.relu(D) for D in kernels]
        return [torch.relu(lam + mu) - stiff, stiff, 3 - torch.relu(3 - alpha), *kernels]

    def project(self) -> None:
        """Move the leaves back inside their bounds; nothing to do under the ReLU."""
        if self.relu:
            return
        lam, mu, alpha, *kernels = self.leaves
        with torch.no_grad():
            mu.clamp_(min=SMALLEST_MODULUS)
            lam.clamp_(min=SMALLEST_MODULUS - mu)
            alpha.clamp_(max=LARGEST_ALPHA)
            if self.positive:
                for D in kernels:
                    D.clamp_(min=0.0)

    def loss(self, terms: Sequence[ReducedLoss | FullLoss]) -> torch.Tensor:
        """The loss over all training sets."""
        values = self.bounded()
        return torch.stack([term.loss(*values) for term in terms]).sum()

    def weights(self, lattices: Sequence[BondClasses]) -> list[tuple[torch.Tensor, torch.Tensor]]:
        """Class weights (w, p) of the deviatoric part and the dilatation on each lattice."""
        _, _, alpha, *kernels = self.bounded()
        tables = [[class_weights(classes, alpha, D) for D in kernels] for classes in lattices]
        return [(table[0], table[-1]) for table in tables]

    def parameters(self, losses: list[float]) -> Parameters:
        """Their values strictly inside the bounds, with the loss on the way."""
        values = [value.detach().numpy().copy() for value in self.bounded()]
        lam, mu, alpha = (float(value) for value in values[:3])
        mu = max(mu, SMALLEST_MODULUS)
        lam, alpha = max(lam, SMALLEST_MODULUS - mu), min(alpha, LARGEST_ALPHA)
        own = values[4] if len(values) > 4 else None
        return Parameters(lam, mu, alpha, values[3], losses, own)
