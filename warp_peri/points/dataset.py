"""Data sets: named samples with units, their HDF5 file, and loads to make them with."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import h5py
import numpy as np
from numpy import ndarray
from numpy.linalg import norm
from scipy.spatial import cKDTree

from warp_peri.errors import InputError, Rows, Shown, StrPath, Values, called, warn
from warp_peri.files.atomic import check_hdf5, check_regular, parsed, plain, whole_hdf5
from warp_peri.points.arguments import (
    USUAL,
    Count,
    Positive,
    Seed,
    Units,
    check_nodes,
    check_units,
    checked,
    factors,
    is_name,
    symbols,
    typed,
    within,
)
from warp_peri.points.points import FIELDS, PULL, SEEN, WAVE_VECTOR, Points, Samples, unit_vectors


@typed
@dataclass(frozen=True, eq=False, repr=False)
class Dataset(Shown):
    """Named sets of samples of one material.

    Attributes:
        sets: samples by name, e.g. train, val, test.
        thickness: of the sheet, in the sets' unit of length.
        density: mass per volume [kg/m³].
        provenance: how the data came to be; plain JSON values.

    Raises InputError for a data set without point sets, a thickness or density not > 0, and a
    provenance that is not JSON.

    >>> list(wp.Dataset({"train": samples}, thickness=3.35, density=2200.0).sets)
    ['train']
    """

    sets: dict[str, Samples]
    thickness: Positive
    density: Positive
    provenance: Values = field(default_factory=dict)

    def __post_init__(self) -> None:
        _written(self.provenance)
        if not self.sets:
            raise InputError("expected at least one point set, got none")
        for name, samples in self.sets.items():
            if not is_name(name):
                raise InputError(f"sets: {name!r} cannot be the name of a set")
            if not isinstance(samples, Samples):
                raise InputError(f"{name}: expected Samples, got {type(samples).__name__}")
        if len({samples.units for samples in self.sets.values()}) > 1:
            named = [f"{n} in {' and '.join(s.units)}" for n, s in self.sets.items()]
            raise InputError(f"units: expected the same for all sets, got {', '.join(named)}")

    @property
    def units(self) -> Units:
        """Names of the units of length and stress that all sets are in."""
        return next(iter(self.sets.values())).points.units

    def __getitem__(self, name: str) -> Samples:
        """The samples called `name`; InputError lists what there is when they are missing."""
        if name not in self.sets:
            raise InputError(f"no set '{name}' in the data; it has {', '.join(self.sets)}")
        return self.sets[name]

    def __len__(self) -> int:
        """Number of sets in the data set."""
        return len(self.sets)

    def keys(self) -> Iterable[str]:
        """Names of the sets, as of a mapping: dict(data) has the sets."""
        return self.sets.keys()

    def obvious(self, name: str | None = None) -> Samples:
        """The set called `name`, or the only one; InputError where neither is there."""
        if name in self.sets:
            return self.sets[str(name)]
        if len(self.sets) == 1:
            return next(iter(self.sets.values()))
        raise InputError(
            f"expected one set of samples, got a data set with {', '.join(self.sets)}; name one, "
            f"as data[{next(iter(self.sets))!r}]"
        )

    def __iter__(self) -> Iterator[str]:
        return iter(self.sets)

    def of_sheet(
        self, *, thickness: Positive | None = None, density: Positive | None = None
    ) -> Dataset:
        """The data set for another thickness or density of the sheet: forces and displacements are
        the same, loads per volume and pulls, and so fitted moduli, go as one over the thickness."""
        wide = thickness or self.thickness
        share = self.thickness / wide
        sets = {name: _scaled(one, one.points, 1.0, share) for name, one in self.sets.items()}
        return dataclasses.replace(self, sets=sets, thickness=wide, density=density or self.density)

    def summary(self) -> Values:
        """Units, sheet, origin and sets of the data as plain values."""
        sheet = {name: getattr(self, name) for name in ("units", "thickness", "density")}
        sets = {name: one.summary() for name, one in self.sets.items()}
        return {"format": "data", **sheet, "provenance": self.provenance, "sets": sets}

    def rows(self) -> Rows:
        rows = [
            ("thickness", f"{self.thickness:g} {symbols(self.units)[0]}"),
            ("density", f"{self.density:g} kg/m³"),
        ]
        for name, samples in self.sets.items():
            (_, count), (_, nodes), *_ = samples.rows()
            rows.append((name, f"{count} samples on nodes: {nodes}"))
        return rows


def in_units(samples: Samples, want: Units) -> Samples:
    """Convert x, u, b, spacing, box, wave vectors and pulls to other units; other arrays stay."""
    points, want = samples.points, check_units(want)
    if points.units == want:
        return samples
    length, stress = factors(points.units, want)
    box = None if points.box is None else tuple(side * length for side in points.box)
    x, spacing = points.x * length, points.spacing * length
    points = dataclasses.replace(points, x=x, spacing=spacing, box=box, units=want)
    return _scaled(samples, points, length, stress)


def _scaled(samples: Samples, points: Points, length: float, stress: float) -> Samples:
    """Samples on other points with lengths and stresses times factors; a pull may be NaN."""
    by = {WAVE_VECTOR: 1 / length, PULL: stress}
    arrays = {
        name: checked(name, value, read=False) * by[name] if name in by else value
        for name, value in samples.arrays.items()
    }
    b = None if samples.b is None else samples.b * (stress / length)
    return Samples(points, samples.u * length, b, arrays)


def largest_wave_number(points: Samples) -> float | None:
    """Largest |k| [1/Å] of the samples' loads; None on scattered points or without loads. Without
    wave vectors the root mean square of |k| over the spectrum of b, by differences (theory, M1)."""
    if WAVE_VECTOR in points.arrays:
        k = checked(WAVE_VECTOR, points.arrays[WAVE_VECTOR], shape=points.u[:, 0].shape)
        return float(norm(k, axis=-1).max(initial=0.0)) or None
    h = points.spacing
    if h == 0 or points.b is None:
        return None
    r, near = cKDTree(points.x).query(points.x, k=min(5, len(points.x)))
    whole = points.interior & (r <= 1.1 * h).all(axis=1) & (near.shape[1] == 5)
    near = near[whole, 1:]
    largest = 0.0
    for b in points.b:
        size = (b[whole] ** 2).sum()
        if size > 0:
            s = ((b[near] - b[whole, None]) ** 2).sum() / (2 * h**2 * size)
            # of all directions on average s = |k|² − |k|⁴ h²/16
            largest = max(largest, (1 - np.sqrt(max(1 - s * h**2 / 4, 0.0))) * 8 / h**2)
    return float(np.sqrt(largest)) or None


@typed
def mixed_waves(
    x: ndarray, box: tuple[float, ...] | ndarray, shortest: Positive, *, seed: Seed = 0
) -> ndarray:
    """Make a field of mixed waves Σ |k| e cos(k·x + φ) over |k| ≤ 2π/shortest (theory, Q11).

    Args:
        x: positions [length], shape [N, 2].
        box: periods along the axes [length].
        shortest: the shortest wave [length].
        seed: of the phases φ and the directions e.

    Returns [N, 2] without mean, to be scaled to what the atoms bear. Raises InputError for a wave
    that is longer than the periods.
    """
    random, box = np.random.default_rng(seed), checked("box", box, shape=(2,))
    x = checked("x", x, shape=("N", 2))
    if not (box > 0).all():
        raise InputError(f"box: expected periods > 0, got {box}")
    if not shortest <= box.max():
        raise InputError(f"shortest wave: expected one in a box of {box}, got {shortest!r:.40}")
    most = int(box.max() / shortest) + 1
    check_nodes("shortest wave", (most + 1, 2 * most + 1))
    field = np.zeros(x.shape)
    for number in np.ndindex(most + 1, 2 * most + 1):
        n = np.array(number) - (0, most)
        k = 2 * np.pi * n / box
        size = norm(k)
        if (n[0] == 0 and n[1] <= 0) or size > 2 * np.pi / shortest:  # −k is the same wave
            continue
        angle, phase = random.uniform(0, 2 * np.pi, 2)
        field += size * np.cos(x @ k + phase)[:, None] * unit_vectors(angle)
    return np.asarray(field - field.mean(axis=0))


@typed
def design_loads(
    points: Points | Samples, shortest_wave: Positive, *, number: Count = 2
) -> ndarray:
    """Make loads that a material is learned from in place of many single waves.

    One does for a fit whose moduli are held, two for one that finds them. Give each to the atoms
    and its reverse: what their answers have of even order then cancels, which few do not average.

    Args:
        points: of a periodic body, as Points.sheet or Points(…, box=…); atoms or nodes.
        shortest_wave: [length]; twice the horizon or less, and no shorter than four nodes apart.
        number: of loads.

    Returns loads without mean, shape [number, N, 2], largest vector 1: scale them to what is
    bearable. Raises InputError for points without a box, and a wave longer than it.
    """
    if points.box is None:
        raise InputError("points: expected a periodic body, with its box, for designed loads")
    check_nodes("number", (number, len(points.x)))
    fields = [mixed_waves(points.x, points.box, shortest_wave, seed=s) for s in range(number)]
    return np.stack([f / norm(f, axis=1).max() for f in fields])


FORMAT, VERSION = "warp_peri.dataset", 1
_NEEDED = ("x", "u", "interior")


def _written(provenance: Any) -> Any:
    """Provenance as JSON text; InputError where it is not JSON."""
    text = lambda: json.dumps(plain(provenance), allow_nan=False)  # noqa: E731
    return called("provenance: expected plain JSON values", text)


def seen_of(samples: Samples) -> ndarray:
    """Whether each node's displacement was measured, [S, N]: all where nothing says otherwise."""
    shape = samples.u.shape[:2]
    return checked(SEEN, samples.arrays.get(SEEN, np.ones(shape, bool)), bool, shape)


