"""A solid as one value: what L u is a function of, apart from the points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_peri.errors import InputError


@dataclass(frozen=True, eq=False)
class Solid:
    """λ, μ, α and the Bernstein coefficients of the influence functions (theory.md, 4–9).

    Numbers and arrays, or torch tensors with their gradients.

    Attributes:
        lam: Lamé parameter λ [TPa].
        mu: Lamé parameter μ, the shear modulus [TPa].
        alpha: exponent α < 3.
        D: Bernstein coefficients, shape [M + 1].
        D_dilatation: those of the dilatation's own influence function, of any degree; None when it
            shares that of D.

    Raises InputError where λ, μ or α is no single number.
    """

    lam: Any
    mu: Any
    alpha: Any
    D: Any
    D_dilatation: Any = None

    def __post_init__(self) -> None:
        for name in ("lam", "mu", "alpha"):
            if np.prod(shape := np.shape(getattr(self, name))) != 1:
                raise InputError(
                    f"{name}: expected one number of a homogeneous solid, got shape {list(shape)}"
                )

    @property
    def dilatation(self) -> Any:
        """Coefficients of the dilatation's influence function."""
        return self.D if self.D_dilatation is None else self.D_dilatation

    @property
    def bond_based(self) -> bool:
        """Whether λ = μ: then no dilatation enters (theory.md, 42), and a collar of δ is enough."""
        return bool(self.lam == self.mu)

    def values(self) -> tuple[Any, ...]:
        """λ, μ, α, D and, if it has coefficients of its own, those of the dilatation."""
        own = () if self.D_dilatation is None else (self.D_dilatation,)
        return (self.lam, self.mu, self.alpha, self.D, *own)

    def map(self, convert: Callable[[Any], Any]) -> Solid:
        """The same solid with every value converted."""
        return Solid(*map(convert, self.values()))
