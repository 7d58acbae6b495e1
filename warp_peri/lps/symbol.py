"""Moduli of the long waves of the LPS on a lattice (theory, 22)."""

from __future__ import annotations

import numpy as np

from warp_peri.lps.model import Model, stiffnesses
from warp_peri.points.families import BondClasses


def long_wave_moduli(
    classes: BondClasses, v: np.ndarray, kappa: float
) -> tuple[float, float, float]:
    """C11, C12, C44 [TPa] of the symbol at long waves (theory, 22), from fourth moments of v.

    C44 = (c2/2) Σ v ξ₁²ξ₂²/r², C11 = (c2/2) Σ v ξ₁⁴/r² + λ − μ, C12 = C44 + λ − μ, with c2/2 = 8 of
    a sheet and 15 of a solid. The dilatation is exact on affine fields, hence the plain
    λ − μ = κ μ².
    """
    d = classes.xi.shape[1]
    x1, x2 = classes.xi.T[:2]
    each = d * (d + 2) * v[classes.bond_class] / (classes.xi**2).sum(axis=1)
    excess = kappa * (classes.count @ (v * classes.r**2)) ** 2
    C44 = each @ (x1**2 * x2**2)
    return float(each @ x1**4 + excess), float(C44 + excess), float(C44)


def moduli(model: Model, classes: BondClasses) -> dict[str, float]:
    """Long-wave moduli C11, C12, C44 [TPa] of a model's discrete operator (theory, 22)."""
    v, kappa = stiffnesses(model, classes)
    return dict(zip(("C11", "C12", "C44"), long_wave_moduli(classes, v, kappa)))
