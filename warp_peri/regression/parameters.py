"""What is searched for, and how: numbers of a solid with their bounds, settings of the search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from warp_peri.errors import InputError
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


ISOTROPIC = "isotropic"
SMOOTHNESS = 1e-10
"""Weight of the second differences of D beside the relative residual. It costs an ordinary fit
nothing that can be seen, and keeps D from growing until its terms cancel to the last digit."""


@dataclass(frozen=True)
class Optimum:
    """The constrained optimum of the loss (theory.md, 26–28), from plain kernels r^(−α).

    Attributes:
        moduli: (λ, μ) [TPa] to hold at long waves on every lattice (8 Σ w ξ₁²ξ₂²/r² = 1 makes them
            the moduli of the discrete operator); "isotropic" holds that condition and learns λ
            and μ; None learns them freely.
        jobs: threads for the starts.
        rounds: most rounds of cutting planes.
        first_cuts: intervals of the zone grid that the first round keeps the conditions on.
        smoothness: weight η of the second differences of D beside the relative residual (28).

    Raises InputError for moduli that no solid has.
    """

    moduli: tuple[float, float] | str | None = None
    jobs: int = 1
    rounds: int = 40
    first_cuts: int = 12
    smoothness: float = SMOOTHNESS

    def __post_init__(self) -> None:
        if isinstance(self.moduli, str):
            if self.moduli != ISOTROPIC:
                raise InputError(f"moduli: expected (λ, μ) or {ISOTROPIC!r}, got {self.moduli!r}")
        elif self.moduli is not None and not _are_moduli(self.moduli):
            raise InputError(
                f"moduli: expected (λ, μ) with μ > 0, λ + μ > 0, got {self.moduli!r:.60}"
            )


def _are_moduli(given: Any) -> bool:
    """Whether it is (λ, μ) of a solid."""
    try:
        lam, mu = map(float, given)
    except (TypeError, ValueError):
        return False
    return bool(np.isfinite([lam, mu]).all() and mu > 0 and lam + mu > 0)
