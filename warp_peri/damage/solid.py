"""A brittle solid: a model whose bonds may break, its density and when they do (theory.md, C5–C8).

Any consistent units, length and stress as the model names them: SI, or Å, ps and TPa with the
density in TPa ps²/Å² (1 kg/m³ = 1e-8 of them).
"""

from __future__ import annotations

import json
import os
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from warp_peri.damage.stability import breaking_time_step
from warp_peri.errors import InputError
from warp_peri.files.atomic import write_json
from warp_peri.models.lps import Model, model_content, model_from
from warp_peri.points.families import bond_classes
from warp_peri.points.unit_names import Units, factors

FORMAT, VERSION = "warp_peri.brittle_solid", 2
CRITERIA = ("toughness", "critical_stretch", "critical_energy")


@dataclass(frozen=True, eq=False)
class BrittleSolid:
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
    density: float
    toughness: float | None = None
    critical_stretch: float | None = None
    critical_energy: float | None = None
    tension_only: bool = True

    def __post_init__(self) -> None:
        given = [name for name in CRITERIA if getattr(self, name) is not None]
        if len(given) != 1:
            names = ", ".join(given) or "none"
            raise InputError(f"criterion: expected one of {', '.join(CRITERIA)}, got {names}")
        for name in ("density", *given):
            value = getattr(self, name)
            if not (isinstance(value, (int, float, np.number)) and 0 < value < np.inf):
                raise InputError(f"{name}: expected a number > 0, got {value!r}")

    @property
    def linear(self) -> Model:
        """The solid before anything breaks."""
        return self.model

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return self.model.dimension

    @property
    def horizon(self) -> float:
        """δ [length]."""
        return self.model.horizon

    @property
    def units(self) -> Units:
        """Names of the units of length and stress."""
        return self.model.units

    def longest_step(self, spacing: float) -> float:
        """Time step on a lattice that is stable whatever breaks (theory.md, C9)."""
        classes = bond_classes(spacing, self.model.horizon, dimension=self.dimension)
        return breaking_time_step(self.model, classes, self.density)

    @property
    def by_energy(self) -> bool:
        """Whether bonds break by their energy instead of their stretch."""
        return self.critical_energy is not None

    def in_units(self, units: Units) -> BrittleSolid:
        """The same solid in other units; that of time stays, so that ρ is a stress over length²."""
        length, stress = factors(self.units, units)

        def times(value: float | None, factor: float) -> float | None:
            return None if value is None else value * factor

        return replace(
            self,
            model=self.model.in_units(units),
            density=self.density * stress / length**2,
            toughness=times(self.toughness, stress * length),
            critical_energy=times(self.critical_energy, stress / length**self.dimension),
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the solid as JSON, whole or not at all: the model with its units and records."""
        write_json(path, self.content())

    def content(self) -> dict[str, Any]:
        """What the file of the solid holds."""
        numbers = {name: getattr(self, name) for name in ("density", *CRITERIA, "tension_only")}
        return {"format": FORMAT, "version": VERSION, "model": model_content(self.model), **numbers}


def load_brittle_solid(path: str | os.PathLike[str]) -> BrittleSolid:
    """Read what `BrittleSolid.save` wrote; InputError naming what is wrong.

    Files of version 1 kept neither the units nor the records of the model: Å and TPa are taken,
    with a warning.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        if content["format"] != FORMAT or content["version"] not in (1, VERSION):
            raise InputError(f"expected {FORMAT} version {VERSION}")
        if content["version"] == VERSION:
            model = model_from(content["model"])
        else:
            warnings.warn(f"{path}: it names no units: taken as Å and TPa", stacklevel=2)
            names = ("lambda", "mu", "alpha", "D", "horizon")
            model = Model(*(content[name] for name in names))
        if not isinstance(content["tension_only"], bool):
            raise InputError(f"tension_only: expected a bool, got {content['tension_only']!r:.50}")
        criteria = {name: content[name] for name in CRITERIA}
        return BrittleSolid(
            model, content["density"], **criteria, tension_only=content["tension_only"]
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: not a readable brittle solid ({error})") from None


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
