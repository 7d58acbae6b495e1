"""Strain energies of plane sheets with their derivatives: what finite elements and rivals use.

An energy is a function of C = FᵗF, given as c = (C11, C22, C12) of shape [..., 3]; it returns W,
∂W/∂c and ∂²W/∂c² of shapes [...], [..., 3] and [..., 3, 3].
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

Energy = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
AREA_CURVE = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -2.0]])


@dataclass(frozen=True)
class Family:
    """Fibres in one direction: k1/(2 k2) (exp(k2 ⟨I4 − 1⟩²) − 1).

    `angle`: of the direction [rad]; `k1`: stiffness [stress]; `k2`: exponent.
    """

    angle: float
    k1: float
    k2: float


@dataclass(frozen=True)
class Matrix:
    """a (I1 − 2) + f(D), D = det C, with fibre families added.

    `linear`: a [stress]; `of_area`: f, f′ and f″ of D; `fibre_families`: of fibres, which carry
    no compression.
    """

    linear: float
    of_area: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
    families: Sequence[Family] = field(default=())

    def __call__(self, c: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        D = c[..., 0] * c[..., 1] - c[..., 2] ** 2
        slope = np.stack([c[..., 1], c[..., 0], -2 * c[..., 2]], axis=-1)
        f, first, second = self.of_area(D)
        W = self.linear * (c[..., 0] + c[..., 1] - 2) + f
        g = first[..., None] * slope
        g[..., :2] += self.linear
        H = second[..., None, None] * slope[..., :, None] * slope[..., None, :]
        H += first[..., None, None] * AREA_CURVE
        for family in self.families:
            along, across = np.cos(family.angle), np.sin(family.angle)
            m = np.array([along**2, across**2, 2 * along * across])
            x = c @ m - 1
            pulled = x > 0
            x = np.where(pulled, x, 0.0)
            growth = np.exp(np.minimum(family.k2 * x**2, 30.0))
            if family.k2 > 0:
                W = W + family.k1 / (2 * family.k2) * (growth - 1)
            else:
                W = W + family.k1 / 2 * x**2
            g += (family.k1 * x * growth)[..., None] * m
            curve = family.k1 * growth * (1 + 2 * family.k2 * x**2) * pulled
            H += curve[..., None, None] * np.outer(m, m)
        return W, g, H


def hgo(E: float, nu: float, families: Sequence[Family]) -> Matrix:
    """The Holzapfel–Gasser–Ogden sheet of the published data.

    a (I1 − 2) − 2a ln J + b ((J² − 1)/2 − ln J) with a = E/(4(1+ν)), b = E/(6(1−2ν)), and fibres.

    `E`, `nu`: of the matrix [stress], ν < ½; `fibre_families`: of fibres.
    """
    a = E / (4 * (1 + nu))
    b = E / (6 * (1 - 2 * nu))

    def of_area(D: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        log = np.log(D)
        f = -a * log + b * ((D - 1) / 2 - log / 2)
        return f, -a / D + b * (0.5 - 0.5 / D), (a + 0.5 * b) / D**2

    return Matrix(a, of_area, tuple(families))


def plane_stress_hgo(mu: float, families: Sequence[Family] = ()) -> Matrix:
    """An incompressible sheet in plane stress: μ/2 (I1 + 1/D − 3), and fibres."""

    def of_area(D: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return mu / 2 * (1 / D - 1), -mu / 2 / D**2, mu / D**3

    return Matrix(mu / 2, of_area, tuple(families))


@dataclass(frozen=True)
class Invariants:
    """An incompressible sheet: μ/2 (I1 − 3) + k/(2a) (exp(a (I1 − 3)²) − 1), and fibres.

    `mu`, `k`: of the matrix [stress]; `a`: exponent, > 0; `fibre_families`: of fibres.
    """

    mu: float
    k: float
    a: float
    families: Sequence[Family]

    def __call__(self, c: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        W, g, H = plane_stress_hgo(self.mu, self.families)(c)
        excess, slope, curve = (part * 2 for part in plane_stress_hgo(1.0)(c))  # I1 − 3
        growth = np.exp(np.minimum(self.a * excess**2, 30.0))
        first = self.k * excess * growth
        second = self.k * growth * (1 + 2 * self.a * excess**2)
        W = W + self.k / (2 * self.a) * (growth - 1)
        g = g + first[..., None] * slope
        H = H + first[..., None, None] * curve
        return W, g, H + second[..., None, None] * slope[..., :, None] * slope[..., None, :]


def ensemble(mean: float, spread: float, k1: float, k2: float, count: int = 12) -> list[Family]:
    """Fibres of all directions, as many as a normal distribution of angles has [rad]."""
    angles = mean + np.pi * (np.arange(count) / count - 0.5)
    share = np.exp(-((angles - mean) ** 2) / (2 * spread**2 + 1e-6))
    return [Family(a, k1 * w, k2) for a, w in zip(angles, share / share.sum())]


@dataclass(frozen=True)
class Fung:
    """(e^Q − 1)/2 with Q = e·A e, e = (E11, E22, 2 E12), A symmetric with six numbers.

    `numbers`: A11, A22, A12, A33, A13, A23.
    """

    numbers: Sequence[float]

    def __call__(self, c: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        a11, a22, a12, a33, a13, a23 = self.numbers
        A = np.array([[a11, a12, a13], [a12, a22, a23], [a13, a23, a33]])
        e = np.stack([(c[..., 0] - 1) / 2, (c[..., 1] - 1) / 2, c[..., 2]], axis=-1)
        Ae = e @ A
        growth = np.exp(np.minimum((e * Ae).sum(axis=-1), 30.0))
        scale = np.array([0.5, 0.5, 1.0])
        g = growth[..., None] * Ae * scale
        curve = A + 2 * Ae[..., :, None] * Ae[..., None, :]
        return (growth - 1) / 2, g, growth[..., None, None] * curve * np.outer(scale, scale)
