"""Files of strangers: looked at before another library parses them, which might run them."""

from __future__ import annotations

import bz2
import gzip
import lzma
import os
from typing import Any
from xml.parsers import expat

import h5py
import numpy as np

from warp_peri.errors import InputError, optional

LARGEST = 2**28
"""Bytes of a file that is parsed as a whole, at most, unpacked too."""
DEEPEST = 100
"""Parts of YAML inside one another, at most."""
MOST_PER_BYTE, SMALL = 20, 2**20
"""Bytes of arrays for each byte of a file of HDF5, which may be packed; bytes any may claim."""
PACKED: dict[bytes, Any] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ\x00": lzma.open}
ZSTD = b"\x28\xb5\x2f\xfd"
MARKS = b"\xff\xfe", b"\xfe\xff", b"\xef\xbb\xbf"
"""Of text in UTF-16, either byte order, and in UTF-8."""


def encoding_of(head: bytes) -> str:
    """Of text, by the mark that it may begin with."""
    return "utf-16" if head.startswith(MARKS[:2]) else "utf-8-sig"


def unpacked(path: str | os.PathLike[str], head: bytes) -> Any:
    """The bytes of a file, packed or not, by how it begins."""
    for mark, opened in PACKED.items():
        if head.startswith(mark):
            return opened(path, "rb")
    if head.startswith(ZSTD):
        without = f"{path}: packed by zstd: pip install 'warp_peri[dumps]'"
        return optional("zstandard", without).open(path, "rb")
    return open(path, "rb")


def content(path: str | os.PathLike[str]) -> bytes:
    """The bytes of a whole file, unpacked. Raises InputError for more than LARGEST, or none."""
    check_regular(path)
    try:
        with open(path, "rb") as file:
            head = file.read(16)
        with unpacked(path, head) as stream:
            found: bytes = stream.read(LARGEST + 1)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, EOFError, lzma.LZMAError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
    if len(found) > LARGEST:
        raise InputError(f"{path}: expected at most {LARGEST} bytes, unpacked too, got more")
    return found


def check_yaml(path: str | os.PathLike[str], text: bytes) -> None:
    """Raise InputError for YAML with tags, by which a loader runs code, or with anchors."""
    yaml = optional("yaml", "PyYAML: pip install 'warp_peri[phonons]'")
    deep = 0
    try:
        for event in yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
            if said := getattr(event, "tag", None) or getattr(event, "anchor", None):
                raise InputError(f"{path}: expected YAML without tags and anchors, got {said!r}")
            if isinstance(event, yaml.events.ScalarEvent) and _is_endless(event.value):
                raise InputError(f"{path}: expected finite numbers, got {event.value!r:.60}")
            deep += isinstance(event, yaml.events.CollectionStartEvent)
            deep -= isinstance(event, yaml.events.CollectionEndEvent)
            if deep > DEEPEST:
                raise InputError(f"{path}: more than {DEEPEST} parts of YAML inside one another")
    except yaml.YAMLError as error:
        raise InputError(f"{path}: expected YAML ({error})") from None


def _is_endless(text: str) -> bool:
    """Whether it is a number that is not finite, as YAML or Python writes it."""
    try:
        return not np.isfinite(float(text.lower().replace(".nan", "nan").replace(".inf", "inf")))
    except ValueError:
        return False


def check_regular(path: str | os.PathLike[str]) -> None:
    """Raise InputError for what is there and no file, as a pipe, which may never end."""
    if os.path.exists(path) and not os.path.isfile(path):
        raise InputError(f"{path}: expected a file, got another thing of that name")


def check_xml(path: str | os.PathLike[str], text: bytes) -> None:
    """Raise InputError for XML with a document type, whose entities grow or name other files."""

    def refused(*_: Any) -> None:
        raise InputError(f"{path}: expected XML without a document type (DOCTYPE)")

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refused
    try:
        parser.Parse(text, True)
    except expat.ExpatError:  # no XML, or raw numbers behind it: what reads the format says so
        return


def check_hdf5(file: h5py.File, size: int) -> None:
    """Raise InputError for links, arrays kept elsewhere, and more bytes than `size` stands for."""
    allowed, total, groups = max(SMALL, MOST_PER_BYTE * size), 0, [("", file["/"])]
    for place, group in groups:
        for name in group:
            where = f"{place}/{name}".lstrip("/")
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                raise InputError(f"{where}: expected an array in the file itself, got a link")
            item = group[name]
            if isinstance(item, h5py.Group) and all(item != other for _, other in groups):
                groups.append((where, item))
            if not isinstance(item, h5py.Dataset):
                continue
            if item.is_virtual or item.external:
                raise InputError(f"{where}: expected an array in the file itself")
            text = h5py.check_string_dtype(item.dtype) is not None
            if not (text or item.dtype.kind in "biufcSU") or item.dtype.subdtype is not None:
                raise InputError(f"{where}: expected numbers or text, got {item.dtype}")
            chunk = int(np.prod(item.chunks or (0,), dtype=object)) * item.dtype.itemsize
            count = int(np.prod(item.shape or (), dtype=object)) * item.dtype.itemsize
            total += max(chunk, count)
            if total > allowed:
                raise InputError(
                    f"{where}: expected arrays of at most {allowed} bytes in a file of {size}, "
                    f"got more than {total}"
                )


def meshio_of(extra: str = "export") -> Any:
    """meshio, which writes VTU; InputError names the extra that brings it."""
    return optional("meshio", f"meshio is not installed: pip install 'warp_peri[{extra}]'")
