"""The residual of the linear peridynamic solid by Warp's operator, and its numbers, in torch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from warp_peri.errors import InputError
from warp_peri.materials.lps import Solid, bernstein_basis
from warp_peri.materials.lps_bonds import Bonds
from warp_peri.materials.lps_fit import class_pairs
from warp_peri.materials.lps_force import lps_force
from warp_peri.points.families import BondClasses
from warp_peri.points.samples import Samples


def class_weights(classes: BondClasses, alpha: torch.Tensor, D: torch.Tensor) -> torch.Tensor:
    """w = K(r) W / m [length⁻²] of each bond class, shape [C]; differentiable."""
    kw = tables(classes, alpha, D)
    return kw / volume(classes, kw)


def tables(classes: BondClasses, alpha: torch.Tensor, D: torch.Tensor) -> torch.Tensor:
    """K W of each bond class, with (r/δ)^(−α) for r^(−α), shape [C]; differentiable."""
    t = classes.r / classes.horizon
    basis = torch.from_numpy(bernstein_basis(t, 1.0, len(D) - 1))
    return torch.from_numpy(classes.weight) * torch.from_numpy(t) ** -alpha * (basis @ D)


def volume(classes: BondClasses, kw: torch.Tensor) -> torch.Tensor:
    """Σ n r² K W."""
    return torch.from_numpy(classes.count * classes.r**2) @ kw


def torch_products(v: torch.Tensor, kappa: torch.Tensor) -> torch.Tensor:
    """(v, κ v v) of the pairs of classes, shape [P]; differentiable."""
    i, j = class_pairs(len(v))
    return torch.cat([v, kappa * v[i] * v[j]])


class OperatorLoss:
    """Σ_s weight_s ‖L u − b‖² over the interior of one set.

    Args:
        points: samples on a lattice.
        horizon: δ [Å].
        weight: of each sample, shape [S].
    """

    def __init__(self, points: Samples, horizon: float, weight: np.ndarray) -> None:
        self.bonds = Bonds(points, horizon)
        self.u = torch.tensor(points.u)  # a copy: the set may be read-only
        self.b = torch.tensor(points.loads[:, points.interior])
        self.weight = torch.from_numpy(weight)

    def _squares(self, *parameters: Any) -> torch.Tensor:
        residual = lps_force(self.bonds, self.u, Solid(*parameters)) - self.b
        return (residual**2).sum(dim=(1, 2))

    def loss(self, *parameters: Any) -> torch.Tensor:
        """The loss at (λ, μ, α, D), differentiable."""
        return self.weight @ self._squares(*parameters)

    def errors(self, *parameters: Any) -> np.ndarray:
        """‖L u − b‖/‖b‖ of each sample that has a load."""
        load = (self.b**2).sum(dim=(1, 2))
        loaded = load > 0
        with torch.no_grad():
            return (self._squares(*parameters)[loaded] / load[loaded]).sqrt().numpy()


PROBED_HORIZON = 2.0
"""Horizon in spacings of the bond-based solid that a lattice's stiffness is measured with."""
UNIT = Solid(1.0, 1.0, 1.0, np.ones(1))
"""K = 1/r with λ = μ = 1."""


def stiffness_of(sets: Sequence[Samples], horizon: float) -> float:
    """The stiffness that loads and displacements show together [TPa].

    That of the bond-based solid, K = 1/r, whose loads have the given work with the loads: ‖b‖² over
    b·A u, A of unit stiffness. Noise in u, which b knows nothing of, averages out of it.

    Raises InputError where it is not above zero: loads and displacements of opposite work.
    """
    loads = work = 0.0
    for samples in sets:
        h = samples.spacing
        bonds = Bonds(
            samples.points, min(PROBED_HORIZON * h, horizon) if h else horizon, bond_based=True
        )
        force = lps_force(bonds, torch.from_numpy(samples.u), UNIT).numpy()
        b = samples.loads[:, samples.interior]
        loads, work = loads + float((b**2).sum()), work + float((force * b).sum())
    if not work > 0:
        raise InputError(
            "u, b: loads and displacements do work of opposite sign, or none, and no solid answers "
            "loads so; expected b to be the load, which is minus the internal force"
        )
    return loads / work
