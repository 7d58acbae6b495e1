"""Arrays in an uncompressed .npz, read without pickle and with sizes checked before memory."""

from __future__ import annotations

import os
import zipfile
from typing import Any

import numpy as np
from numpy.lib import format as npy

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
