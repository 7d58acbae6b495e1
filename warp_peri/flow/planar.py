"""Tensors of planar flows: a velocity gradient has four components, a symmetric tensor four.

A gradient K is (xx, xy, yx, yy) with K_ab = ∂_b v_a, a symmetric tensor (xx, xy, yy, zz): what
leaves the plane keeps its own direction. The last axis holds the components; NumPy or torch.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from warp_peri.errors import InputError

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
