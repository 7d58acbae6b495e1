"""A neural operator in a file: JSON that says what it is, with the weights in base64."""

from __future__ import annotations

import binascii
import hashlib
import os
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import torch

from warp_peri.errors import InputError
from warp_peri.files.atomic import write_json
from warp_peri.models.lps import LARGEST_FILE, content_hash, read_content
from warp_peri.neural.material import Operator
from warp_peri.points.unit_names import Units

FORMAT, VERSION = "warp_peri.neural", 2
PRECISIONS = ("float16", "float32", "float64")
FITS = LARGEST_FILE * 3 // 4 - 2**16
"""Bytes of weights whose file is read again."""


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
    _check_finite(path, written)
    size = sum(part.nbytes for part in written.values())
    if size > FITS:
        raise InputError(f"{path}: expected at most {FITS} bytes of weights, got {size}: precision")
    content = {"format": FORMAT, "version": VERSION, **material.content(), "precision": precision}
    content["weights"] = {
        key: binascii.b2a_base64(part.tobytes(), newline=False).decode()
        for key, part in written.items()
    }
    write_json(path, content | {"sha256": content_hash(content)})


def load(path: str | os.PathLike[str], *, units: Units | None = None) -> Operator:
    """Read a material, in float64; in other units where they are given.

    Files of version 1, whose weights lie beside them in HDF5, are read too.

    Raises InputError for what is no such file, for weights that are missing, of other shapes, not
    finite, or not those that were written.
    """
    path = Path(path)
    content = read_content(path)
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise InputError(f"{path}: expected a file of format {FORMAT}")
    version = content.get("version")
    if version not in (1, VERSION):
        raise InputError(f"{path}: expected version {VERSION}, got {version!r:.40}")
    if version == VERSION and content.get("sha256") != content_hash(content):
        raise InputError(f"{path}: sha256: the contents are not what was written")
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
        wanted = {key: tuple(part.shape) for key, part in material.state_dict().items()}
        weights = (_beside if version == 1 else _inside)(path, content, wanted)
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, OSError, AttributeError) as error:
        raise InputError(f"{path}: not a readable neural operator ({error!r:.400})") from None
    if not np.isfinite(material.scale):
        raise InputError(f"{path}: expected a finite scale")
    _check_finite(path, weights)
    material.load_state_dict({k: torch.as_tensor(v.astype(float)) for k, v in weights.items()})
    return material if units is None else material.in_units(units)


def _inside(path: Path, content: dict[str, Any], wanted: dict[str, Any]) -> dict[str, np.ndarray]:
    """The weights of a file of version 2."""
    dtype = np.dtype(PRECISIONS[PRECISIONS.index(content["precision"])]).newbyteorder("<")
    return {
        key: np.frombuffer(binascii.a2b_base64(content["weights"][key]), dtype).reshape(shape)
        for key, shape in wanted.items()
    }


def _beside(path: Path, content: dict[str, Any], wanted: dict[str, Any]) -> dict[str, np.ndarray]:
    """The weights of a file of version 1."""
    name, found, whole = str(content["weights"]), {}, hashlib.sha256()
    if Path(name).name != name:
        raise InputError(f"{path}: expected weights in a file beside it")
    with h5py.File(path.with_name(name), "r") as file:
        for key, shape in sorted(wanted.items()):
            stored = file[key]
            if stored.shape != shape or stored.dtype.name not in PRECISIONS:
                raise InputError(
                    f"{path}: {key}: expected shape {[*shape]}, got {[*stored.shape]} of "
                    f"{stored.dtype}"
                )
            found[key] = np.asarray(stored[:])
            whole.update(key.encode() + np.ascontiguousarray(found[key]).tobytes())
    if whole.hexdigest() != content["hash"]:
        raise InputError(f"{path.with_name(name)}: these are not the weights of {path.name}")
    return found


def _check_finite(path: Path, weights: dict[str, np.ndarray]) -> None:
    for key, part in weights.items():
        if not np.isfinite(part).all():
            raise InputError(f"{path}: {key}: expected finite numbers")