def warn_of_unseen(samples: Samples) -> None:
    """Warn where displacements that were filled in count as measured."""
    if not seen_of(samples).all():
        warn(
            "seen: displacements of nodes that were not seen count as measured here; frames "
            "without loads, learned by hyperelastic.Hyperelastic(…), leave them out"
        )


def sets_of(samples: Any, name: str = "samples") -> list[Samples]:
    """One set, several or none as a list; of a Dataset `train`, or its only set; InputError, which
    begins with the name, for anything else. Warns of nodes that were not seen."""
    if samples is None:
        return []
    if isinstance(samples, Dataset):
        samples = samples.obvious("train")
    sets = [samples] if isinstance(samples, Samples) else samples
    if not isinstance(sets, Sequence) or not all(isinstance(each, Samples) for each in sets):
        raise InputError(
            f"{name}: expected Samples (nodes with u and b), or a list of them, got "
            f"{type(samples).__name__}"
        )
    for each in sets:
        warn_of_unseen(each)
    return list(sets)


def save_dataset(path: StrPath, dataset: Dataset) -> None:
    """Write `dataset` to an HDF5 file, whole or not at all, with its units and a content hash. The
    layout's structure is checksummed (HDF5 1.10) and strings have fixed length, since the HDF5
    library can hang on a damaged heap of strings."""
    length, stress = dataset.units
    attributes = {
        "format": FORMAT,
        "version": VERSION,
        "length_unit": length,
        "stress_unit": stress,
        "thickness": float(dataset.thickness),
        "density": float(dataset.density),
        "provenance": _written(dataset.provenance),
        "sha256": content_hash(dataset),
    }
    with whole_hdf5(path, libver=("v110", "v110")) as file:
        _write(file.attrs, attributes)
        for name, samples in dataset.sets.items():
            group = file.create_group(name)
            _write(group.attrs, {key: getattr(samples, key) for key in ("spacing", "box", "axis")})
            _write(group, _arrays(samples))


