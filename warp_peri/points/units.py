"""Data in other units."""

from __future__ import annotations

import dataclasses
from typing import Any

from warp_peri.points.dataset import Dataset
from warp_peri.points.samples import Samples
from warp_peri.points.unit_names import Units, check_units, factors


def converted(dataset: Dataset, want: Units) -> Dataset:
    """The data set with its numbers in other units.

    x, u, spacings, boxes and the thickness are lengths, b a stress over a length, wave vectors one
    over a length; other arrays and the mass density stay as they are.

    Raises InputError for units that are not known, or that no factor leads to.
    """
    want = check_units(want)
    if dataset.units == want:
        return dataset
    length, stress = factors(dataset.units, want)
    sets = {name: in_units_of(scaled(dataset[name], length, stress), want) for name in dataset}
    return dataclasses.replace(dataset, sets=sets, thickness=dataset.thickness * length)


def in_units_of(samples: Samples, units: Units) -> Samples:
    """The samples, whose numbers are in these units, with their names."""
    points = dataclasses.replace(samples.points, units=check_units(units))
    return dataclasses.replace(samples, points=points)


def scaled(samples: Samples, length: float, stress: float) -> Samples:
    """Samples with every length and every stress multiplied by a factor."""
    if length == stress == 1.0:
        return samples
    points = samples.points
    box = None if points.box is None else tuple(side * length for side in points.box)
    moved: dict[str, Any] = {"x": points.x * length, "spacing": points.spacing * length, "box": box}
    arrays = {
        key: value / length if key == "wave_vector" else value
        for key, value in samples.arrays.items()
    }
    b = None if samples.b is None else samples.b * (stress / length)
    points = dataclasses.replace(points, **moved)
    return dataclasses.replace(samples, points=points, u=samples.u * length, b=b, arrays=arrays)
