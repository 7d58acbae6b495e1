"""Frames of atoms from files: LAMMPS dumps as text, packed or not, and what ASE reads."""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from warp_peri.errors import InputError
from warp_peri.files.foreign import unpacked

FRAME = "ITEM: TIMESTEP"
EXPECTED = "a LAMMPS dump (text, packed or not), .extxyz, .xyz or .traj"
BEFORE_FRAME = ("ITEM: UNITS", "ITEM: TIME")
"""What `dump_modify units yes` and `time yes` write ahead of a frame."""
ANGSTROM_UNITS = ("metal", "real")
"""Units of LAMMPS whose lengths are in Å."""
POSITIONS = ("x", "xs", "xu", "xsu")
"""Columns of positions, in the order in which they are looked for."""
IMAGES = ("ix", "iy", "iz")
MARKS = b"\xff\xfe", b"\xfe\xff", b"\xef\xbb\xbf"
"""Of text in UTF-16, either byte order, and in UTF-8."""
LARGEST_FRAME = 2**31
"""Characters of a frame of text, at most; a small packed file may hold more."""
OF_ASE = (".xyz", ".extxyz", ".traj")
"""Endings of files that ASE reads, frame by frame."""
ROUND = 1e-9
"""Part of a box's longest edge that tilts it: less is rounding."""


@dataclass(frozen=True)
class Frame:
    """One frame, its atoms in the order of their ids.

    Attributes:
        ids: rising, shape [A]; 1, 2, … in a file without them.
        x: positions [Å], shape [A, 2].
        types: of the atoms, shape [A]; None without that column.
        box: periods [Å]; None where the box is tilted, or there is none.
        columns: of the file.
        z: third coordinates [Å], shape [A].
        cell: edges of the box as rows [Å], shape [3, 3].
        unwrapped: whether images of the box were added to positions.
    """

    ids: np.ndarray
    x: np.ndarray
    types: np.ndarray | None
    box: tuple[float, float] | None
    columns: tuple[str, ...]
    z: np.ndarray
    cell: np.ndarray
    unwrapped: bool = False


def dump_frames(path: str | os.PathLike[str]) -> Iterator[Frame]:
    """Every frame of a trajectory, one in memory at a time.

    LAMMPS dumps (`dump custom`) as text, packed by gzip, bzip2, xz or zstd, or not; .xyz, .extxyz
    and .traj by ASE. Wrapped positions are
    unwrapped where the file has images, and a warning says so.

    Args:
        path: a dump with the columns id, x, y, z, or the wrapped, unwrapped or scaled forms of the
            last three; in a tilted box xu, yu, zu, or x, y, z with ix, iy, iz.

    Raises InputError for a file that is no such thing, or ends in the middle of a frame; for ids
    that are missing, come twice, or are others than those of the first frame; for atoms of a tilted
    box that are wrapped, without images; for a packed file whose packer is not installed.
    """
    number, first = 0, None
    try:
        for frame in _frames_of(path):
            if first is None:
                first = frame
                if frame.unwrapped:
                    warnings.warn(f"{path}: unwrapped by the images ix, iy, iz", stacklevel=2)
            elif not np.array_equal(first.ids, frame.ids):
                raise ValueError("expected the ids of frame 1, got others")
            sure = frame.unwrapped or {"xu", "xsu"} & set(frame.columns)
            if frame.box is None and not sure and jumps(frame, first.x):
                raise ValueError(
                    "atoms jump by an edge of the tilted box: expected xu, yu, zu, or images"
                )
            yield frame
            number += 1
    except FileNotFoundError:
        raise InputError(f"{path}: no such dump") from None
    except InputError:
        raise
    # What reads a broken file runs into anything.
    except Exception as error:
        raise InputError(
            f"{path}: frame {number + 1} cannot be read ({error}); expected {EXPECTED}"
        ) from None
    if number == 0:
        raise InputError(f"{path}: expected {EXPECTED}; found no frame")


