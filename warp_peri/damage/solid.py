"""Solids that break: their numbers, and what their bonds need.

Theory.md, C1–C3: with w ≥ 0 the energy of a node is between d(d+2)μ/2 and d²κ/2 times
Σ w e²/r² whatever bonds are broken, κ = λ + 2μ/d; of a sheet 4μ and 2(λ+μ).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from warp_peri.core.groups import lattice_group
from warp_peri.core.proof import largest
from warp_peri.core.record import Entry, OnLinear
from warp_peri.damage.lattice_body import LatticeBody
from warp_peri.damage.operator import bond_weights, stiffness_across
from warp_peri.errors import InputError
from warp_peri.materials.lps import Model, stencil_of
from warp_peri.points.arrays import checked
from warp_peri.points.families import BondClasses, bond_classes
from warp_peri.statics.direct import pivots, symmetric_factors

ROUNDING = 1e-12
"""Relative, of weights: below it a bond is without force, whatever its sign."""


def check_breakable(model: Model, classes: BondClasses) -> None:
    """Refuse a model whose bonds must not break (theory, C3).

    Raises InputError with what positive and negative bonds across a line carry, for an influence
    function that changes sign on the lattice.
    """
    w = bond_weights(model, classes)
    if (w >= -ROUNDING * np.abs(w).max()).all():
        return
    plus, minus = stiffness_across(model, classes)
    raise InputError(
        "model: its influence function changes sign on the lattice of spacing "
        f"{classes.spacing:g}: bonds across a line carry {plus:.4g} s² and {minus:.4g} s², and "
        "breaking some of them leaves energies below zero; bonds may break in a positive kernel "
        "(positive_kernel keeps its moduli)"
    )


def check_horizon(model: Model, body: LatticeBody) -> None:
    """Refuse a body whose bonds are not those of the model's ball."""
    if not np.isclose(body.classes.horizon, model.horizon, rtol=1e-9):
        raise InputError(
            f"body: expected the horizon {model.horizon:g}, got {body.classes.horizon:g}"
        )


def check_no_fail(no_fail: ArrayLike | None, count: int) -> np.ndarray:
    """Nodes whose bonds do not break, shape [N] bool; InputError for numbers or another shape."""
    return checked("no_fail", np.zeros(count, bool) if no_fail is None else no_fail, bool, (count,))


def energy_bounds(model: Model) -> tuple[float, float]:
    """Least and largest energy of a node over Σ w e²/r² of its unbroken bonds [stress] (C2)."""
    d = model.dimension
    shear = d * (d + 2) * model.mu / 2
    ends = shear, d * d / 2 * (model.lam + 2 * model.mu / d)
    return min(ends), max(ends)


def largest_stiffness(model: Model, classes: BondClasses) -> float:
    """A proven upper bound of Λmax L of every body on the lattice under any breaking (C9).

    max(μ, κ d / (d + 2)) max_k Λmax Γ(k), κ = λ + 2 μ/d, [stress / length²]; the model must be
    breakable.
    """
    check_breakable(model, classes)
    w = bond_weights(model, classes)
    v = np.bincount(classes.bond_class, w) / classes.count
    d = model.dimension
    gamma = largest(stencil_of(classes, v, 0.0), lattice_group(d))
    return energy_bounds(model)[1] / (d * (d + 2) / 2) * gamma


def breaking_time_step(model: Model, classes: BondClasses, density: float) -> float:
    """Time step below which velocity Verlet is stable under any breaking (C9)."""
    return float(2 * np.sqrt(density / largest_stiffness(model, classes)))


def negative_eigenvalues(matrix: sp.sparray) -> int:
    """How many eigenvalues of the symmetric part of a sparse matrix are below zero.

    By the signs of LDLᵗ (Sylvester's law of inertia), the factors without exchange of rows.

    Raises InputError for a singular matrix, as of a body that moves freely.
    """
    symmetric = sp.csc_matrix((matrix + matrix.T) / 2)
    try:
        factors = symmetric_factors(symmetric)
    except RuntimeError as error:
        raise InputError(f"operator: it is singular ({error})") from None
    signed = pivots(factors)
    if signed is None:
        raise InputError("operator: a pivot is zero; its eigenvalues cannot be counted by signs")
    return int(np.count_nonzero(signed < 0))


def check_cut(matrix: sp.sparray) -> None:
    """Refuse a cut operator with eigenvalues below zero, naming how many there are."""
    count = negative_eigenvalues(matrix)
    if count:
        raise InputError(
            f"crack: the operator with these bonds cut has {count} negative eigenvalues; a model "
            "that changes sign does not carry this crack (positive_kernel keeps its moduli)"
        )


CRITERIA = ("toughness", "critical_stretch", "critical_energy")


@dataclass(frozen=True, eq=False, repr=False)
class BrittleSolid(OnLinear, format="warp_peri.brittle_solid", version=2):
    """What breaks, and when.

    Attributes:
        model: moduli and a positive influence function, the same for the dilatation.
        density: ρ, mass per volume.
        toughness: G_c [stress · length]; the lattice's critical stretch follows from it (C6).
        critical_stretch: s₀ itself, instead of G_c.
        critical_energy: energy density of a bond over its quadrature weight at which it breaks
            [stress / length^d], instead of both (C8).
        tension_only: bonds in compression do not break.

    Raises InputError unless exactly one of the three criteria is given and all numbers are > 0.
    """

    model: Model
    density: Annotated[float, Entry(length=-2, stress=1, positive=True)]
    toughness: Annotated[float | None, Entry(length=1, stress=1, positive=True)] = None
    critical_stretch: Annotated[float | None, Entry(positive=True)] = None
    critical_energy: Annotated[float | None, Entry(stress=1, volume=-1, positive=True)] = None
    tension_only: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        given = [name for name in CRITERIA if getattr(self, name) is not None]
        if len(given) != 1:
            names = ", ".join(given) or "none"
            raise InputError(f"criterion: expected one of {', '.join(CRITERIA)}, got {names}")

    @property
    def linear(self) -> Model:
        """The solid before anything breaks."""
        return self.model

    def longest_step(self, spacing: float) -> float:
        """Time step on a lattice that is stable whatever breaks (theory, C9)."""
        classes = bond_classes(spacing, self.model.horizon, dimension=self.dimension)
        return breaking_time_step(self.model, classes, self.density)

    @property
    def by_energy(self) -> bool:
        """Whether bonds break by their energy instead of their stretch."""
        return self.critical_energy is not None


def positive_kernel(model: Model, horizon: float) -> Model:
    """λ and μ of a model with K = 1/r, which has them exactly on every lattice (C7).

    This is how a model whose influence function changes sign goes to fracture.
    """
    return Model(
        model.lam, model.mu, 1.0, np.ones(1), horizon, units=model.units, dimension=model.dimension
    )


def continuum_stretch(model: Model, toughness: float) -> float:
    """s₀ of the continuum for a toughness G_c (theory, C5, V5), N. Trask and others 2019.

    In three dimensions G_c is energy over the area of the crack. λ = μ is the bond-based solid.
    """
    lam, mu = model.lam, model.mu
    if model.dimension == 3:
        unit = (3 * mu + (3 / 4) ** 4 * (lam - mu)) * model.horizon
    else:
        unit = (6 * mu / np.pi + 16 / (9 * np.pi**2) * (lam - mu)) * model.horizon
    return float(np.sqrt(toughness / unit))