def _write(place: Any, values: Values) -> None:
    """Write arrays or attributes that are not None into a file; text as UTF-8 of fixed length."""
    for key, value in values.items():
        if value is not None:
            value = np.asarray(value)
            if value.dtype.kind in "USO":
                value = np.char.encode(value.astype(str), "utf-8", "surrogatepass")
                value = value.astype(h5py.string_dtype("utf-8", max(1, value.dtype.itemsize)))
            place[key] = value


def _arrays(samples: Samples) -> Values:
    """All arrays of a set, by name in the file."""
    return {key: getattr(samples, key) for key in FIELDS} | samples.arrays


def content_hash(dataset: Dataset) -> str:
    """SHA-256 of a data set's contents, whatever the layout of its file."""
    digest = hashlib.sha256()

    def add(*parts: Any) -> None:
        for part in parts:
            digest.update(f"{len(part)}:".encode() + part)

    add(json.dumps(plain(dataset.provenance), sort_keys=True).encode())
    add(repr((float(dataset.thickness), float(dataset.density))).encode())
    if dataset.units != USUAL:
        add(*(name.encode() for name in dataset.units))
    for name in sorted(dataset.sets):
        points = dataset.sets[name]
        add(name.encode(), repr(float(points.spacing)).encode())
        if points.box is not None:
            add(repr(tuple(map(float, points.box))).encode())
        if points.axis is not None:
            add(b"axis", repr(points.axis).encode())
        arrays = {k: np.asarray(v) for k, v in _arrays(points).items() if v is not None}
        for key, value in sorted(arrays.items()):
            if value.dtype.kind in "USO":
                kind, content = "text", [str(item).encode() for item in value.astype(str).flat]
            else:
                kind, content = value.dtype.str, [np.ascontiguousarray(value).tobytes()]
            add(key.encode(), repr((kind, value.shape)).encode(), *content)
    return digest.hexdigest()


