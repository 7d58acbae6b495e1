"""A neural operator in a file: JSON that says what it is, with the weights in base64."""

from __future__ import annotations

import binascii
import hashlib
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import torch

from warp_peri.core import record
from warp_peri.core.record import Length, Positive
from warp_peri.errors import InputError
from warp_peri.neural.material import NeuralOperator
from warp_peri.points.unit_names import Units

PRECISIONS = ("float16", "float32", "float64")
FITS = record.LARGEST_FILE * 3 // 4 - 2**16
"""Bytes of weights whose file is read again."""


@dataclass(frozen=True, eq=False, repr=False)
class NeuralFile(record.Record, format="warp_peri.neural", version=2):
    """What a file says of an operator.

    Attributes:
        horizon, influence, state, anisotropic, proportional, strain, scale, units, provenance: of
            the operator.
        precision: of the weights.
        weights: by name, in base 64; of files of version 1 the name and hash of a file beside.
    """

    horizon: Length
    influence: tuple[int, int]
    state: tuple[int, int]
    anisotropic: bool
    proportional: bool
    strain: Positive
    scale: float
    provenance: dict[str, Any]
    precision: str
    weights: dict[str, str]
    units: Units
    ORDER = ("horizon", "influence", "state", "anisotropic", "proportional", "strain", "scale",
             *record.UNITS, "provenance", "precision", "weights")  # fmt: skip

    @classmethod
    def today(cls, content: dict[str, Any]) -> dict[str, Any]:
        """Files of version 1 have weights in HDF5 beside them, of any precision."""
        if content.get("version") != 1:
            return content
        beside = {"beside": content.get("weights"), "hash": content.pop("hash", None)}
        return content | {"version": 2, "precision": PRECISIONS[-1], "weights": beside}

    def _read_from(self, path: Path | None) -> NeuralOperator:  # type: ignore[override]
        material = NeuralOperator(
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
            if "beside" in self.weights:
                weights = _beside(path, self.weights, wanted)
            else:
                raw = {key: binascii.a2b_base64(self.weights[key]) for key in wanted}
                flat = {key: np.frombuffer(each, self.dtype) for key, each in raw.items()}
                weights = {key: flat[key].reshape(shape) for key, shape in wanted.items()}
        except InputError:
            raise
        except (KeyError, TypeError, ValueError, OSError, AttributeError) as error:
            raise InputError(f"not a readable neural operator ({error!r:.400})") from None
        _check_finite(weights)
        material.load_state_dict({k: torch.as_tensor(v.astype(float)) for k, v in weights.items()})
        return material

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of the weights; InputError for a precision that is none."""
        if self.precision not in PRECISIONS:
            raise InputError(f"precision: expected one of {PRECISIONS}, got {self.precision!r}")
        return np.dtype(self.precision).newbyteorder("<")


def save(
    material: NeuralOperator, path: str | os.PathLike[str], *, precision: str | None = None
) -> None:
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
    own = {key: value for key, value in material.content().items() if key not in record.UNITS}
    said = NeuralFile(**own, precision=precision, weights={}, units=material.units)
    written = {key: part.astype(said.dtype) for key, part in weights.items()}
    _check_finite(written)
    size = sum(part.nbytes for part in written.values())
    if size > FITS:
        raise InputError(f"{path}: expected at most {FITS} bytes of weights, got {size}: precision")
    coded = {
        key: binascii.b2a_base64(part.tobytes(), newline=False).decode()
        for key, part in written.items()
    }
    replace(said, weights=coded).save(path)


def load(path: str | os.PathLike[str], *, units: Units | None = None) -> NeuralOperator:
    """Read a material, in float64; in other units where they are given.

    Files of version 1, whose weights lie beside them in HDF5, are read too.

    Raises InputError for what is no such file, for weights that are missing, of other shapes, not
    finite, or not those that were written.
    """
    material: NeuralOperator = record.load(path)
    return material if units is None else material.in_units(units)


def _beside(
    path: Path | None, said: dict[str, Any], wanted: dict[str, Any]
) -> dict[str, np.ndarray]:
    """The weights of a file of version 1."""
    name, found, whole = str(said["beside"]), {}, hashlib.sha256()
    if path is None or Path(name).name != name:
        raise InputError("weights: expected a file beside it")
    with h5py.File(path.with_name(name), "r") as file:
        for key, shape in sorted(wanted.items()):
            stored = file[key]
            if stored.shape != shape or stored.dtype.name not in PRECISIONS:
                raise InputError(
                    f"{key}: expected shape {[*shape]}, got {[*stored.shape]} of {stored.dtype}"
                )
            found[key] = np.asarray(stored[:])
            whole.update(key.encode() + np.ascontiguousarray(found[key]).tobytes())
    if whole.hexdigest() != said["hash"]:
        raise InputError(f"{name}: these are not the weights of {path.name}")
    return found


def _check_finite(weights: dict[str, np.ndarray]) -> None:
    for key, part in weights.items():
        if not np.isfinite(part).all():
            raise InputError(f"{key}: expected finite numbers")
