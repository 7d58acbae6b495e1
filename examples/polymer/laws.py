"""Polymer laws by name, in the plane, and by the logarithm of conformation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
import torch

from warp_peri.errors import InputError
from warp_peri.points.arrays import is_number

IDENTITY = np.array([1.0, 0.0, 1.0, 1.0])
"""The unit tensor."""


def stack(parts: list[Any]) -> Any:
    """Components on a new last axis."""
    if any(isinstance(part, torch.Tensor) for part in parts):
        return torch.stack(torch.broadcast_tensors(*parts), dim=-1)
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


def unpack(A: Any) -> tuple[Any, Any, Any, Any]:
    """The components xx, xy, yy, zz of tensors [n, 4]."""
    return A[..., 0], A[..., 1], A[..., 2], A[..., 3]


def shear(rate: Any) -> np.ndarray:
    """K of simple shear, v_x = rate·y, shape [..., 4]."""
    rate = np.asarray(rate, dtype=float)
    return np.asarray(np.multiply.outer(rate, [0.0, 1.0, 0.0, 0.0]))


def elongation(rate: Any) -> np.ndarray:
    """K of planar elongation, v = rate·(x, −y), shape [..., 4]."""
    rate = np.asarray(rate, dtype=float)
    return np.asarray(np.multiply.outer(rate, [1.0, 0.0, 0.0, -1.0]))


def carried(K: Any, C: Any) -> Any:
    """K C + C Kᵗ: what the flow does to a tensor that it carries and stretches."""
    kxx, kxy, kyx, kyy = unpack(K)
    xx, xy, yy, zz = unpack(C)
    return stack(
        [
            2 * (kxx * xx + kxy * xy),
            (kxx + kyy) * xy + kxy * yy + kyx * xx,
            2 * (kyx * xy + kyy * yy),
            0 * zz,
        ]
    )


def trace(C: Any) -> Any:
    """The trace of tensors [n, 4]."""
    return C[..., 0] + C[..., 2] + C[..., 3]


def eigenvalues(C: Any) -> tuple[Any, Any, Any, Any, Any]:
    """(c1, c2, c3, cos 2φ, sin 2φ): c1 ≥ c2 in the plane, c1 along the angle φ; c3 out of it."""
    xx, xy, yy, zz = unpack(C)
    mean, half = (xx + yy) / 2, (xx - yy) / 2
    radius = (half * half + xy * xy + 1e-30) ** 0.5  # keeps the derivative finite where c1 = c2
    return mean + radius, mean - radius, zz, half / radius, xy / radius


def from_eigenvalues(s1: Any, s2: Any, s3: Any, cosine: Any, sine: Any) -> Any:
    """The tensor of these eigenvalues in the frame that `eigenvalues` gave."""
    mean, radius = (s1 + s2) / 2, (s1 - s2) / 2
    return stack([mean + radius * cosine, radius * sine, mean - radius * cosine, s3])


def in_frame(A: Any, cosine: Any, sine: Any) -> tuple[Any, Any, Any]:
    """(A₁₁, A₂₂, A₁₂) in the frame that `eigenvalues` gave."""
    xx, xy, yy = A[..., 0], A[..., 1], A[..., 2]
    mean, half = (xx + yy) / 2, (xx - yy) / 2
    along = half * cosine + xy * sine
    return mean + along, mean - along, xy * cosine - half * sine


def from_frame(a1: Any, a2: Any, a12: Any, a3: Any, cosine: Any, sine: Any) -> Any:
    """The tensor that has these components in the frame that `eigenvalues` gave."""
    mean, half = (a1 + a2) / 2, (a1 - a2) / 2
    along, across = half * cosine - a12 * sine, half * sine + a12 * cosine
    return stack([mean + along, across, mean - along, a3])


def check_conformation(C: np.ndarray) -> None:
    """Raises InputError unless every C is finite and positive definite."""
    low = np.minimum(eigenvalues(C)[1], C[..., 3])
    bad = ~(np.isfinite(C).all(axis=-1) & (low > 0))
    if bad.any():
        first = int(np.flatnonzero(bad)[0])
        value = np.ravel(low)[first]
        raise InputError(
            f"conformation: expected positive eigenvalues, got {value:.3g} at place {first} "
            f"({int(bad.sum())} of {bad.size} are not positive)"
        )


def plain_number(value: Any) -> float:
    """A float of a number or a torch scalar, nan of anything else, which no range holds."""
    value = value.detach() if isinstance(value, torch.Tensor) else value
    return float(value) if is_number(value) else np.nan


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
            raise InputError(f"alpha: expected a number from 0 to 1, got {self.alpha!r:.60}")

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
            raise InputError(f"b: expected a number above 3, got {self.b!r:.60}")

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


@dataclass(frozen=True)
class LogConformation:
    """A law whose state Ψ is log C, shape [n, 4]; [n, 8] for a law with a second memory.

    Args:
        law: named or learned, with a positive definite C.
    """

    law: FlowLaw

    @property
    def name(self) -> str:
        """The law's name in tables and figures."""
        return f"{getattr(self.law, 'name', type(self.law).__name__)}, log C"

    @property
    def rest(self) -> np.ndarray:
        """Ψ = log C at rest."""
        rest: np.ndarray = logarithm(np.asarray(self.law.rest)[None])[0]
        return rest

    def rate(self, K: np.ndarray, Psi: np.ndarray) -> np.ndarray:
        """dΨ/dt of Ψ = log C (F37)."""
        C = exponential_of(Psi)
        rate = np.asarray(self.law.rate(K, C))
        blocks = range(0, C.shape[-1], 4)
        slopes = [_slope(K, Psi[..., i : i + 4], C[..., i : i + 4], rate[..., i : i + 4])
                  for i in blocks]  # fmt: skip
        return np.concatenate(slopes, axis=-1)

    def stress(self, Psi: np.ndarray) -> np.ndarray:
        """The stress that the law gives at C = exp Ψ."""
        return np.asarray(self.law.stress(exponential_of(Psi)))

    def check(self, K: np.ndarray, Psi: np.ndarray) -> None:
        """Check C = exp Ψ as the law checks its states."""
        self.law.check(K, exponential_of(Psi))


