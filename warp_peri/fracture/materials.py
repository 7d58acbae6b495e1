"""Solids whose bonds break at once, or soften first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy import ndarray
from scipy.special import hyp1f1

from warp_peri.core.record import FieldUnits, OnLinear
from warp_peri.errors import InputError, Rows
from warp_peri.fracture.bonds import check_breakable, largest_stiffness, unit_toughness
from warp_peri.materials.lps import LPSMaterial
from warp_peri.points.arguments import REDUCED, NotNegative, Positive, checked, typed
from warp_peri.points.families import bond_classes
from warp_peri.solvers.verlet import inertia


@dataclass(frozen=True, eq=False)
class BrittleMaterial(OnLinear, format="warp_peri.brittle_solid", version=4):
    """Solid whose bonds break in tension, at a toughness or a stretch.

    Attributes:
        model: moduli and a positive influence function.
        density: ρ [kg/m³], and times are in ps; in reduced units mass per volume in these.
        toughness: G_c [stress · length]; the lattice's critical stretch follows from it (C6).
        critical_stretch: s₀ itself, instead of G_c.

    Raises InputError unless one of the two criteria is given and all numbers are > 0, and for an
    influence function that changes sign.
    """

    model: LPSMaterial
    density: Positive
    toughness: Annotated[float | None, FieldUnits(length=1, stress=1, positive=True)] = None
    critical_stretch: Annotated[float | None, FieldUnits(positive=True)] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.toughness is None) == (self.critical_stretch is None):
            got = f"{self.toughness}, {self.critical_stretch}"
            raise InputError(f"criterion: expected toughness or critical_stretch, got {got}")
        check_breakable(self.model)

    @property
    def linear(self) -> LPSMaterial:
        """Linear solid before anything breaks."""
        return self.model

    @property
    def inertia(self) -> float:
        """Density ρ in stress · time² / length², of kg/m³ and ps where units are named."""
        return self.density if self.units == REDUCED else inertia(self.density, self.units)

    def rows(self) -> Rows:
        """Name and value of what its printed form shows, the density with its unit."""
        unit = "" if self.units == REDUCED else " kg/m³"
        return [(n, text + unit if n == "density" else text) for n, text in super().rows()]

    def longest_step(self, spacing: float) -> float:
        """Time step on a lattice that is stable whatever breaks (theory, C9)."""
        classes = bond_classes(spacing, self.horizon, dimension=self.dimension)
        return float(2 * np.sqrt(self.inertia / largest_stiffness(self.model, classes)))


@typed
def with_positive_kernel(model: LPSMaterial, horizon: Positive) -> LPSMaterial:
    """Solid with the λ and μ of a model and K = 1/r, which has them on every lattice (C7). Use it
    for fracture of a model whose influence function changes sign."""
    return LPSMaterial(
        model.lam, model.mu, 1.0, np.ones(1), horizon, units=model.units, dimension=model.dimension
    )


@typed
def continuum_stretch(model: LPSMaterial, toughness: Positive) -> float:
    """Critical stretch s₀ of the continuum for a toughness G_c (C5, V5), N. Trask and others 2019.
    In space G_c is energy over the area of the crack. λ = μ is the bond-based solid."""
    lam, mu = model.lam, model.mu
    if model.dimension == 3:
        unit = 3 * mu + (3 / 4) ** 4 * (lam - mu)
    else:
        unit = 6 * mu / np.pi + 16 / (9 * np.pi**2) * (lam - mu)
    return float(np.sqrt(toughness / (unit * model.horizon)))


@typed
@dataclass(frozen=True)
class BondLaw:
    """Pull law of a bond: k d exp(−β s), s = d/r² > 0, and k d in compression (C16).

    Attributes:
        softness: β ≥ 0; it would pull hardest at s = 1/β.
        stretch: s₀ at which it begins to fail; inf for never.
        tail: stretch beyond s₀ over which its pull falls to nothing, linearly; 0 breaks at once.

    Raises InputError unless β ≥ 0, s₀ > 0 and the tail ≥ 0.
    """

    softness: NotNegative
    stretch: Positive = np.inf
    tail: NotNegative = 0.0

    def pull(self, s: ndarray) -> ndarray:
        """Pull of a bond over k r² before it begins to fail."""
        return np.asarray(pull_of(checked("s", s), self.softness, np))

    def share(self, worst: ndarray) -> ndarray:
        """Share of a bond's pull that is left after a largest stretch, from 1 to 0."""
        worst = checked("worst", worst)
        return np.asarray(share_of(worst, self.softness, np.float64(self.stretch), self.tail, np))

    def spent(self) -> float:
        """Energy that breaks a bond, over k r²; s₀²/2 without softness and tail (C18). Of a bond
        that never fails the energy to pull it to any length: 1/β², or inf. Too much of one
        that softens to below its tail's line, where βs₀ > 1 and the tail is above s₀/(βs₀ − 1)."""
        b, s = self.softness, self.stretch
        if np.isinf(s):
            return 1 / b**2 if b else np.inf
        before = s * s / 2 * hyp1f1(2, 3, -b * s)  # [1 − e^(−βs) (1 + βs)]/β² without cancellation
        return float(before + self.pull(np.array(s)) * self.tail / 2)


def pull_of(s: Any, softness: Any, of: Any) -> Any:
    """Pull of a bond as BondLaw.pull, of NumPy or torch."""
    return s * of.exp(-softness * of.clip(s, 0, None))


def slope_of(s: ndarray, softness: float) -> ndarray:
    """Slope of BondLaw.pull over the stretch."""
    s = np.maximum(s, 0)
    return np.exp(-softness * s) * (1 - softness * s)


def share_of(worst: Any, softness: Any, stretch: Any, tail: Any, of: Any) -> Any:
    """Share of a bond's pull as BondLaw.share, of NumPy or torch; a tail of 0 has no gradient."""
    beyond = worst > stretch
    if tail == 0 or not beyond.any():
        return of.where(beyond, 0.0, of.ones_like(worst))
    fall = of.clip(1 - (worst - stretch) / tail, 0, None)
    whole = pull_of(of.where(beyond, worst, 1.0), softness, of)
    return of.where(beyond, of.clip(pull_of(stretch, softness, of) * fall / whole, None, 1), 1.0)


@dataclass(frozen=True, eq=False)
class SofteningMaterial(OnLinear, format="warp_peri.soft_solid"):
    """Solid whose bonds soften and fail by one law (C16), positive; InputError unless λ = μ."""

    model: LPSMaterial
    law: BondLaw

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.model.lam != self.model.mu:
            raise InputError("model: expected λ = μ, bonds without a dilatation")

    linear = BrittleMaterial.linear

    def toughness(self, spacing: float) -> float:
        """Toughness G_c [stress length] of a straight cut on a lattice with this spacing (C18)."""
        classes = bond_classes(spacing, self.horizon, dimension=self.dimension)
        return 2 * unit_toughness(self.model, classes) * self.law.spent()
