"""A neural operator in two files: a JSON that says what it is, and weights in HDF5 beside it."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import torch

from warp_peri.core import record
from warp_peri.core.quantity import Length, Positive
from warp_peri.errors import InputError
from warp_peri.files.atomic import whole_file, write_json
from warp_peri.neural.material import Operator
from warp_peri.points.unit_names import USUAL, Units

PRECISIONS = ("float16", "float32", "float64")


@dataclass(frozen=True, eq=False, repr=False)
class NeuralFile(record.Record, format="warp_peri.neural"):
    """What the JSON says of an operator; the weights, and a hash of them, are beside it."""

    horizon: Length
    influence: tuple[int, int]
    state: tuple[int, int]
    anisotropic: bool
    proportional: bool
    strain: Positive
    scale: float
    weights: str
    hash: str
    provenance: dict[str, Any] = field(default_factory=dict)
    units: Units = USUAL

    def _read_from(self, path: Path | None) -> Operator:  # type: ignore[override]
        if path is None or Path(self.weights).name != self.weights:
            raise InputError("weights: expected a file beside it")
        material = Operator(
            self.horizon,
            self.influence,
            self.state,
            anisotropic=self.anisotropic,
            proportional=self.proportional,
            strain=self.strain,
            units=self.units,
        ).double()
        material.scale, material.provenance = self.scale, self.provenance
        weights = _read(beside := path.with_name(self.weights), material.state_dict())
        if _hash(weights) != self.hash:
            raise InputError(f"{beside.name}: these are not the weights of it")
        material.load_state_dict({k: torch.as_tensor(v.astype(float)) for k, v in weights.items()})
        return material


def save(material: Operator, path: str | os.PathLike[str], *, precision: str | None = None) -> None:
    """Write `path` (JSON) and the weights beside it, under the same name with .h5.

    Args:
        material: to save.
        path: ends in .json.
        precision: of the weights in the file: "float16", "float32" or "float64"; the material's own
            where none is given.

    Raises InputError for another ending or precision.
    """
    path = Path(path)
    if path.suffix != ".json":
        raise InputError(f"{path}: expected a name that ends in .json")
    weights = {key: part.detach().numpy() for key, part in material.state_dict().items()}
    if precision is not None:
        if precision not in PRECISIONS:
            raise InputError(f"precision: expected one of {PRECISIONS}, got {precision!r}")
        weights = {key: part.astype(precision) for key, part in weights.items()}
    beside = path.with_suffix(".h5")
    with whole_file(beside) as temporary, h5py.File(temporary, "w") as file:
        for key, part in weights.items():
            file[key] = part
    own = material.content()
    units = (own.pop("length_unit"), own.pop("stress_unit"))
    said = NeuralFile(**own, units=units, weights=beside.name, hash=_hash(weights))
    write_json(path, said.content())


def load(path: str | os.PathLike[str], *, units: Units | None = None) -> Operator:
    """Read a material, in float64; in other units where they are given.

    Raises InputError for what is no such file, for weights that are missing, of other shapes, not
    finite, or not those that the JSON was written with.
    """
    material: Operator = record.load(path)
    return material if units is None else material.in_units(units)


def _read(path: Path, wanted: dict[str, Any]) -> dict[str, np.ndarray]:
    """The arrays of a file, of the shapes that are wanted."""
    found = {}
    try:
        with h5py.File(path, "r") as file:
            for key, part in wanted.items():
                stored = file[key]
                if stored.shape != tuple(part.shape) or stored.dtype.name not in PRECISIONS:
                    raise InputError(
                        f"{path}: {key}: expected shape {[*part.shape]}, got {[*stored.shape]} of "
                        f"{stored.dtype}"
                    )
                found[key] = np.asarray(stored[:])
                if not np.isfinite(found[key]).all():
                    raise InputError(f"{path}: {key}: expected finite numbers")
    except (OSError, KeyError, AttributeError) as error:
        raise InputError(f"{path}: expected the weights of a neural operator ({error})") from None
    return found


def _hash(weights: dict[str, np.ndarray]) -> str:
    """Of the weights, as they are written."""
    whole = hashlib.sha256()
    for key in sorted(weights):
        whole.update(key.encode() + np.ascontiguousarray(weights[key]).tobytes())
    return whole.hexdigest()
