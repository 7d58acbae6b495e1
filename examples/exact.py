"""Exact solutions for examples and tests: a hole, a crack under pressure, plane Maxwell flows."""

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.verification.statics import plate_with_hole as plate_with_hole


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
    y: np.ndarray,
    t: np.ndarray,
    De: float,
    Re: float,
    force: float,
    omega: float,
    modes: int = 1000,
) -> np.ndarray:
    """u [T, Y] from rest under the body force cos(ω t) times `force` (F15)."""
    u = np.zeros((len(t), len(y)))
    turn = np.exp(1j * omega * t)
    for n in range(1, 2 * modes, 2):
        k = n * np.pi
        c = 4 * force / k
        U = c * (1 + 1j * omega * De) / (k**2 + 1j * omega * Re - omega**2 * De * Re)
        free = mode(k, De, Re, -U.real, c / Re - (1j * omega * U).real, t)
        u += np.outer((U * turn).real + free, np.sin(k * y))
    return u


def couette(y: np.ndarray, t: np.ndarray, De: float, Re: float, modes: int = 4000) -> np.ndarray:
    """u [T, Y] between a wall at rest and one that moves at 1 from t = 0 on (F14)."""
    u = np.tile(y, (len(t), 1))
    for n in range(1, modes):
        k = n * np.pi
        u += np.outer(mode(k, De, Re, 2 * (-1) ** n / k, 0.0, t), np.sin(k * y))
    return u
