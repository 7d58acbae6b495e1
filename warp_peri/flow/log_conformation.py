"""Any law with log C as its state: C stays positive at any stretch and any step (F36, F37).

Stretching is exponential; a step that is right to a thousandth of the large eigenvalue may make
the small one negative. In log C growth is linear and the small eigenvalue has digits of its own
(R. Fattal and R. Kupferman, 2004). What is left of rounding grows with c₁/c₂: up to 10¹⁰ or so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warp_peri.flow.laws import FlowLaw
from warp_peri.flow.planar import carried, eigenvalues, from_eigenvalues, from_frame, in_frame


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
