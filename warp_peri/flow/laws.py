"""Named laws of a polymer's stress: what stands beside a learned one.

All keep a conformation C and give the stress s in n k T; time in relaxation times, K = De κ.
NumPy or torch, and parameters may be torch scalars (theory, F7–F10).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
import torch

from warp_peri.errors import InputError
from warp_peri.flow.planar import (
    IDENTITY,
    carried,
    check_conformation,
    stack,
    trace,
    unpack,
)


def plain_number(value: Any) -> float:
    """A float of a number or a torch scalar."""
    return float(value.detach() if isinstance(value, torch.Tensor) else value)


class FlowLaw(Protocol):
    """What a flow asks of a law; C has shape [..., 4], and so has K."""

    @property
    def rest(self) -> Any:
        """C of the fluid at rest, shape [4]."""

    def rate(self, K: Any, C: Any) -> Any:
        """dC/dt of conformations, shape [n, 4]."""

    def stress(self, C: Any) -> Any:
        """The stress s = De σ of conformations, shape [n, 4]."""

    def check(self, K: np.ndarray, C: np.ndarray) -> None:
        """Raises InputError for a state that the law does not know; may warn."""


@dataclass(frozen=True)
class UpperConvectedMaxwell:
    """The exact law of Hookean dumbbells (F7)."""

    name: ClassVar[str] = "upper-convected Maxwell"

    @property
    def rest(self) -> np.ndarray:
        """The conformation at rest, I."""
        return IDENTITY

    def rate(self, K: Any, C: Any) -> Any:
        """dC/dt of Hookean dumbbells (F7)."""
        return carried(K, C) - self.stress(C)

    def stress(self, C: Any) -> Any:
        """The stress C − I of Hookean dumbbells."""
        xx, xy, yy, zz = unpack(C)
        return stack([xx - 1, xy, yy - 1, zz - 1])

    def check(self, K: np.ndarray, C: np.ndarray) -> None:
        """Raises InputError for a C that is not positive definite."""
        check_conformation(C)


@dataclass(frozen=True)
class Giesekus(UpperConvectedMaxwell):
    """Anisotropic drag α between 0 and 1 (F9)."""

    alpha: Any = 0.2
    name: ClassVar[str] = "Giesekus"

    def __post_init__(self) -> None:
        if not 0 <= plain_number(self.alpha) <= 1:
            raise InputError(f"alpha: expected a number from 0 to 1, got {self.alpha}")

    def rate(self, K: Any, C: Any) -> Any:
        """dC/dt of Giesekus' law (F9)."""
        s = self.stress(C)
        xx, xy, yy, zz = unpack(s)
        square = stack([xx * xx + xy * xy, xy * (xx + yy), xy * xy + yy * yy, zz * zz])
        return carried(K, C) - s - self.alpha * square


@dataclass(frozen=True)
class FENEP:
    """FENE dumbbells with the spring of the mean length (F8): closed, and not exact."""

    b: Any = 50.0
    name: ClassVar[str] = "FENE-P"

    def __post_init__(self) -> None:
        if not plain_number(self.b) > 3:
            raise InputError(f"b: expected a number above 3, got {self.b}")

    @property
    def rest(self) -> Any:
        """The conformation at rest, I b/(b + 3)."""
        c = self.b / (self.b + 3)
        return stack([c, 0 * c, c, c]) if isinstance(c, torch.Tensor) else c * IDENTITY

    def rate(self, K: Any, C: Any) -> Any:
        """dC/dt of FENE-P (F8)."""
        return carried(K, C) - self.stress(C)

    def stress(self, C: Any) -> Any:
        """The stress C/(1 − tr C/b) − I of FENE-P."""
        f = 1 / (1 - trace(C) / self.b)
        xx, xy, yy, zz = unpack(C)
        return stack([xx * f - 1, xy * f, yy * f - 1, zz * f - 1])

    def check(self, K: np.ndarray, C: np.ndarray) -> None:
        """Raises InputError for a C that is not positive definite, or of trace b or more."""
        check_conformation(C)
        longest = float(np.max(trace(C)))
        if longest >= plain_number(self.b):
            raise InputError(f"conformation: expected a trace below {self.b}, got {longest:.4g}")
