"""The law of nonlocal diffusion: an influence function and a conductivity (theory.md, D1)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from warp_peri.core.record import Length, Quantity, Record
from warp_peri.errors import InputError
from warp_peri.models.influence import ALPHA_BOUND, bernstein_basis
from warp_peri.points.samples import PointsLike
from warp_peri.points.unit_names import USUAL, Units

if TYPE_CHECKING:
    from warp_peri.diffusion.operator import Conductivity, DiffusionOperator


@dataclass(frozen=True, eq=False, repr=False)
class Conductor(Record, format="warp_peri.conductor"):
    """Flux −κ∇φ spread over a ball, with K(r) = r^(−α) Σ_k D_k B_k,M(r/δ).

    Attributes:
        horizon: δ [length].
        conductivity: κ > 0, of where no field of it is given [stress length²/time of a φ without a
            unit].
        alpha: exponent α < 3.
        D: Bernstein coefficients, shape [M + 1]; their common scale has no effect.
        units: names of the units of length and stress that it is in, as a Model's.

    Raises InputError naming the first number out of its range.
    """

    horizon: Length
    conductivity: Annotated[float, Quantity(length=2, stress=1, positive=True)] = 1.0
    alpha: float = 1.0
    D: np.ndarray = field(default_factory=lambda: np.ones(1))
    units: Units = USUAL
    dimension: ClassVar[int] = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.alpha < ALPHA_BOUND:
            raise InputError(f"alpha: expected less than {ALPHA_BOUND:g}, got {self.alpha}")
        if self.D.ndim != 1 or not self.D.any():
            raise InputError("D: expected finite coefficients, one of them other than 0")

    def basis(self, r: np.ndarray) -> np.ndarray:
        """r^(−α) B_k(r/δ), shape [..., M + 1]."""
        table: np.ndarray = r[..., None] ** -self.alpha * bernstein_basis(
            r, self.horizon, len(self.D) - 1
        )
        return table

    def on(self, points: PointsLike, *, kappa: Conductivity | None = None) -> DiffusionOperator:
        """The law on points, with a conductivity of its own as of DiffusionOperator."""
        from warp_peri.diffusion.operator import DiffusionOperator

        return DiffusionOperator(self, points, kappa=kappa)
