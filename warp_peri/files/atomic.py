"""Files written whole or not at all, and files of strangers read with care: what another library
parses, which might run it, is looked at first."""

from __future__ import annotations

import bz2
import fcntl
import gzip
import io
import json
import lzma
import math
import os
import stat
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from xml.parsers import expat

import h5py
import numpy as np
from numpy import ndarray

from warp_peri.errors import Arrays, InputError, StrPath, Values, optional

MOST = 2**33
"""Bytes of one archive that are read at most."""
DEEPEST, BLOCK = 100, 2**20
"""Brackets of JSON, or parts of YAML, inside one another, at most; bytes looked at together."""
DEEPER = np.zeros(256, int)
"""By how much the text after a byte is deeper."""
DEEPER[[*b"[{"]], DEEPER[[*b"]}"]] = 1, -1
BROKEN = zipfile.BadZipFile, EOFError, RuntimeError, KeyError, NotImplementedError, MemoryError
"""What reading an archive of arrays runs into."""
NO_PLACE = FileExistsError, FileNotFoundError, NotADirectoryError, IsADirectoryError


def read_arrays(path: StrPath, most: int = MOST) -> Arrays:
    """Read the arrays of an np.savez file by name. OSError when it cannot be read, ValueError for
    all else: compressed, truncated, other sizes than its headers claim, more bytes, objects."""
    check_regular(path)
    most = min(os.path.getsize(path), most)
    try:
        with zipfile.ZipFile(path) as archive:
            for entry in archive.infolist():
                if entry.compress_type != zipfile.ZIP_STORED or entry.file_size > most:
                    raise ValueError(
                        f"{entry.filename!r}: expected {most} bytes at most, not packed"
                    )
        with np.load(path, allow_pickle=False) as file:
            return dict(file)
    except BROKEN as error:
        raise ValueError(str(error)) from None


def destination(path: StrPath) -> Path:
    """Path where a file of this name is written, links followed; InputError for what is there and
    is no regular file: a folder, a device, a pipe."""
    followed = Path(os.path.realpath(path))
    with written(path):  # a file for a folder on the way, links in a circle
        try:
            mode = os.stat(followed).st_mode
        except FileNotFoundError:
            return followed
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "a device, a pipe or a socket"
        raise InputError(f"{path}: expected a file or a new name, got {kind}")
    return followed


@contextmanager
def written(path: StrPath, errors: Any = OSError) -> Iterator[None]:
    """Turn errors of writing, as of a full disk, into one line that names the path."""
    try:
        yield
    except errors as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from None


