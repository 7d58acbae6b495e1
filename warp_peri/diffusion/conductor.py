"""The law of nonlocal diffusion: an influence function and a conductivity (theory.md, D1)."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from warp_peri.errors import InputError
from warp_peri.files.atomic import write_json
from warp_peri.models.influence import ALPHA_BOUND, bernstein_basis
from warp_peri.points.unit_names import USUAL, Units, check_units, unit_content, units_of

FORMAT, VERSION = "warp_peri.conductor", 1


@dataclass(frozen=True, eq=False)
class Conductor:
    """Flux −κ∇φ spread over a ball, with K(r) = r^(−α) Σ_k D_k B_k,M(r/δ).

    Attributes:
        horizon: δ [length].
        conductivity: κ > 0, of where no field of it is given.
        alpha: exponent α < 3.
        D: Bernstein coefficients, shape [M + 1]; their common scale has no effect.
        units: names of the units of length and stress that it is in, as a Model's.

    Raises InputError naming the first number out of its range.
    """

    horizon: float
    conductivity: float = 1.0
    alpha: float = 1.0
    D: np.ndarray = field(default_factory=lambda: np.ones(1))
    units: Units = USUAL

    def __post_init__(self) -> None:
        object.__setattr__(self, "units", check_units(self.units))
        object.__setattr__(self, "D", np.atleast_1d(np.array(self.D, dtype=float)))
        for name in ("horizon", "conductivity"):
            value = getattr(self, name)
            if not (isinstance(value, (int, float, np.number)) and 0 < value < np.inf):
                raise InputError(f"{name}: expected a number > 0, got {value!r}")
        if not self.alpha < ALPHA_BOUND:
            raise InputError(f"alpha: expected less than {ALPHA_BOUND:g}, got {self.alpha}")
        if self.D.ndim != 1 or not np.isfinite(self.D).all() or not self.D.any():
            raise InputError("D: expected finite coefficients, one of them other than 0")

    def basis(self, r: np.ndarray) -> np.ndarray:
        """r^(−α) B_k(r/δ), shape [..., M + 1]."""
        table: np.ndarray = r[..., None] ** -self.alpha * bernstein_basis(
            r, self.horizon, len(self.D) - 1
        )
        return table

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the law as JSON, whole or not at all."""
        numbers = {name: getattr(self, name) for name in ("horizon", "conductivity", "alpha", "D")}
        write_json(
            path, {"format": FORMAT, "version": VERSION} | unit_content(self.units) | numbers
        )


def load_conductor(path: str | os.PathLike[str]) -> Conductor:
    """Read what `Conductor.save` wrote; InputError naming what is wrong.

    Of a file that names no units Å and TPa are taken, with a warning.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        if (content.pop("format"), content.pop("version")) != (FORMAT, VERSION):
            raise InputError(f"expected {FORMAT} version {VERSION}")
        units = units_of(content, f"{path}")
        return Conductor(**content, units=units)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: not a readable conductor ({error})") from None
