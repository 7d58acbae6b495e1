"""Exact solutions for examples and tests: a hole, cracks, waves of K = 1/r, plane Maxwell flows."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import quad
from scipy.special import j0, j1

APART = 1e-8
"""Two roots of an isotropic plate coincide; its shear compliance is moved by this share."""


def relative_error(value: np.ndarray, exact: np.ndarray) -> float:
    """‖value − exact‖/‖exact‖."""
    return float(np.linalg.norm(value - exact) / np.linalg.norm(exact))


def fitted_order(sizes: ArrayLike, errors: ArrayLike) -> float:
    """Fitted order of convergence by numbers of nodes."""
    return float(-np.polyfit(np.log(sizes), np.log(errors), 1)[0])


def plate_with_hole(
    x: np.ndarray, radius: float, tension: float, moduli: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement [length] and stress outside a free hole about the origin.

    S. G. Lekhnitskii's (1968) for a plate of cubic symmetry along the axes; Kirsch's (1898) where
    it is isotropic. Tension acts along the first axis, far away.

    `x`: positions [length], shape [n, 2], at the hole's edge or outside; `radius`: of the hole
    [length]; `tension`: far from the hole [stress]; `moduli`: with C11, C12, C44
    [stress].

    Returns: u, shape [n, 2], and σ, shape [n, 2, 2].
    """
    (a11, a12, _), s = compliances(moduli), roots(moduli)
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


def roots(moduli: Any) -> np.ndarray:
    """Lekhnitskii's two complex parameters of a plate of cubic symmetry, above the real axis."""
    a11, a12, a66 = compliances(moduli)
    middle = a12 + a66 / 2
    if abs(middle / a11 - 1) < APART:
        middle = a11 * (1 + APART)
    s = np.sqrt(np.roots([a11, 2 * middle, a11]).astype(complex))
    return np.asarray(np.where(s.imag > 0, s, -s))


def compliances(moduli: Any) -> tuple[float, float, float]:
    """a11, a12 and a66 [1/stress] of a plate of cubic symmetry along the axes."""
    det = moduli.C11**2 - moduli.C12**2
    return moduli.C11 / det, -moduli.C12 / det, 1 / moduli.C44


def westergaard(x: np.ndarray, half: float, stress: float, lam: float, mu: float) -> np.ndarray:
    """Displacement around a crack |x| < half on y = 0 in a plane under equal tension, shape [N, 2].

    Plane stress with the two-dimensional λ and μ; H. M. Westergaard, 1939.
    """
    kolosov = (lam + 3 * mu) / (lam + mu)
    z = x[:, 0] + 1j * x[:, 1]
    root = np.sqrt(z - half) * np.sqrt(z + half)
    Z, integral = stress * z / root, stress * root
    y = x[:, 1]
    u = ((kolosov - 1) / 2 * integral.real - y * Z.imag) / (2 * mu)
    v = ((kolosov + 1) / 2 * integral.imag - y * Z.real) / (2 * mu)
    return np.column_stack([u, v])


def hoop_stress(x: np.ndarray, stress: np.ndarray) -> np.ndarray:
    """σ_θθ about the origin, shape [n], of stresses [n, 2, 2] at positions [n, 2]."""
    around = np.stack([-x[:, 1], x[:, 0]], axis=1) / np.hypot(*x.T)[:, None]
    hoop: np.ndarray = np.einsum("na,nab,nb->n", around, stress, around)
    return hoop


def sneddon_opening(
    x: ArrayLike, half: float, pressure: float, lam: float, mu: float
) -> np.ndarray:
    """Half the opening of a crack |x| < half under pressure in a plane; I. N. Sneddon, 1946."""
    inside = np.sqrt(np.maximum(half**2 - np.square(x), 0.0))
    opening: np.ndarray = pressure * (lam + 2 * mu) / (2 * mu * (lam + mu)) * inside
    return opening


def continuum_symbol(k: np.ndarray, lam: float, mu: float, horizon: float) -> np.ndarray:
    """D(k) of the plane's peridynamic integral with K = 1/r, shape [2, 2], k ≠ 0 [1/length].

    The angular integrals are Bessel functions; what is left is one radial quadrature each.
    """
    size = float(np.hypot(*k))
    along = np.outer(k, k) / size**2
    m = 2 * np.pi * horizon**3 / 3

    def radial(angular: Any) -> float:
        found = quad(lambda r: angular(size * r), 0, horizon, epsabs=0, epsrel=1e-12, limit=200)
        return float(found[0])

    longitudinal = radial(lambda x: np.pi - 2 * np.pi * (j0(x) - j1(x) / x) if x else 0.0)
    transverse = radial(lambda x: np.pi - 2 * np.pi * j1(x) / x if x else 0.0)
    dilatation = 4 * np.pi / m * radial(lambda x: x * j1(x)) / size
    gamma = 16 / m * (longitudinal * along + transverse * (np.eye(2) - along))
    return np.asarray(mu * gamma + (lam - mu) * dilatation**2 * along)


def mode(k: float, De: float, Re: float, a: float, v: float, t: np.ndarray) -> np.ndarray:
    """The solution of De Re u″ + Re u′ + k² u = 0 with u(0) = a, u′(0) = v, at times t."""
    root = np.sqrt(complex(1 / (4 * De**2) - k**2 / (De * Re)))
    p, q = -1 / (2 * De) + root, -1 / (2 * De) - root
    if abs(p - q) < 1e-9 * abs(p):
        return np.asarray(((a + (v - p * a) * t) * np.exp(p * t)).real)
    A = (v - q * a) / (p - q)
    return np.asarray((A * np.exp(p * t) + (a - A) * np.exp(q * t)).real)


def poiseuille(
    y: np.ndarray, t: np.ndarray, De: float, Re: float, force: float, modes: int = 1000
) -> np.ndarray:
    """u [T, Y] of a channel of width 1 at rest, under a body force from t = 0 on (F13)."""
    u = np.tile(force / 2 * y * (1 - y), (len(t), 1))
    for n in range(1, 2 * modes, 2):
        k = n * np.pi
        c = 4 * force / k
        u += np.outer(mode(k, De, Re, -c / k**2, c / Re, t), np.sin(k * y))
    return u


def oscillation(
    y: np.ndarray, t: np.ndarray, De: float, Re: float, force: float, omega: float
) -> np.ndarray:
    """u [T, Y] from rest under the body force cos(ω t) times `force` (F15)."""
    u = np.zeros((len(t), len(y)))
    turn = np.exp(1j * omega * t)
    for n in range(1, 2000, 2):
        k = n * np.pi
        c = 4 * force / k
        U = c * (1 + 1j * omega * De) / (k**2 + 1j * omega * Re - omega**2 * De * Re)
        free = mode(k, De, Re, -U.real, c / Re - (1j * omega * U).real, t)
        u += np.outer((U * turn).real + free, np.sin(k * y))
    return u


def couette(y: np.ndarray, t: np.ndarray, De: float, Re: float) -> np.ndarray:
    """u [T, Y] between a wall at rest and one that moves at 1 from t = 0 on (F14)."""
    u = np.tile(y, (len(t), 1))
    for n in range(1, 4000):
        k = n * np.pi
        u += np.outer(mode(k, De, Re, 2 * (-1) ** n / k, 0.0, t), np.sin(k * y))
    return u
