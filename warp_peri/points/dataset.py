"""Data sets: displacement and load fields on points, in HDF5 (`warp_peri.dataset`, version 1)."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import h5py
import numpy as np
from numpy.typing import ArrayLike

from warp_peri.errors import InputError
from warp_peri.files.whole import plain, whole_file

FORMAT, VERSION = "warp_peri.dataset", 1
UNITS = {"length_unit": "angstrom", "stress_unit": "TPa"}
_FIELDS = ("x", "u", "b", "interior")
MOST_PER_BYTE = 20
"""Arrays may hold so many times the bytes of the file (they may be compressed), and no more."""
SMALL = 2**20
"""Arrays up to so many bytes are read whatever the size of the file."""
LAYOUT = ("v110", "v110")


@dataclass(frozen=True, eq=False)
class PointSet:
    """Samples of one body on one set of points.

    Attributes:
        x: positions [Å], shape [N, 2].
        interior: nodes where equilibrium is asked and displacement unknown in a solve, [N] bool;
            the others are the collar, whose displacement is data.
        spacing: lattice spacing [Å]; 0 for scattered points.
        u: displacements [Å], shape [S, N, 2].
        b: body force densities [TPa/Å], shape [S, N, 2]; zero where none are given.
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
            object.__setattr__(self, "b", np.zeros((len(self.u), n, 2)))
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

    In a layout whose structure is checksummed (HDF5 1.10) and with strings of fixed length, since
    the HDF5 library can hang on a damaged heap of strings; the contents are hashed.

    Raises InputError for a provenance that is not JSON.
    """
    try:
        provenance = json.dumps(plain(dataset.provenance), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"provenance: expected plain JSON values ({error})") from None
    with whole_file(path) as temporary, h5py.File(temporary, "w", libver=LAYOUT) as file:
        for key, text in {"format": FORMAT, **UNITS}.items():
            file.attrs[key] = _fixed(text)
        file.attrs["version"] = VERSION
        file.attrs["thickness"] = float(dataset.thickness)
        file.attrs["density"] = float(dataset.density)
        file.attrs["provenance"] = _fixed(provenance)
        for name, points in dataset.sets.items():
            group = file.create_group(name)
            group.attrs["spacing"] = float(points.spacing)
            for key in _FIELDS:
                group[key] = getattr(points, key)
            for key, value in points.samples.items():
                value = np.asarray(value)
                group[key] = _fixed(value) if value.dtype.kind in "USO" else value
        file.attrs["sha256"] = _fixed(content_hash(dataset))


def _fixed(text: str | np.ndarray) -> np.ndarray:
    """Text as UTF-8 of fixed length."""
    encoded = np.char.encode(np.asarray(text).astype(str), "utf-8", "surrogatepass")
    return encoded.astype(h5py.string_dtype("utf-8", max(1, encoded.dtype.itemsize)))


def content_hash(dataset: Dataset) -> str:
    """SHA-256 of what a data set holds, whatever the layout of its file."""
    digest = hashlib.sha256()

    def add(*parts: Any) -> None:
        for part in parts:
            digest.update(f"{len(part)}:".encode() + part)

    add(json.dumps(plain(dataset.provenance), sort_keys=True).encode())
    add(repr((float(dataset.thickness), float(dataset.density))).encode())
    for name in sorted(dataset.sets):
        points = dataset.sets[name]
        add(name.encode(), repr(float(points.spacing)).encode())
        arrays = {key: getattr(points, key) for key in _FIELDS} | points.samples
        for key in sorted(arrays):
            value = np.asarray(arrays[key])
            if value.dtype.kind in "USO":
                kind, content = "text", [str(item).encode() for item in value.astype(str).flat]
            else:
                kind, content = value.dtype.str, [np.ascontiguousarray(value).tobytes()]
            add(key.encode(), repr((kind, value.shape)).encode(), *content)
    return digest.hexdigest()


def load_dataset(path: str | os.PathLike[str]) -> Dataset:
    """Read a data set.

    Nothing outside the file is read: links to other files and arrays kept in other files are
    refused. Sizes are checked before memory is taken, and the contents against the hash that
    save_dataset wrote; a file without one is taken as it is.

    Raises InputError naming what is wrong: not an HDF5 file, another format or version, other
    units, a missing or misshapen array, a value that is not finite, arrays larger than the file
    can hold, contents that are not what was written.
    """
    try:
        with h5py.File(path, "r") as file:
            _check_sizes(file, os.path.getsize(path))
            data = _read(file)
            expected = _text(file.attrs.get("sha256"))
        if expected is not None and not (
            isinstance(expected, str) and expected == content_hash(data)
        ):
            raise InputError("sha256: the contents are not what was written; the file is damaged")
        return data
    except FileNotFoundError:
        raise InputError(f"{path}: no such data set") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (OSError, RuntimeError, LookupError, TypeError, ValueError, MemoryError) as error:
        raise InputError(f"{path}: not a readable HDF5 data set ({error})") from None


def _check_sizes(file: h5py.File, size: int) -> None:
    """Refuse links, arrays kept elsewhere, and more bytes than the file can stand for."""
    allowed = max(SMALL, MOST_PER_BYTE * size)
    total = 0
    groups = {"": file} | {name: item for name, item in _members(file) if _is_group(item)}
    for at, group in groups.items():
        for name, item in _members(group):
            if not isinstance(item, h5py.Dataset):
                continue
            where = f"{at}/{name}".lstrip("/")
            if item.is_virtual or item.external:
                raise InputError(f"{where}: expected an array in the file itself")
            if item.dtype.kind not in "biufcSUO" or item.dtype.subdtype is not None:
                raise InputError(f"{where}: expected numbers or text, got {item.dtype}")
            if item.dtype.kind == "O" and h5py.check_string_dtype(item.dtype) is None:
                raise InputError(f"{where}: expected numbers or text, got {item.dtype}")
            chunk = int(np.prod(item.chunks or (0,), dtype=object)) * item.dtype.itemsize
            count = int(np.prod(item.shape or (), dtype=object)) * item.dtype.itemsize
            total += max(chunk, count)
            if total > allowed:
                raise InputError(
                    f"{where}: expected arrays of at most {allowed} bytes in a file of {size}, "
                    f"got more than {total}"
                )


def _members(group: h5py.Group) -> Iterator[tuple[str, Any]]:
    """What a group holds itself; links to elsewhere are named and not followed."""
    for name in group:
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            yield name, None
        else:
            yield name, group[name]


def _is_group(item: Any) -> bool:
    return isinstance(item, h5py.Group)


def _read(file: h5py.File) -> Dataset:
    for key, expected in {"format": FORMAT, "version": VERSION, **UNITS}.items():
        found = _text(file.attrs.get(key))
        if np.shape(found) != () or found != expected:
            raise InputError(f"{key}: expected {expected!r}, got {found!r}")
    thickness, density = (_attribute(file.attrs, key) for key in ("thickness", "density"))
    try:
        provenance = json.loads(_text(file.attrs.get("provenance", "{}")))
    except (TypeError, ValueError) as error:
        raise InputError(f"provenance: expected JSON ({error})") from None
    if not isinstance(provenance, dict):
        raise InputError(f"provenance: expected a JSON object, got {type(provenance).__name__}")
    sets = {}
    for name, group in _members(file):
        if not _is_group(group):
            raise InputError(f"{name}: expected a group (one per point set)")
        try:
            sets[name] = _read_points(group)
        except InputError as error:
            raise InputError(f"set '{name}': {error}") from None
    return Dataset(sets, thickness, density, provenance)


def _read_points(group: h5py.Group) -> PointSet:
    items = dict(_members(group))
    missing = [key for key in _FIELDS if not isinstance(items.get(key), h5py.Dataset)]
    if missing:
        raise InputError(f"arrays missing: {', '.join(missing)}")
    if group["interior"].dtype != bool:
        raise InputError(f"interior: expected bool, got {group['interior'].dtype}")
    extra = {}
    for key, item in items.items():
        if key in _FIELDS:
            continue
        if not isinstance(item, h5py.Dataset):
            raise InputError(f"{key}: expected an array")
        text = h5py.check_string_dtype(item.dtype) is not None
        extra[key] = item.asstr()[:] if text else item[()]
    return PointSet(
        **{key: group[key][()] for key in _FIELDS},
        spacing=_attribute(group.attrs, "spacing"),
        samples=dict(sorted(extra.items())),
    )


def _text(value: Any) -> Any:
    """An attribute that holds text as str, whatever its length; anything else as it is."""
    return value.decode("utf-8", "surrogatepass") if isinstance(value, bytes) else value


def _attribute(attributes: Mapping[str, Any], key: str) -> float:
    if key not in attributes:
        raise InputError(f"attribute '{key}' is missing")
    if not _is_number(attributes[key]):
        raise InputError(f"{key}: expected a number, got {_text(attributes[key])!r}")
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
