"""Units that data files are written in, and what converts them."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeAlias

from warp_peri.errors import InputError
from warp_peri.points.dataset import Dataset
from warp_peri.points.samples import Samples

LENGTHS = {"angstrom": 1.0, "nm": 10.0, "um": 1e4, "mm": 1e7, "m": 1e10}
"""Units of length [Å]."""
STRESSES = {"TPa": 1.0, "GPa": 1e-3, "MPa": 1e-6, "Pa": 1e-12, "eV/angstrom^3": 0.1602176634}
"""Units of stress [TPa]."""

Units: TypeAlias = tuple[str, str]
"""Names of a unit of length and of one of stress."""
USUAL: Units = ("angstrom", "TPa")
"""What everything is in unless something else is said."""


def check_units(units: Any) -> Units:
    """The units, if they are known by name; InputError with the names that are."""
    try:
        length, stress = units
    except (TypeError, ValueError):
        raise InputError(f"units: expected (length, stress), got {units!r:.60}") from None
    for key, name, known in (
        ("length_unit", length, LENGTHS),
        ("stress_unit", stress, STRESSES),
    ):
        if not (isinstance(name, str) and name in known):
            raise InputError(f"{key}: expected one of {', '.join(known)}, got {name!r:.60}")
    return length, stress


def converted(dataset: Dataset, have: Units, want: Units) -> Dataset:
    """The data set with its numbers, which are in the units `have`, in the units `want`.

    x, u, spacings, boxes and the thickness are lengths, b a stress over a length, wave vectors one
    over a length; other arrays and the mass density stay as they are.

    Raises InputError for units that are not known.
    """
    have, want = check_units(have), check_units(want)
    if have == want:
        return dataset
    length = LENGTHS[have[0]] / LENGTHS[want[0]]
    stress = STRESSES[have[1]] / STRESSES[want[1]]
    sets = {name: scaled(dataset[name], length, stress) for name in dataset}
    return dataclasses.replace(dataset, sets=sets, thickness=dataset.thickness * length)


def scaled(samples: Samples, length: float, stress: float) -> Samples:
    """Samples with every length and every stress multiplied by a factor."""
    if length == stress == 1.0:
        return samples
    points = samples.points
    box = None if points.box is None else (points.box[0] * length, points.box[1] * length)
    moved: dict[str, Any] = {"x": points.x * length, "spacing": points.spacing * length, "box": box}
    arrays = {
        key: value / length if key == "wave_vector" else value
        for key, value in samples.arrays.items()
    }
    b = None if samples.b is None else samples.b * (stress / length)
    points = dataclasses.replace(points, **moved)
    return dataclasses.replace(samples, points=points, u=samples.u * length, b=b, arrays=arrays)
