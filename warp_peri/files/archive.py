"""Arrays in an uncompressed .npz, read without pickle and with sizes checked before memory."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.lib import format as npy

from warp_peri.errors import InputError
from warp_peri.files.atomic import whole_file

T = TypeVar("T")
MOST = 2**33
"""Bytes of one archive that are read at most."""


def read_arrays(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """The arrays of a file that np.savez wrote, by name.

    Raises OSError when it cannot be read, ValueError when it is anything else: compressed,
    truncated, with arrays whose headers claim other sizes than the file holds, or with objects.
    """
    arrays = {}
    try:
        with open(path, "rb") as raw, zipfile.ZipFile(raw) as archive:
            size = os.fstat(raw.fileno()).st_size
            for entry in archive.infolist():
                stored = entry.compress_type == zipfile.ZIP_STORED
                if not stored or entry.file_size > min(size, MOST):
                    raise ValueError(f"{entry.filename!r}: expected an array as it is, not packed")
                with archive.open(entry) as file:
                    _check_header(file, entry)
                with archive.open(entry) as file:
                    name = entry.filename.removesuffix(".npy")
                    arrays[name] = npy.read_array(file, allow_pickle=False)
                    if file.read(1):
                        raise ValueError(f"{entry.filename!r}: more bytes than the array holds")
    except (zipfile.BadZipFile, EOFError, RuntimeError, KeyError, NotImplementedError) as error:
        raise ValueError(str(error)) from None
    return arrays


class ArrayFile:
    """A checkpoint of one process: arrays by name, written whole or not at all.

    Args:
        path: of the file, which need not be there yet; None keeps nothing.
        key: what the run depends on.
        other: what the checkpoint of another key is of, for errors.
    """

    def __init__(self, path: str | os.PathLike[str] | None, key: str, other: str) -> None:
        self.path, self.key, self.other = None if path is None else Path(path), key, other

    def write(self, arrays: Mapping[str, Any]) -> None:
        """Write arrays, or what they are made of."""
        if self.path is not None:
            with whole_file(self.path) as temporary, open(temporary, "wb") as file:
                np.savez(file, **arrays, key=np.array(self.key))

    def read(self, made: Callable[[dict[str, np.ndarray]], T]) -> T | None:
        """What is made of the arrays; None where there is no file yet.

        Raises InputError for a file of another run, and one that cannot be read: a KeyError,
        TypeError or ValueError of `made` says so.
        """
        if self.path is None or not self.path.exists():
            return None
        try:
            arrays = read_arrays(self.path)
            same = str(arrays.pop("key")) == self.key
            found = made(arrays) if same else None
        except (OSError, KeyError, ValueError, TypeError) as error:
            raise InputError(f"{self.path}: not a readable checkpoint ({error})") from None
        if not same:
            raise InputError(f"{self.path}: the checkpoint of {self.other}")
        return found


def _check_header(file: Any, entry: zipfile.ZipInfo) -> None:
    """ValueError unless the header's shape and type fill the entry."""
    version = npy.read_magic(file)
    readers = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
    if version not in readers:
        raise ValueError(f"{entry.filename!r}: an unknown version of the format, {version}")
    shape, _, dtype = readers[version](file)
    if dtype.hasobject:
        raise ValueError(f"{entry.filename!r}: objects are not read")
    count = int(np.prod(shape, dtype=object)) if shape else 1
    if min(shape, default=0) < 0 or file.tell() + count * dtype.itemsize != entry.file_size:
        raise ValueError(f"{entry.filename!r}: the shape {shape} does not fit the file")