def jumps(frame: Frame, x: np.ndarray) -> bool:
    """Whether some atom is half an edge of the box or more from where it was, x, shape [A, 2].

    That is no displacement of a solid: such atoms were taken to the other side of the box.
    """
    edges = frame.cell[np.abs(frame.cell[:, :2]).max(axis=1) > ROUND * np.abs(frame.cell).max()]
    parts = (frame.x - x) @ np.linalg.pinv(edges[:, :2])
    return bool((np.abs(parts) >= 0.5).any())


def _frames_of(path: str | os.PathLike[str]) -> Iterator[Frame]:
    with open(path, "rb") as file:
        head = file.read(64)
    if str(path).endswith(OF_ASE) and not head.startswith(b"ITEM:"):
        yield from _by_ase(path)
    else:
        with io.TextIOWrapper(unpacked(path, head), encoding=encoding_of(head)) as lines:
            yield from map(_of_text, _texts(lines))


def encoding_of(head: bytes) -> str:
    """Of text, by the mark that it may begin with."""
    return "utf-16" if head.startswith(MARKS[:2]) else "utf-8-sig"


# ------------------------------------------------------------------ LAMMPS


def _texts(file: io.TextIOWrapper) -> Iterator[str]:
    """The text of one frame after the other, with what stands before its time step."""
    lines: list[str] = []
    begun, size = False, 0
    for line in iter(lambda: file.readline(LARGEST_FRAME), ""):
        size += len(line)
        if size > LARGEST_FRAME:
            raise ValueError(f"expected frames of at most {LARGEST_FRAME} characters")
        if line.startswith("ITEM:"):
            starts = line.startswith((FRAME, *BEFORE_FRAME))
            if starts and begun:
                yield "".join(lines)
                lines, begun, size = [], False, len(line)
            begun = begun or line.startswith(FRAME)
            if not (starts or begun):
                raise ValueError(f"expected '{FRAME}', got {line.strip()[:60]!r}")
        if lines or line.startswith("ITEM:"):
            lines.append(line)
        elif line.strip():
            raise ValueError(f"expected '{FRAME}', got {line.strip()[:60]!r}")
    if lines:
        yield "".join(lines)


def _of_text(text: str) -> Frame:
    """A frame from its text. Raises ValueError, or what parsing runs into."""
    head, _, rest = text.partition("ITEM: ATOMS ")
    header, _, rows = rest.partition("\n")
    items: dict[str, list[str]] = {}
    for part in head.split("ITEM: ")[1:]:
        title, *lines = part.rstrip("\n").split("\n")
        items[title] = lines
    units = items.get("UNITS", ["metal"])[0].strip()
    (bounds,) = (title for title in items if title.startswith("BOX BOUNDS"))
    if "abc" in bounds:
        raise ValueError("a box of general edges (triclinic/general yes) is not read")
    limits = np.array([[float(word) for word in line.split()] for line in items[bounds]])
    announced = int(items["NUMBER OF ATOMS"][0])
    columns = tuple(header.split())
    wanted = _wanted(columns)
    places = [columns.index(name) for name in wanted]
    table = np.loadtxt(io.StringIO(rows), usecols=places, ndmin=2) if rows.strip() else None
    if table is None or len(table) != announced:
        raise ValueError(f"{announced} atoms announced, {0 if table is None else len(table)} there")
    tilt = limits[:, 2] if limits.shape[1] == 3 else np.zeros(3)
    return _frame(columns, dict(zip(wanted, table.T)), limits[:, :2], tilt, units)


def _wanted(columns: Sequence[str]) -> list[str]:
    """The columns that a frame is made of. Raises ValueError for those that are not there."""
    shown = " ".join(columns)
    if "id" not in columns:
        raise ValueError(f"expected the column id, got {shown}")
    used = next((name for name in POSITIONS if name in columns), None)
    if used is None or used.replace("x", "y") not in columns:
        raise ValueError(f"expected x and y of one kind, as xu yu, got {shown}")
    height = used.replace("x", "z")
    if height not in columns:
        others = [name for name in ("z", "zu", "zs", "zsu") if name in columns]
        if not others:
            raise ValueError(f"expected z beside x and y, got {shown}")
        height = others[0]  # a sheet's: nobody looks at it
    wanted = ["id", used, used.replace("x", "y"), height]
    wanted += [name for name in ("type", *IMAGES) if name in columns]
    return wanted


