"""Strain energies of plane sheets, by torch: what finite elements and rivals use.

An energy is W of C = FᵗF, given as c = (C11, C22, C12) of shape [..., 3]; it returns shape [...].
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch

Energy = Callable[[torch.Tensor], torch.Tensor]
STEEPEST = 30.0
"""Exponentials of more go on along their tangent."""


class Family(NamedTuple):
    """Fibres in one direction: k1/(2 k2) (exp(k2 ⟨I4 − 1⟩²) − 1), which carry no compression.

    `angle`: of the direction [rad]; `k1`: stiffness [stress]; `k2`: exponent.
    """

    angle: float
    k1: float
    k2: float


def exponential(x: torch.Tensor) -> torch.Tensor:
    """eˣ − 1, straight beyond STEEPEST."""
    below = x.clamp(max=STEEPEST)
    return torch.exp(below) * (1 + x - below) - 1


def fibres(c: torch.Tensor, families: Sequence[Family]) -> torch.Tensor:
    """The energy of all families."""
    W = torch.zeros_like(c[..., 0])
    for angle, k1, k2 in families:
        along, across = np.cos(angle), np.sin(angle)
        m = c.new_tensor([along**2, across**2, 2 * along * across])
        square = torch.relu(c @ m - 1).square()
        W = W + (k1 / (2 * k2) * exponential(k2 * square) if k2 > 0 else k1 / 2 * square)
    return W


def invariants_of(c: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """C11 + C22 and det C."""
    return c[..., 0] + c[..., 1], c[..., 0] * c[..., 1] - c[..., 2].square()


def hgo(E: float, nu: float, families: Sequence[Family]) -> Energy:
    """The Holzapfel–Gasser–Ogden sheet of the published data, with fibres.

    a (I1 − 2) − 2a ln J + b ((J² − 1)/2 − ln J) with a = E/(4(1+ν)), b = E/(6(1−2ν)); ν < ½.
    """
    a, b = E / (4 * (1 + nu)), E / (6 * (1 - 2 * nu))

    def energy(c: torch.Tensor) -> torch.Tensor:
        trace, D = invariants_of(c)
        log = torch.log(D)
        return a * (trace - 2 - log) + b * (D - 1 - log) / 2 + fibres(c, families)

    return energy


def plane_stress_hgo(mu: float, families: Sequence[Family] = ()) -> Energy:
    """An incompressible sheet in plane stress: μ/2 (I1 − 3), I1 = C11 + C22 + 1/D, and fibres."""
    return invariant_based(mu, 0.0, 1.0, families)


def invariant_based(mu: float, k: float, a: float, families: Sequence[Family]) -> Energy:
    """An incompressible sheet: μ/2 (I1 − 3) + k/(2a) (exp(a (I1 − 3)²) − 1), a > 0, and fibres."""

    def energy(c: torch.Tensor) -> torch.Tensor:
        trace, D = invariants_of(c)
        excess = trace + 1 / D - 3
        W = mu / 2 * excess + fibres(c, families)
        return W + k / (2 * a) * exponential(a * excess.square()) if k else W

    return energy


def fung(numbers: Sequence[float]) -> Energy:
    """(e^Q − 1)/2, Q = e·A e of e = (E11, E22, 2 E12); A11, A22, A12, A33, A13, A23 of A."""
    a11, a22, a12, a33, a13, a23 = numbers
    A = [[a11, a12, a13], [a12, a22, a23], [a13, a23, a33]]

    def energy(c: torch.Tensor) -> torch.Tensor:
        e = (c - c.new_tensor([1, 1, 0])) * c.new_tensor([0.5, 0.5, 1.0])
        return exponential((e * (e @ c.new_tensor(A))).sum(-1)) / 2

    return energy


def ensemble(mean: float, spread: float, k1: float, k2: float, count: int = 12) -> list[Family]:
    """Fibres of all directions, as many as a normal distribution of angles has [rad]."""
    angles = mean + np.pi * (np.arange(count) / count - 0.5)
    share = np.exp(-((angles - mean) ** 2) / (2 * spread**2 + 1e-6))
    return [Family(a, k1 * w, k2) for a, w in zip(angles, share / share.sum())]
