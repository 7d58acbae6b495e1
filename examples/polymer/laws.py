"""Tensors of plane flow as (xx, xy, yy, zz), and the law of Hookean dumbbells (theory, F7)."""

from typing import Any, ClassVar, Protocol

import numpy as np

from warp_peri import InputError

IDENTITY = np.array([1.0, 0.0, 1.0, 1.0])
"""The unit tensor."""


def shear(rate: Any) -> np.ndarray:
    """K of simple shear, v_x = rate·y, shape [..., 4]."""
    return np.asarray(np.multiply.outer(np.asarray(rate, dtype=float), [0.0, 1.0, 0.0, 0.0]))


def elongation(rate: Any) -> np.ndarray:
    """K of planar elongation, v = rate·(x, −y), shape [..., 4]."""
    return np.asarray(np.multiply.outer(np.asarray(rate, dtype=float), [1.0, 0.0, 0.0, -1.0]))


def carried(K: np.ndarray, C: np.ndarray) -> np.ndarray:
    """K C + C Kᵗ: what the flow does to a tensor that it carries and stretches."""
    kxx, kxy, kyx, kyy = np.moveaxis(K, -1, 0)
    xx, xy, yy, zz = np.moveaxis(C, -1, 0)
    across = (kxx + kyy) * xy + kxy * yy + kyx * xx
    parts = [2 * (kxx * xx + kxy * xy), across, 2 * (kyx * xy + kyy * yy), 0 * zz]
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


class FlowLaw(Protocol):
    """What a flow asks of a law; C has shape [n, 4], and so has K."""

    def rate(self, K: np.ndarray, C: np.ndarray) -> np.ndarray:
        """dC/dt, whose stress s = De σ is C − I."""

    def check(self, K: np.ndarray, C: np.ndarray) -> None:
        """Raises InputError for a state that the law does not know; may warn."""


class UpperConvectedMaxwell:
    """The exact law of Hookean dumbbells (F7)."""

    name: ClassVar[str] = "upper-convected Maxwell"

    def rate(self, K: np.ndarray, C: np.ndarray) -> np.ndarray:
        """dC/dt of Hookean dumbbells (F7)."""
        return carried(K, C) - (C - IDENTITY)

    def check(self, K: np.ndarray, C: np.ndarray) -> None:
        """Raises InputError for a C that is not positive definite."""
        xx, xy, yy, zz = np.moveaxis(C, -1, 0)
        if not (np.isfinite(C).all() and (np.minimum(xx * yy - xy**2, zz) > 0).all()):
            raise InputError("conformation: expected positive eigenvalues")
