"""What the search for the constrained optimum is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_peri.errors import InputError

ISOTROPIC, LONG_WAVES = "isotropic", "long waves"
SMOOTHNESS = 1e-10
"""Weight of the second differences of D beside the relative residual. It costs an ordinary fit
nothing that can be seen, and keeps D from growing until its terms cancel to the last digit."""


@dataclass(frozen=True)
class Optimum:
    """The constrained optimum of the loss (theory, 26–28), from plain kernels r^(−α).

    Attributes:
        moduli: (λ, μ) [TPa] to hold at long waves on every lattice (8 Σ w ξ₁²ξ₂²/r² = 1 makes them
            the moduli of the discrete operator); "isotropic" holds that condition and learns λ
            and μ; None learns them freely. "long waves" holds those that the long waves of the
            samples show (theory, 28a), where free ones are two standard errors away.
        jobs: threads for the starts.
        rounds: most rounds of cutting planes.
        smoothness: weight η of the second differences of D beside the relative residual (28).

    Raises InputError for moduli that no solid has.
    """

    moduli: tuple[float, float] | str | None = LONG_WAVES
    jobs: int = 1
    rounds: int = 40
    smoothness: float = SMOOTHNESS

    def __post_init__(self) -> None:
        if isinstance(self.moduli, str):
            if self.moduli not in (ISOTROPIC, LONG_WAVES):
                raise InputError(
                    f"moduli: expected (λ, μ), {ISOTROPIC!r} or {LONG_WAVES!r}, got {self.moduli!r}"
                )
        elif self.moduli is not None and not _are_moduli(self.moduli):
            raise InputError(
                f"moduli: expected (λ, μ) with μ > 0, λ + μ > 0, got {self.moduli!r:.60}"
            )

    @property
    def held(self) -> tuple[float, float] | str | None:
        """What a search holds by itself: those of long waves are found before it."""
        return None if self.moduli == LONG_WAVES else self.moduli


def _are_moduli(given: Any) -> bool:
    """Whether it is (λ, μ) of a solid."""
    try:
        lam, mu = map(float, given)
    except (TypeError, ValueError):
        return False
    return bool(np.isfinite([lam, mu]).all() and mu > 0 and lam + mu > 0)
