"""Finished work of a data maker: files by a hash of what determines them, made in parallel."""

import hashlib
import inspect
import json
import os
import warnings
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar
from unittest.mock import patch

import joblib
import numpy as np

from warp_peri import InputError
from warp_peri.files.atomic import destination, plain, read_arrays, whole_file
from warp_peri.points.dataset import load_dataset

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


R = TypeVar("R")


def digest(content: dict[str, Any], length: int = 20) -> str:
    """The begin of a hash of plain values."""
    text = json.dumps(content, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:length]


def read_record(path: Path, kind: Callable[..., R]) -> R | None:
    """Numbers and arrays of one shape, the fields of a dataclass, as `write_arrays` left them under
    this name, which tells what determines them; or of a dict any arrays.

    None when there is no file, with a warning when it is corrupt or another's. Files without a
    mark, of before there were any, are taken as they are.
    """
    try:
        fields = read_arrays(path)
        if fields.pop("mark", _mark(path, fields)) != _mark(path, fields):
            raise ValueError("another's, or changed since it was written")
        if not (names := inspect.get_annotations(kind)):
            return kind(fields)
        fields = {name: fields[name] for name in names}
        if len({value.shape for value in fields.values() if value.ndim}) > 1:
            raise ValueError("arrays do not fit each other")
        if not all(np.isfinite(value).all() for value in fields.values()):
            raise ValueError("values that are not finite")
        return kind(**{n: value if value.ndim else float(value) for n, value in fields.items()})
    except FileNotFoundError:
        return None
    # Broken bytes surface as almost any exception of zipfile, zlib or NumPy.
    except Exception as error:
        warnings.warn(f"{path.name} is corrupt and is made again ({error})", stacklevel=2)
        return None


def _mark(path: Path, arrays: dict[str, Any]) -> str:
    """A hash of arrays by name and of the name of their file, which has one of their settings."""
    told = hashlib.sha256(path.name.encode())
    for name, one in sorted((name, np.asarray(one)) for name, one in arrays.items()):
        told.update(f"{name} {one.dtype.str} {one.shape} ".encode() + one.tobytes())
    return told.hexdigest()


def write_arrays(path: Path, arrays: dict[str, Any]) -> None:
    """Keep arrays by name, whole or not at all, with a mark; OSError names the file."""
    try:
        with whole_file(path) as temporary:
            np.savez(temporary, **arrays, mark=_mark(path, arrays))
    except OSError as error:
        raise OSError(f"cannot write {path}: {error}") from None


def check_made(path: Path, settings: dict[str, Any], *, overwrite: bool) -> bool:
    """Whether data of these settings are there, which stay as they are but for `overwrite`.

    `settings`: values that the provenance of a data set says. Raises InputError for what is no file
    and, but for `overwrite`, data of other settings.
    """
    if not destination(path).exists() or overwrite:
        return False
    said = load_dataset(path).provenance
    if plain(settings) != {name: said.get(name) for name in settings}:
        raise InputError(
            f"{path}: is there already, not by these settings; name another, or --overwrite"
        )
    return True


def kept(path: Path, compute: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Arrays of a file by name; computed and put there where there is none, or, with a warning, a
    damaged one or another's."""
    arrays: dict[str, np.ndarray] | None = read_record(path, dict)
    if arrays is None:
        write_arrays(path, arrays := compute())
    return arrays


def in_parallel(
    jobs: int, work: Callable[..., Any], tasks: Iterable[tuple], *, ordered: bool = True
) -> Iterator[Any]:
    """work(*task) of each task, in so many processes of one BLAS thread, −1 for one per core.

    Raises InputError for a number of processes that is none.
    """
    if jobs == 0 or jobs < -1:
        raise InputError(f"jobs: expected a number of processes ≥ 1, or −1, got {jobs}")
    kind = "generator" if ordered else "generator_unordered"
    todo = [joblib.delayed(work)(*task) for task in tasks]
    parallel = joblib.Parallel(n_jobs=min(jobs, len(todo) or 1), return_as=kind, batch_size=1)
    with patch.dict(os.environ, dict.fromkeys(THREADS, "1")):  # what processes started here read
        results = parallel(todo)
    return results
