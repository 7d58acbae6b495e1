"""Units of length and stress by name."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, TypeAlias

from warp_peri.errors import InputError

LENGTHS = {"angstrom": 1.0, "nm": 10.0, "um": 1e4, "mm": 1e7, "m": 1e10}
"""Units of length [Å]."""
STRESSES = {
    "TPa": 1.0,
    "GPa": 1e-3,
    "MPa": 1e-6,
    "bar": 1e-7,
    "Pa": 1e-12,
    "eV/angstrom^3": 0.1602176634,
}
"""Units of stress [TPa]."""
EV_IN_TPA = STRESSES["eV/angstrom^3"]
REDUCED = ("sigma", "epsilon/sigma^3")
"""Of Lennard-Jones and other model potentials: no factor leads from them to metres and pascals."""
SYMBOLS = {"angstrom": "Å", "um": "µm", "eV/angstrom^3": "eV/Å³"}
"""How units are printed, where that is not by name."""
SYMBOLS |= {"sigma": "σ", "epsilon/sigma^3": "ε/σ³"}
ATOMIC = ("TPa", "eV/angstrom^3", "bar")
"""Units of stress in which codes of atoms compute; their moduli are printed in GPa."""
USUAL_HORIZON = 16.0
"""A horizon [Å] that the numbers of searches suit."""
SYSTEMS: dict[str, Units] = {
    "ase": ("angstrom", "eV/angstrom^3"),
    "metal": ("angstrom", "bar"),
    "si": ("m", "Pa"),
    "reduced": REDUCED,
}
"""Units of length and stress that go by one name: of ASE, of LAMMPS metal, of the SI, none."""
Units: TypeAlias = tuple[str, str]
"""Names of a unit of length and of one of stress."""
USUAL: Units = ("angstrom", "TPa")
"""What everything is in unless something else is said."""


def check_units(units: Any) -> Units:
    """Units as a pair of known names, from a pair or a key of SYSTEMS; else InputError."""
    if isinstance(units, str) and units in SYSTEMS:
        return SYSTEMS[units]
    try:
        length, stress = [units] if isinstance(units, str) else list(units)
    except (TypeError, ValueError):
        raise InputError(
            f"units: expected (length, stress), or {', '.join(SYSTEMS)}, got {units!r:.60}"
        ) from None
    if (length, stress) == REDUCED:
        return REDUCED
    for key, name, known in (("length_unit", length, LENGTHS), ("stress_unit", stress, STRESSES)):
        if not (isinstance(name, str) and name in known):
            raise InputError(
                f"{key}: expected one of {', '.join(known)}, or {' and '.join(REDUCED)} together, "
                f"got {name!r:.60}"
            )
    return length, stress


def symbols(units: Units) -> tuple[str, str]:
    """Printed symbols of length and stress: "Å", "TPa"."""
    length, stress = units
    return SYMBOLS.get(length, length), SYMBOLS.get(stress, stress)


def shown_moduli(units: Units, values: Iterable[float]) -> str:
    """Text of moduli: in GPa from atomic units, else in their own unit (GPa, MPa, Pa, reduced)."""
    unit = units[1]
    factor, shown = (STRESSES[unit] * 1e3, "GPa") if unit in ATOMIC else (1.0, symbols(units)[1])
    return ", ".join(f"{factor * value:.4g}" for value in values) + f" {shown}"


def factors(have: Units, want: Units) -> tuple[float, float]:
    """Factors from the units `have` to the units `want` for lengths and stresses; InputError for
    unknown units, and from reduced units to others."""
    have, want = check_units(have), check_units(want)
    if have == want:
        return 1.0, 1.0
    if REDUCED in (have, want):
        raise InputError(
            f"units: no factor leads from {' and '.join(have)} to {' and '.join(want)}; reduced "
            "units need σ and ε: scale the numbers with them first"
        )
    return LENGTHS[have[0]] / LENGTHS[want[0]], STRESSES[have[1]] / STRESSES[want[1]]


def check_same(model: Units, points: Units) -> None:
    """Raise InputError where a model and points are in different units."""
    if model != points:
        theirs = f"{points[0]!r}, {points[1]!r}"
        raise InputError(
            f"units: the model is in {' and '.join(model)}, the points are in "
            f"{' and '.join(points)}; model.in_units(({theirs})) converts"
        )


def search_length(units: Units, horizon: float) -> float:
    """Unit of length that a search works in, in that of `units`, for a horizon in it. Starts,
    steps, bounds and tolerances of a search are numbers. It works in Å whatever the data are in, so
    that it finds the same in any units; of horizons of another size than usual in powers of 2⁶ of
    it, to the bits of these."""
    known = LENGTHS.get(units[0], 1.0)
    return math.ldexp(1.0, 6 * round(math.log2(horizon * known / USUAL_HORIZON) / 6)) / known
