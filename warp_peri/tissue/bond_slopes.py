"""Slopes of bond energies, outside of the kernels."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from warp_peri.tissue.solid import Dictionary

BOND_SLOPES: dict[str, Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]] = {
    "square": lambda s: (s, np.ones_like(s)),
    "cube": lambda s: (s**2, 2 * s),
    "tension": lambda s: (np.maximum(s, 0), (s > 0) * 1.0),
    "tension_cube": lambda s: (np.maximum(s, 0) ** 2, 2 * np.maximum(s, 0)),
    "log": lambda s: (1 - 1 / (1 + 2 * s), 2 / (1 + 2 * s) ** 2),
    "compression": lambda s: (np.minimum(s, 0), (s < 0) * 1.0),
}
"""ψ′ and ψ″ of every bond energy, (H2); a test holds them to the kernels'."""


def bond_slopes(
    dictionary: Dictionary, s: np.ndarray, c: np.ndarray, k: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Σ c ψ′ and Σ c ψ″ of bonds, (H2), shapes [B] [stress].

    Args:
        dictionary: of energies.
        s: strain of every bond, shape [B].
        c: coefficients, shape [K].
        k: class of every bond, shape [B].
    """
    slopes, curves = np.zeros_like(s), np.zeros_like(s)
    count = len(dictionary.bonds)
    for q, name in enumerate(dictionary.bonds):
        stiffness = c[k * count + q]
        slope, curve = BOND_SLOPES[name](s)
        slopes += stiffness * slope
        curves += stiffness * curve
    return slopes, curves