@contextmanager
def whole_file(path: StrPath) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` on success, remove it on error. A
    reader sees the old file, the new file or none, never half of one. The folder is created if it
    is missing. A link stays, and what it points at is replaced. Of a process that is killed the
    temporary file is left. InputError for a path that is no regular file."""
    path = destination(path)
    with written(path, NO_PLACE):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, made = tempfile.mkstemp(path.suffix, f".{path.name}.part-", path.parent)
    temporary = Path(made)
    try:
        yield temporary
        os.fsync(handle)
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)  # mkstemp makes private files; a result is not a secret
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
        os.close(handle)


@contextmanager
def whole_hdf5(path: StrPath, **how: Any) -> Iterator[h5py.File]:
    """Yield an HDF5 file in memory; write it to `path` whole or not at all. On a disk that is full
    the HDF5 library can lose what it holds back and say nothing; Python raises OSError."""
    with whole_file(path) as temporary:
        with h5py.File(made := io.BytesIO(), "w", **how) as file:
            yield file
        temporary.write_bytes(made.getbuffer())


def _is_busy(handle: int) -> bool:
    """Lock an open file; whether another process holds it, or removed it since it was opened."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # of a disk without locks
        pass
    return not os.fstat(handle).st_nlink


@contextmanager
def locked(path: StrPath) -> Iterator[None]:
    """Hold a file or folder that is being written against every other job. The lock is the
    operating system's, on a hidden file beside `path`: it ends with the process, however that ends.
    Raises InputError when another job holds it, or where no file can be; and where the hidden file
    is a user's, with something in it."""
    path = Path(os.path.realpath(path))
    beside = path.with_name(f".{path.name}.lock")
    with written(path, NO_PLACE):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(beside, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    try:
        if os.fstat(handle).st_size:
            raise InputError(f"{beside}: expected no file, or an empty one, got another's")
        if _is_busy(handle):
            raise InputError(f"{path}: another job is writing here")
        try:
            yield
        finally:
            beside.unlink(missing_ok=True)  # still held
    finally:
        os.close(handle)


def write_text(path: StrPath, text: str) -> None:
    """Write a UTF-8 text file whole or not at all."""
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def plain(value: Any) -> Any:
    """Turn NumPy numbers and arrays inside `value` into JSON values."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, (ndarray, np.generic)):
        return value.tolist()
    return value


def finite(value: Any) -> Any:
    """Plain values of what JSON holds, None for floats that it has no number for."""
    return json.loads(json.dumps(plain(value)), parse_constant=lambda _: None)


def parsed(text: str | bytes) -> Any:
    """Parse JSON text; ValueError for other text, and brackets deeper than DEEPEST, which end the
    process where a package has raised Python's limit of recursion."""
    if not isinstance(text, str | bytes):
        raise ValueError(f"expected text, got {type(text).__name__}")
    raw = text.encode() if isinstance(text, str) else text
    marks, level = np.frombuffer(raw, np.uint8), 0
    for first in range(0, len(marks), BLOCK):
        levels = level + np.cumsum(DEEPER[marks[first : first + BLOCK]])
        if levels.max() > DEEPEST:
            raise ValueError(f"more than {DEEPEST} brackets inside one another")
        level = int(levels[-1])
    return json.loads(raw.decode("utf-8"))


def write_json(path: StrPath, content: Values) -> None:
    """Write JSON whole or not at all; NaN and infinity are refused (ValueError)."""
    write_text(path, json.dumps(plain(content), indent=2, allow_nan=False) + "\n")


LARGEST = 2**28
"""Bytes of a file that is parsed as a whole, at most, unpacked too."""
MOST_PER_BYTE, SMALL = 20, 2**20
"""Bytes of arrays for each byte of a file of HDF5, which may be packed; bytes any may claim."""
PACKED: dict[bytes, Any] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ\x00": lzma.open}
ZSTD = b"\x28\xb5\x2f\xfd"
MARKS = b"\xff\xfe", b"\xfe\xff", b"\xef\xbb\xbf"
"""Of text in UTF-16, either byte order, and in UTF-8."""


def encoding_of(head: bytes) -> str:
    """Encoding of text, by the mark that it may begin with."""
    return "utf-16" if head.startswith(MARKS[:2]) else "utf-8-sig"


def unpacked(path: StrPath, head: bytes) -> Any:
    """Open a file's bytes, unpacking by how it begins."""
    for mark, opened in PACKED.items():
        if head.startswith(mark):
            return opened(path, "rb")
    if head.startswith(ZSTD):
        without = f"{path}: packed by zstd: pip install 'warp_peri[dumps]'"
        return optional("zstandard", without).open(path, "rb")
    return open(path, "rb")


def content(path: StrPath) -> bytes:
    """Bytes of a whole file, unpacked; InputError for more than LARGEST, or none."""
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


def check_yaml(path: StrPath, text: bytes) -> None:
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
    """Whether text is a number that is not finite, as YAML or Python writes it."""
    try:
        return not np.isfinite(float(text.lower().replace(".nan", "nan").replace(".inf", "inf")))
    except ValueError:
        return False


def check_regular(path: StrPath) -> None:
    """Raise InputError for a path that is there and no file, as a pipe, which may never end."""
    if os.path.exists(path) and not os.path.isfile(path):
        raise InputError(f"{path}: expected a file, got another thing of that name")


def check_xml(path: StrPath, text: bytes) -> None:
    """Raise InputError for XML with a document type, whose entities grow or name other files."""

    def refused(*_: Any) -> None:
        raise InputError(f"{path}: expected XML without a document type (DOCTYPE)")

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refused
    if b"<!DOCTYPE" in text:  # behind raw numbers too, where XML ends for this parser
        refused()
    # what is no XML, or has raw numbers behind it, is told of by what reads the format
    with suppress(expat.ExpatError):
        parser.Parse(text, True)


def check_hdf5(file: h5py.File) -> None:
    """Raise InputError for links, arrays kept elsewhere, and more bytes than its own stand for."""
    allowed = max(SMALL, MOST_PER_BYTE * (size := os.path.getsize(file.filename)))
    total, groups, seen = 0, [("", file["/"])], {file["/"]}
    for place, group in groups:
        for name in group:
            where = f"{place}/{name}".lstrip("/")
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                raise InputError(f"{where}: expected an array in the file itself, got a link")
            item = group[name]
            if isinstance(item, h5py.Group) and item not in seen:
                groups.append((where, item))
                seen.add(item)
            if not isinstance(item, h5py.Dataset):
                continue
            if item.is_virtual or item.external:
                raise InputError(f"{where}: expected an array in the file itself")
            dtype, text = item.dtype, h5py.check_string_dtype(item.dtype) is not None
            if not (text or dtype.kind in "biufcSU") or dtype.subdtype is not None:
                raise InputError(f"{where}: expected numbers or text, got {dtype}")
            counts = map(math.prod, (item.chunks or (0,), item.shape or ()))
            total += max(counts) * dtype.itemsize
            if total > allowed:
                raise InputError(
                    f"{where}: expected arrays of at most {allowed} bytes in a file of {size}, "
                    f"got more than {total}"
                )


def meshio_of(extra: str = "export") -> Any:
    """Module meshio, which writes VTU; InputError names the extra that brings it."""
    return optional("meshio", f"meshio is not installed: pip install 'warp_peri[{extra}]'")


def in_space(values: ndarray) -> ndarray:
    """Vectors [n, 2] with a third component; other arrays as they are."""
    return np.pad(values, ((0, 0), (0, 1))) if values.shape[1:] == (2,) else values


def write_vtu(
    path: StrPath, x: ndarray, cells: tuple[str, ndarray], fields: Arrays, extra: str = "export"
) -> None:
    """Write nodes [N, d], cells [C, n] of one kind and named fields [N, ...] to a VTU file;
    InputError without meshio, naming the extra that brings it."""
    data = {name: in_space(field) for name, field in fields.items()}
    mesh = meshio_of(extra).Mesh(in_space(x), [cells], point_data=data)
    with whole_file(path) as temporary:
        mesh.write(temporary, "vtu")
