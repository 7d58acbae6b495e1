"""A brittle solid: a model whose bonds may break, its density and when they do (theory.md, C5–C8).

Any consistent units, length and stress as the model names them: SI, or Å, ps and TPa with the
density in TPa ps²/Å² (1 kg/m³ = 1e-8 of them).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from warp_peri.core.record import Entry, OnLinear
from warp_peri.damage.stability import breaking_time_step
from warp_peri.errors import InputError
from warp_peri.lps.model import Model
from warp_peri.points.families import bond_classes

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
        """Time step on a lattice that is stable whatever breaks (theory.md, C9)."""
        classes = bond_classes(spacing, self.model.horizon, dimension=self.dimension)
        return breaking_time_step(self.model, classes, self.density)

    @property
    def by_energy(self) -> bool:
        """Whether bonds break by their energy instead of their stretch."""
        return self.critical_energy is not None

    @classmethod
    def today(cls, content: dict[str, Any]) -> dict[str, Any]:
        """Files of version 1 kept neither units nor records of the model: it is in Å and TPa."""
        if content.get("version") != 1:
            return content
        warnings.warn("it names no units: taken as Å and TPa", stacklevel=3)
        names = {"lam": "lambda", "mu": "mu", "alpha": "alpha", "D": "D", "horizon": "horizon"}
        if missing := [key for key in names.values() if key not in content]:
            raise InputError(f"missing keys: {', '.join(missing)}")
        model = Model(**{name: content.pop(key) for name, key in names.items()})
        return content | {"version": cls.VERSION, "model": model.content()}


def positive_kernel(model: Model, horizon: float) -> Model:
    """λ and μ of a model with K = 1/r, which has them exactly on every lattice (C7).

    This is how a model whose influence function changes sign goes to fracture.
    """
    return Model(
        model.lam, model.mu, 1.0, np.ones(1), horizon, units=model.units, dimension=model.dimension
    )


def continuum_stretch(model: Model, toughness: float) -> float:
    """s₀ of the continuum for a toughness G_c (theory.md, C5, V5), N. Trask and others 2019.

    In three dimensions G_c is energy over the area of the crack. λ = μ is the bond-based solid.
    """
    lam, mu = model.lam, model.mu
    if model.dimension == 3:
        unit = (3 * mu + (3 / 4) ** 4 * (lam - mu)) * model.horizon
    else:
        unit = (6 * mu / np.pi + 16 / (9 * np.pi**2) * (lam - mu)) * model.horizon
    return float(np.sqrt(toughness / unit))