def exponential_of(Psi: np.ndarray) -> np.ndarray:
    """C = exp Ψ, block by block."""
    return _mapped(Psi, np.exp)


def logarithm(C: np.ndarray) -> np.ndarray:
    """Ψ = log C of positive definite C, block by block."""
    return _mapped(C, np.log)


def _mapped(A: np.ndarray, function: np.ufunc) -> np.ndarray:
    parts = []
    for i in range(0, A.shape[-1], 4):
        a1, a2, a3, cosine, sine = eigenvalues(A[..., i : i + 4])
        parts.append(from_eigenvalues(function(a1), function(a2), function(a3), cosine, sine))
    return np.concatenate(parts, axis=-1)


def _slope(K: np.ndarray, Psi: np.ndarray, C: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """In the frame of C; what the flow does to C is taken there, where nothing cancels."""
    p1, p2, _, cosine, sine = eigenvalues(Psi)
    none = cosine**2 + sine**2 < 0.5  # C a multiple of I in the plane: any frame will do
    cosine, sine = np.where(none, 1.0, cosine), np.where(none, 0.0, sine)
    kxx, kxy, kyx, kyy = np.moveaxis(K, -1, 0)
    k1, k2, symmetric = in_frame(
        np.stack([kxx, (kxy + kyx) / 2, kyy, 0 * kxx], axis=-1), cosine, sine
    )
    spin = (kxy - kyx) / 2
    c1, c2, c3 = np.exp(p1), np.exp(p2), C[..., 3]
    r1, r2, r12 = in_frame(rate - carried(K, C), cosine, sine)
    gap = p1 - p2
    turned = (symmetric + spin) * c2 + (symmetric - spin) * c1 + r12
    narrow = np.where(gap < 1e-6, 1 / c2, gap / (c2 * np.expm1(np.maximum(gap, 1e-6))))
    return np.asarray(
        from_frame(
            2 * k1 + r1 / c1, 2 * k2 + r2 / c2, turned * narrow, rate[..., 3] / c3, cosine, sine
        )
    )
