"""The exact field around a circular hole in a plate under tension (theory.md, B8)."""

from __future__ import annotations

import numpy as np

from warp_peri.statics.rim import Moduli

APART = 1e-8
"""Two roots of an isotropic plate coincide; its shear compliance is moved by this share."""


def plate_with_hole(
    x: np.ndarray, radius: float, tension: float, moduli: Moduli
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement [Å] and stress [TPa] outside a free hole about the origin.

    S. G. Lekhnitskii's (1968) for a plate of cubic symmetry along the axes; Kirsch's (1898) where
    it is isotropic. Tension acts along the first axis, far away.

    Args:
        x: positions [Å], shape [n, 2], at the hole's edge or outside.
        radius: of the hole [Å].
        tension: far from the hole [TPa].
        moduli: of the plate.

    Returns:
        u, shape [n, 2], and σ, shape [n, 2, 2].
    """
    C11, C12, C44 = moduli.C11, moduli.C12, moduli.C44
    det = C11**2 - C12**2
    a11, a12, a66 = C11 / det, -C12 / det, 1 / C44
    middle = a12 + a66 / 2
    if abs(middle / a11 - 1) < APART:
        middle = a11 * (1 + APART)
    squares = np.roots([a11, 2 * middle, a11]).astype(complex)
    s = np.sqrt(squares)
    s = np.where(s.imag > 0, s, -s)
    u = tension * x * (a11, a12)
    stress = np.zeros((len(x), 2, 2))
    stress[:, 0, 0] = tension
    amplitude = -0.5j * tension * radius / (s[0] - s[1]) * np.array([1, -1])
    for root, size in zip(s, amplitude):
        z = x[:, 0] + root * x[:, 1]
        bend = np.sqrt(z**2 - radius**2 * (1 + root**2))
        zeta = (z + bend) / (radius * (1 - 1j * root))
        other = (z - bend) / (radius * (1 - 1j * root))
        flip = np.abs(other) > np.abs(zeta)
        zeta, bend = np.where(flip, other, zeta), np.where(flip, -bend, bend)
        potential, slope = size / zeta, -size / (zeta * bend)
        for a, factor in enumerate((a11 * root**2 + a12, a12 * root + a11 / root)):
            u[:, a] += 2 * (factor * potential).real
        stress[:, 0, 0] += 2 * (root**2 * slope).real
        stress[:, 1, 1] += 2 * slope.real
        stress[:, 0, 1] -= 2 * (root * slope).real
    stress[:, 1, 0] = stress[:, 0, 1]
    return u, stress


def hoop_stress(x: np.ndarray, stress: np.ndarray) -> np.ndarray:
    """σ_θθ about the origin, shape [n], of stresses [n, 2, 2] at positions [n, 2]."""
    around = np.stack([-x[:, 1], x[:, 0]], axis=1) / np.hypot(*x.T)[:, None]
    hoop: np.ndarray = np.einsum("na,nab,nb->n", around, stress, around)
    return hoop
