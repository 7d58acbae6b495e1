"""A neural operator in two files: a JSON that says what it is, and weights in HDF5 beside it."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import torch

from warp_peri.errors import InputError
from warp_peri.files.atomic import read_json, whole_file, write_json
from warp_peri.neural.material import Operator
from warp_peri.points.unit_names import Units

FORMAT, VERSION = "warp_peri.neural", 1
PRECISIONS = ("float16", "float32", "float64")


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
    content = {"format": FORMAT, "version": VERSION, **material.content()}
    write_json(path, content | {"weights": beside.name, "hash": _hash(weights)})


def load(path: str | os.PathLike[str], *, units: Units | None = None) -> Operator:
    """Read a material, in float64; in other units where they are given.

    Raises InputError for what is no such file, for weights that are missing, of other shapes, not
    finite, or not those that the JSON was written with.
    """
    path = Path(path)
    content = read_json(path, FORMAT, VERSION)
    try:
        material = Operator(
            float(content["horizon"]),
            tuple(content["influence"]),
            tuple(content["state"]),
            anisotropic=content["anisotropic"],
            proportional=content["proportional"],
            strain=float(content["strain"]),
            units=(content["length_unit"], content["stress_unit"]),
        ).double()
        material.scale = float(content["scale"])
        material.provenance = dict(content["provenance"])
        name, expected = str(content["weights"]), content["hash"]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: {error!r:.100}") from None
    if not (np.isfinite(material.scale) and Path(name).name == name):
        raise InputError(f"{path}: expected a finite scale and a file beside it")
    weights = _read(path.with_name(name), material.state_dict())
    if _hash(weights) != expected:
        raise InputError(f"{path.with_name(name)}: these are not the weights of {path.name}")
    material.load_state_dict({k: torch.as_tensor(v.astype(float)) for k, v in weights.items()})
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
