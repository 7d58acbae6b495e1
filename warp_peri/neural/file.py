"""A neural operator in a file: JSON that says what it is, with the weights in base64."""

from __future__ import annotations

import binascii
import hashlib
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import h5py
import numpy as np
import torch

from warp_peri.core import record
from warp_peri.core.quantity import Length, Positive, Quantity
from warp_peri.errors import InputError
from warp_peri.files.atomic import write_json
from warp_peri.neural.material import Operator
from warp_peri.points.unit_names import USUAL, Units

PRECISIONS = ("float16", "float32", "float64")
FITS = record.LARGEST_FILE * 3 // 4 - 2**16
"""Bytes of weights whose file is read again."""


@dataclass(frozen=True, eq=False, repr=False)
class NeuralFile(record.Record, format="warp_peri.neural", version=2):
    """What a file says of an operator; in version 1 the weights were a file beside it."""

    horizon: Length
    influence: tuple[int, int]
    state: tuple[int, int]
    anisotropic: bool
    proportional: bool
    strain: Positive
    scale: float
    provenance: dict[str, Any] = field(default_factory=dict)
    precision: Annotated[str, Quantity(later=True)] = "float64"
    weights: Any = None
    hash: Annotated[str, Quantity(omit=True, later=True)] = ""
    units: Units = USUAL

    @classmethod
    def today(cls, content: dict[str, Any]) -> dict[str, Any]:
        return content | {"version": 2} if content.get("version") == 1 else content

    def _read_from(self, path: Path | None) -> Operator:  # type: ignore[override]
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
        wanted = {key: tuple(part.shape) for key, part in material.state_dict().items()}
        try:
            found = self._inside(wanted) if not self.hash else self._beside(path, wanted)
        except (OSError, KeyError, AttributeError, TypeError, ValueError) as error:
            raise InputError(f"weights: not those of a neural operator ({error!r:.200})") from None
        _check_finite(found)
        material.load_state_dict({k: torch.as_tensor(v.astype(float)) for k, v in found.items()})
        return material

    def _inside(self, wanted: dict[str, Any]) -> dict[str, np.ndarray]:
        """The weights of a file of version 2."""
        dtype = np.dtype(PRECISIONS[PRECISIONS.index(self.precision)]).newbyteorder("<")
        return {
            key: np.frombuffer(binascii.a2b_base64(self.weights[key]), dtype).reshape(shape)
            for key, shape in wanted.items()
        }

    def _beside(self, path: Path | None, wanted: dict[str, Any]) -> dict[str, np.ndarray]:
        """The weights of a file of version 1."""
        name, found, whole = str(self.weights), {}, hashlib.sha256()
        if path is None or Path(name).name != name:
            raise InputError("weights: expected a file beside it")
        with h5py.File(path.with_name(name), "r") as file:
            for key, shape in sorted(wanted.items()):
                stored = file[key]
                if stored.shape != shape or stored.dtype.name not in PRECISIONS:
                    raise InputError(
                        f"weights: {key}: expected shape {[*shape]}, got {[*stored.shape]} of "
                        f"{stored.dtype}"
                    )
                found[key] = np.asarray(stored[:])
                whole.update(key.encode() + np.ascontiguousarray(found[key]).tobytes())
        if whole.hexdigest() != self.hash:
            raise InputError(f"{name}: these are not the weights of it")
        return found


def save(material: Operator, path: str | os.PathLike[str], *, precision: str | None = None) -> None:
    """Write one JSON file, whole or not at all.

    Args:
        material: to save.
        path: ends in .json.
        precision: of the weights in the file: "float16", "float32" or "float64"; the material's own
            where none is given.

    Raises InputError for another ending or precision, and for weights that are not finite in it or
    too many for a file.
    """
    path = Path(path)
    if path.suffix != ".json":
        raise InputError(f"{path}: expected a name that ends in .json")
    weights = {key: part.detach().numpy() for key, part in material.state_dict().items()}
    precision = precision or next(iter(weights.values())).dtype.name
    if precision not in PRECISIONS:
        raise InputError(f"precision: expected one of {PRECISIONS}, got {precision!r}")
    dtype = np.dtype(precision).newbyteorder("<")
    written = {key: part.astype(dtype) for key, part in weights.items()}
    _check_finite(written)
    size = sum(part.nbytes for part in written.values())
    if size > FITS:
        raise InputError(f"{path}: expected at most {FITS} bytes of weights, got {size}: precision")
    coded = {
        key: binascii.b2a_base64(part.tobytes(), newline=False).decode()
        for key, part in written.items()
    }
    own = material.content()
    units = (own.pop("length_unit"), own.pop("stress_unit"))
    said = NeuralFile(**own, units=units, precision=precision, weights=coded)
    write_json(path, said.content())


def load(path: str | os.PathLike[str], *, units: Units | None = None) -> Operator:
    """Read a material, in float64; in other units where they are given.

    Files of version 1, whose weights lie beside them in HDF5, are read too.

    Raises InputError for what is no such file, for weights that are missing, of other shapes, not
    finite, or not those that were written.
    """
    material: Operator = record.load(path)
    return material if units is None else material.in_units(units)


def _check_finite(weights: dict[str, np.ndarray]) -> None:
    for key, part in weights.items():
        if not np.isfinite(part).all():
            raise InputError(f"weights: {key}: expected finite numbers")
