"""Data sets: displacement and load fields on points, in HDF5 (`warp_peri.dataset`, version 1)."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import h5py
import numpy as np
from numpy.typing import ArrayLike

from warp_peri.errors import InputError
from warp_peri.files import plain, whole_file

FORMAT, VERSION = "warp_peri.dataset", 1
UNITS = {"length_unit": "angstrom", "stress_unit": "TPa"}
_FIELDS = ("x", "u", "b", "interior")


@dataclass(frozen=True, eq=False)
class PointSet:
    """Samples of one body on one set of points.

    Attributes:
        x: positions [Å], shape [N, 2].
        interior: nodes where equilibrium is asked and displacement unknown in a solve, [N] bool;
            the others are the collar, whose displacement is data.
        spacing: lattice spacing [Å]; 0 for scattered points.
        u: displacements [Å], shape [S, N, 2].
        b: body force densities [TPa/Å], shape [S, N, 2].
        samples: optional per-sample arrays by name, each with first dimension S.

    Raises InputError naming the first field of wrong shape or with a value that is not finite.
    """

    x: np.ndarray
    interior: np.ndarray
    spacing: float
    u: np.ndarray = field(default_factory=lambda: np.empty((0, 0, 2)))
    b: np.ndarray = field(default_factory=lambda: np.empty((0, 0, 2)))
    samples: dict[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, kind in (("x", float), ("interior", bool), ("u", float), ("b", float)):
            object.__setattr__(self, name, _array(name, getattr(self, name), kind))
        if self.x.ndim != 2 or self.x.shape[1] != 2 or len(self.x) == 0:
            raise InputError(f"x: expected shape [N, 2] with N > 0, got {list(self.x.shape)}")
        n = len(self.x)
        if self.u.shape == (0, 0, 2):
            object.__setattr__(self, "u", np.empty((0, n, 2)))
        if self.b.shape == (0, 0, 2):
            object.__setattr__(self, "b", np.empty((len(self.u), n, 2)))
        if self.interior.shape != (n,):
            raise InputError(f"interior: expected shape [{n}], got {list(self.interior.shape)}")
        if not self.interior.any():
            raise InputError("interior: expected at least one interior node, got none")
        for name in ("u", "b"):
            shape = getattr(self, name).shape
            if len(shape) != 3 or shape[1:] != (n, 2) or shape[0] != len(self.u):
                raise InputError(
                    f"{name}: expected shape [{len(self.u)}, {n}, 2], got {list(shape)}"
                )
        if not (_is_number(self.spacing) and np.isfinite(self.spacing) and self.spacing >= 0):
            raise InputError(f"spacing: expected a number ≥ 0, got {self.spacing!r}")
        for name, value in self.samples.items():
            if name in _FIELDS or not _is_name(name):
                raise InputError(f"samples: {name!r} cannot be the name of an array")
            if np.ndim(value) == 0 or len(value) != len(self.u):
                raise InputError(f"{name}: expected one entry for each of {len(self.u)} samples")

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.u)


@dataclass(frozen=True, eq=False)
class Dataset:
    """Named point sets of one material.

    Attributes:
        sets: point sets by name, e.g. train, val, test.
        thickness: of the sheet [Å].
        density: mass per volume [kg/m³].
        provenance: how the data came to be; plain JSON values.

    Raises InputError for a data set without point sets, or a thickness or density not > 0.
    """

    sets: dict[str, PointSet]
    thickness: float
    density: float
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("thickness", "density"):
            value = getattr(self, name)
            if not (_is_number(value) and np.isfinite(value) and value > 0):
                raise InputError(f"{name}: expected a number > 0, got {value!r}")
        if not self.sets:
            raise InputError("expected at least one point set, got none")
        for name in self.sets:
            if not _is_name(name):
                raise InputError(f"sets: {name!r} cannot be the name of a set")

    def __getitem__(self, name: str) -> PointSet:
        """The point set called `name`; InputError lists what there is when it is missing."""
        if name not in self.sets:
            raise InputError(f"no set '{name}' in the data; it has {', '.join(self.sets)}")
        return self.sets[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.sets)


def save_dataset(path: str | os.PathLike[str], dataset: Dataset) -> None:
    """Write `dataset` to an HDF5 file, whole or not at all.

    Raises InputError for a provenance that is not JSON.
    """
    try:
        provenance = json.dumps(plain(dataset.provenance), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"provenance: expected plain JSON values ({error})") from None
    with whole_file(path) as temporary, h5py.File(temporary, "w") as file:
        file.attrs.update({"format": FORMAT, "version": VERSION, **UNITS})
        file.attrs["thickness"] = float(dataset.thickness)
        file.attrs["density"] = float(dataset.density)
        file.attrs["provenance"] = provenance
        for name, points in dataset.sets.items():
            group = file.create_group(name)
            group.attrs["spacing"] = float(points.spacing)
            for key in _FIELDS:
                group[key] = getattr(points, key)
            for key, value in points.samples.items():
                value = np.asarray(value)
                text = value.dtype.kind in "US"
                group[key] = value.astype(h5py.string_dtype()) if text else value


def load_dataset(path: str | os.PathLike[str]) -> Dataset:
    """Read a data set.

    Raises InputError naming what is wrong: not an HDF5 file, another format or version, other
    units, a missing or misshapen array, a value that is not finite.
    """
    try:
        with h5py.File(path, "r") as file:
            return _read(file)
    except FileNotFoundError:
        raise InputError(f"{path}: no such data set") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (OSError, RuntimeError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: not a readable HDF5 data set ({error})") from None


def _read(file: h5py.File) -> Dataset:
    for key, expected in {"format": FORMAT, "version": VERSION, **UNITS}.items():
        found = file.attrs.get(key)
        if np.shape(found) != () or found != expected:
            raise InputError(f"{key}: expected {expected!r}, got {found!r}")
    thickness, density = (_attribute(file.attrs, key) for key in ("thickness", "density"))
    try:
        provenance = json.loads(file.attrs.get("provenance", "{}"))
    except (TypeError, ValueError) as error:
        raise InputError(f"provenance: expected JSON ({error})") from None
    if not isinstance(provenance, dict):
        raise InputError(f"provenance: expected a JSON object, got {type(provenance).__name__}")
    sets = {}
    for name, group in file.items():
        if not isinstance(group, h5py.Group):
            raise InputError(f"{name}: expected a group (one per point set)")
        try:
            sets[name] = _read_points(group)
        except InputError as error:
            raise InputError(f"set '{name}': {error}") from None
    return Dataset(sets, thickness, density, provenance)


def _read_points(group: h5py.Group) -> PointSet:
    missing = [key for key in _FIELDS if not isinstance(group.get(key), h5py.Dataset)]
    if missing:
        raise InputError(f"arrays missing: {', '.join(missing)}")
    if group["interior"].dtype != bool:
        raise InputError(f"interior: expected bool, got {group['interior'].dtype}")
    extra = {}
    for key in set(group) - set(_FIELDS):
        item = group.get(key)
        if not isinstance(item, h5py.Dataset):
            raise InputError(f"{key}: expected an array")
        text = h5py.check_string_dtype(item.dtype) is not None
        extra[key] = item.asstr()[:] if text else item[()]
    return PointSet(
        **{key: group[key][()] for key in _FIELDS},
        spacing=_attribute(group.attrs, "spacing"),
        samples=dict(sorted(extra.items())),
    )


def _attribute(attributes: Mapping[str, Any], key: str) -> float:
    if key not in attributes:
        raise InputError(f"attribute '{key}' is missing")
    if not _is_number(attributes[key]):
        raise InputError(f"{key}: expected a number, got {attributes[key]!r}")
    return float(attributes[key])


def _is_number(value: Any) -> bool:
    return np.ndim(value) == 0 and np.asarray(value).dtype.kind in "fiu"


def _is_name(name: Any) -> bool:
    """Whether HDF5 takes it as the name of one thing."""
    return isinstance(name, str) and name not in ("", ".") and "/" not in name


def _array(name: str, value: ArrayLike, kind: type) -> np.ndarray:
    try:
        value = np.asarray(value)
    except ValueError as error:
        raise InputError(f"{name}: expected an array ({error})") from None
    wanted = "b" if kind is bool else "fiu"
    if value.dtype.kind not in wanted:
        raise InputError(f"{name}: expected {kind.__name__} values, got {value.dtype}")
    value = np.require(value, np.float64 if kind is float else bool, ["C", "W"])
    if kind is float and not np.isfinite(value).all():
        bad = np.argwhere(~np.isfinite(value))[0].tolist()
        raise InputError(f"{name}: expected finite values, got {value[tuple(bad)]} at index {bad}")
    return value