def _frame(
    columns: tuple[str, ...],
    values: dict[str, np.ndarray],
    limits: np.ndarray,
    tilt: np.ndarray,
    units: str,
) -> Frame:
    """A frame of LAMMPS from its columns, the limits of the box's frame and its tilts."""
    if units not in ANGSTROM_UNITS:
        raise ValueError(f"expected units {' or '.join(ANGSTROM_UNITS)}, got {units}")
    xy, xz, yz = tilt
    x_out, y_out = (0.0, xy, xz, xy + xz), (0.0, yz)
    low = limits[:, 0] - [min(x_out), min(y_out), 0.0]
    high = limits[:, 1] - [max(x_out), max(y_out), 0.0]
    cell = np.diag(high - low)
    cell[1, 0], cell[2, 0], cell[2, 1] = tilt
    _, used, *_ = values
    positions = np.stack([values[name] for name in list(values)[1:4]], axis=1)
    if used in ("xs", "xsu"):
        positions = low + positions @ cell
    images = None
    if used in ("x", "xs") and set(IMAGES) <= set(values):
        images = np.stack([values[name] for name in IMAGES], axis=1)
    if tilt.any() and used in ("x", "xs") and images is None:
        raise ValueError(
            f"expected the columns xu, yu, zu in a tilted box, got {used}; or {used} with the "
            "images ix, iy, iz"
        )
    ids = values["id"].astype(np.int64)
    types = values["type"].astype(np.int64) if "type" in values else None
    return _ordered(ids, positions, types, cell, columns, images)


def _ordered(
    ids: np.ndarray,
    positions: np.ndarray,
    types: np.ndarray | None,
    cell: np.ndarray,
    columns: tuple[str, ...],
    images: np.ndarray | None = None,
) -> Frame:
    """Atoms by rising id, none twice, all somewhere, unwrapped where there are images of a box."""
    if images is not None:
        positions = positions + images @ cell
    if not np.isfinite(positions).all():
        raise ValueError("positions that are not finite")
    order = np.argsort(ids)
    ids = ids[order]
    if (twice := ids[1:][ids[1:] == ids[:-1]]).size:
        raise ValueError(f"the id {twice[0]} comes twice")
    types = None if types is None else types[order]
    x = positions[order]
    sides = (float(cell[0, 0]), float(cell[1, 1]))
    straight = np.abs(cell - np.diag(np.diag(cell))).max() <= ROUND * np.abs(cell).max()
    box = sides if straight and min(sides) > 0 else None
    return Frame(ids, x[:, :2], types, box, columns, x[:, 2], cell, images is not None)


# ------------------------------------------------------------------ other formats


def _by_ase(path: str | os.PathLike[str]) -> Iterator[Frame]:
    """Types are 1, 2, … in the order of atomic numbers; ids a column id, or the file's order."""
    import ase.io

    form = "traj" if str(path).endswith(".traj") else "extxyz"  # never by what it looks like
    for atoms in ase.io.iread(os.fspath(path), index=":", format=form):
        ids = np.asarray(atoms.arrays.get("id", np.arange(1, len(atoms) + 1)))
        types = 1 + np.unique(atoms.numbers, return_inverse=True)[1]
        cell = np.array(atoms.cell) * atoms.pbc[:, None]
        there = set(IMAGES) <= set(atoms.arrays)
        images = np.stack([atoms.arrays[name] for name in IMAGES], axis=1) if there else None
        yield _ordered(ids, np.array(atoms.positions), types, cell, tuple(atoms.arrays), images)