def load_dataset(path: StrPath, *, units: Units | None = None) -> Dataset:
    """Read a data set from an HDF5 file.

    A file that names no units is taken to be in Å and TPa, with a warning. With `units`, as
    ("angstrom", "TPa"), the numbers are converted; the mass density stays as it is. Nothing outside
    the file is read: links and arrays kept in other files are refused. Sizes are checked before
    memory is taken, and the contents against the hash, if there is one. Raises InputError naming
    what is wrong.
    """
    check_regular(path)
    try:
        with h5py.File(path, "r") as file:
            check_hdf5(file)
            data = _read(file)
        if units is None:
            return data
        thickness = data.thickness * factors(data.units, units)[0]
        sets = {name: in_units(samples, units) for name, samples in data.sets.items()}
        return dataclasses.replace(data, sets=sets, thickness=thickness)
    except FileNotFoundError:
        raise InputError(f"{path}: no such data set") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (OSError, RuntimeError, LookupError, TypeError, ValueError, MemoryError) as error:
        raise InputError(f"{path}: not a readable HDF5 data set ({error})") from None


def _read(file: h5py.File) -> Dataset:
    """Data set of an open file."""
    for key, expected in {"format": FORMAT, "version": VERSION}.items():
        value = _text(file.attrs.get(key))
        if np.shape(value) != () or value != expected:
            raise InputError(f"{key}: expected {expected!r}, got {value!r}")
    needed = ("format", "version", "thickness", "density")
    head = _attributes(file, needed, ("length_unit", "stress_unit", "provenance", "sha256"))
    named = head.get("length_unit"), head.get("stress_unit")
    if named == (None, None):
        warn("the file names no units: taken as Å and TPa")
        named = USUAL
    units = check_units(named)
    provenance = called("provenance: expected JSON", parsed, head.get("provenance", "{}"))
    sets = {name: within(f"set '{name}'", _read_points, one, units) for name, one in file.items()}
    data = Dataset(sets, head["thickness"], head["density"], provenance)
    mark = content_hash(data)
    if head.get("sha256", mark) != mark:
        raise InputError("sha256: the contents are not what was written; the file is damaged")
    return data


def _read_points(group: h5py.Group, units: Units) -> Samples:
    there = dict(group) if isinstance(group, h5py.Group) else {}
    if missing := [key for key in _NEEDED if not isinstance(there.get(key), h5py.Dataset)]:
        raise InputError(f"arrays missing: {', '.join(missing)}")
    arrays: Values = dict.fromkeys(FIELDS)
    for key, item in there.items():
        if not isinstance(item, h5py.Dataset):
            raise InputError(f"{key}: expected an array")
        arrays[key] = item.asstr()[:] if h5py.check_string_dtype(item.dtype) else item[()]
    x, u, b, interior, outside = (arrays.pop(key) for key in FIELDS)
    known = _attributes(group, ("spacing",), ("box", "axis"))
    return Samples(Points(x, interior, outside=outside, units=units, **known), u, b, arrays)


def _attributes(place: Any, needed: tuple[str, ...], more: tuple[str, ...]) -> Values:
    """Attributes by name; InputError for a missing one, or one that nothing here reads."""
    names, known = {*place.attrs}, (*needed, *more)
    if missing := sorted({*needed} - names):
        raise InputError(f"attribute {missing[0]!r} is missing")
    if unknown := sorted(names - {*known}):
        raise InputError(
            f"attributes: expected none but {', '.join(known)}, got {unknown[0]!r:.60}"
        )
    return {name: _text(place.attrs[name]) for name in names}


def _text(value: Any) -> Any:
    """An attribute's text as str, one number as Python's."""
    value = value.item() if isinstance(value, np.generic) else value
    return value.decode("utf-8", "surrogatepass") if isinstance(value, bytes) else value
