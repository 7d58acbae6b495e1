"""Displacement of atoms from LAMMPS dump files, reduced frame by frame, whatever their length."""

from __future__ import annotations

import gzip
import io
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np
import scipy.sparse as sp
from ase.io.lammpsrun import read_lammps_dump_text
from numpy.typing import ArrayLike
from tqdm import tqdm

from warp_peri.errors import InputError, renamed
from warp_peri.points.samples import PointsLike, Samples, nodes_of
from warp_peri.sources.coarse_graining import coarse_grain

FRAME = "ITEM: TIMESTEP"
BEFORE_FRAME = ("ITEM: UNITS", "ITEM: TIME")
"""What `dump_modify units yes` and `time yes` write ahead of a frame."""

ANGSTROM_UNITS = ("metal", "real")
"""Units of LAMMPS whose lengths are in Å."""

POSITIONS = ("x", "xs", "xu", "xsu")
"""Columns of positions, in the order in which ASE looks for them."""

ID = "i_warp_peri_id"
"""The column id under a name that ASE keeps as it is."""

BOX_TOLERANCE = 1e-5
"""Relative difference of a given period from that of a dump's header."""


@dataclass(frozen=True)
class Frame:
    """One frame of a dump, its atoms in the order of their ids.

    Attributes:
        ids: rising, shape [A].
        x: positions [Å], shape [A, 2].
        types: of the atoms, shape [A]; None without that column.
        box: periods of the header [Å]; None where the box is tilted.
        columns: of the file.
    """

    ids: np.ndarray
    x: np.ndarray
    types: np.ndarray | None
    box: tuple[float, float] | None
    columns: tuple[str, ...]


def dump_frames(path: str | os.PathLike[str]) -> Iterator[Frame]:
    """Every frame of a text dump.

    One frame is in memory at a time; the text of each is read by ASE. A name that ends in .gz is
    unpacked on the way.

    Args:
        path: a dump with the columns id, x, y, z, or the wrapped, unwrapped or scaled forms of the
            last three that ASE knows; in a tilted box xu, yu, zu.

    Raises InputError for a file that is not such a dump, or ends in the middle of a frame; for ids
    that are missing, come twice, or are others than those of the first frame.
    """
    number, first = 0, None
    try:
        with _opened(path) as file:
            for text in _frames(file):
                number += 1
                frame = _read(text)
                if first is None:
                    first = frame.ids
                elif not np.array_equal(first, frame.ids):
                    raise ValueError("expected the ids of frame 1, got others")
                yield frame
    except FileNotFoundError:
        raise InputError(f"{path}: no such dump") from None
    # ASE meets broken frames with whatever its parsing runs into.
    except (OSError, EOFError, ValueError, IndexError, KeyError, RuntimeError, TypeError) as error:
        raise InputError(f"{path}: frame {number} is not one of a LAMMPS dump ({error})") from None
    if number == 0:
        raise InputError(f"{path}: expected a LAMMPS text dump, found no '{FRAME}'")


def dump_positions(path: str | os.PathLike[str]) -> Iterator[np.ndarray]:
    """Positions of every frame of a text dump [Å], shape [A, 2], atoms in the order of their ids.

    Raises InputError as dump_frames does.
    """
    return (frame.x for frame in dump_frames(path))


def dump_masses(path: str | os.PathLike[str], masses: Sequence[float]) -> np.ndarray:
    """Mass of every atom of the first frame of a dump, shape [A], by id.

    Args:
        path: as for dump_frames, with the column type.
        masses: of the types 1, 2, … in any unit.

    Raises InputError for a dump without the column, or a type without a mass.
    """
    frame = next(dump_frames(path))
    kind = frame.types
    if kind is None:
        columns = " ".join(frame.columns)
        raise InputError(f"{path}: expected the columns id and type, got {columns}")
    if kind.min() < 1 or kind.max() > len(masses):
        raise InputError(
            f"mass: expected one for each of the types {kind.min()} to {kind.max()} of {path}, "
            f"got {len(masses)}"
        )
    return np.asarray(np.take(masses, kind - 1), dtype=float)


def dump_displacement(
    path: str | os.PathLike[str],
    reference: ArrayLike,
    *,
    ids: ArrayLike | None = None,
    box: tuple[float, float] | None = None,
    skip: int = 0,
    iota: float | None = None,
) -> np.ndarray:
    """Displacement from the reference [Å], shape [A, 2], over the frames of a dump.

    Args:
        path: as for dump_frames.
        reference: positions without load [Å], shape [A, 2], by id.
        ids: of the atoms of the reference, rising, shape [A]; None takes the dump's.
        box: periods of the atoms [Å], for dumps of wrapped positions; None for a free body.
        skip: frames at the begin that are left out.
        iota: ι of the smoothing u ← (1 − ι) u + ι u_frame from u = 0 (You et al. 2021, 2.10); None
            for the plain average.

    Raises InputError for another number of atoms, other ids, a box that is not the header's within
    1e-5, atoms beyond half the box without one, too few frames, or ι outside 0 … 1.
    """
    reference = np.asarray(reference, dtype=float)
    if iota is not None and not 0 < iota <= 1:
        raise InputError(f"iota: expected 0 < ι ≤ 1, got {iota}")
    if skip < 0:
        raise InputError(f"skip: expected a number of frames ≥ 0, got {skip}")
    total, frames = np.zeros_like(reference), 0
    for frame in dump_frames(path):
        x = frame.x
        if x.shape != reference.shape:
            raise InputError(f"{path}: expected {len(reference)} atoms, got {len(x)}")
        if ids is not None and not np.array_equal(frame.ids, ids):
            raise InputError(f"{path}: expected the ids of the reference's atoms, got others")
        if box is not None:
            check_box(path, box, frame.box, BOX_TOLERANCE)
        frames += 1
        if frames <= skip:
            continue
        u = x - reference
        if box is not None:
            u -= box * np.rint(u / box)
        elif frame.box is not None and (np.abs(u) > np.divide(frame.box, 2)).any():
            raise InputError(f"{path}: box: atoms moved beyond half the box; are they wrapped?")
        total += u if iota is None else iota * (u - total)
    if frames <= skip:
        raise InputError(f"{path}: expected more than {skip} frames, got {frames}")
    return total if iota is not None else total / (frames - skip)


def check_box(
    path: str | os.PathLike[str],
    box: tuple[float, float],
    header: tuple[float, float] | None,
    tolerance: float,
) -> None:
    """InputError unless periods agree with those of a dump's header, relative to them."""
    if header is None:
        raise InputError(f"{path}: box: expected an orthogonal box in the dump, got a tilted one")
    if np.shape(box) != (2,) or not np.allclose(box, header, rtol=tolerance, atol=0):
        raise InputError(
            f"{path}: box: expected the header's {' x '.join(f'{L:.9g}' for L in header)} Å, got "
            f"{' x '.join(f'{L:.9g}' for L in np.ravel(box))} Å"
        )


@dataclass(frozen=True)
class Atoms:
    """The atoms that dumps are of.

    Attributes:
        reference: positions without load [Å], shape [A, 2], by id.
        mass: of each, in any unit, shape [A], or one for all.
        ids: rising, shape [A]; None takes those of the first dump.
        box: their periods [Å], for dumps of wrapped positions; None for a free body.
    """

    reference: ArrayLike
    mass: ArrayLike = 1.0
    ids: ArrayLike | None = None
    box: tuple[float, float] | None = None


@dataclass(frozen=True)
class Average:
    """How the frames of a dump are reduced to one, as in dump_displacement.

    Attributes:
        skip: frames left out at the begin.
        iota: ι of the smoothing in time; None takes the plain average.
    """

    skip: int = 0
    iota: float | None = None


@renamed(
    **dict.fromkeys(("reference", "mass", "ids", "box"), "part of Atoms(…)"),
    **dict.fromkeys(("skip", "iota"), "part of average=Average(skip, iota)"),
)
def coarse_grain_dumps(
    dumps: Sequence[str | os.PathLike[str]],
    omega: sp.csr_array,
    points: PointsLike,
    atoms: Atoms,
    *,
    force: ArrayLike,
    node_area: float,
    thickness: float,
    unloaded: Sequence[str | os.PathLike[str]] = (),
    average: Average = Average(),
    progress: bool = False,
) -> Samples:
    """Samples on nodes from the dump of each load.

    Args:
        dumps: one for each load.
        omega: smoothing functions of the nodes and atoms (see smoothing_matrix), shape [N, A].
        points: the nodes.
        atoms: that the dumps are of.
        force: external forces on the atoms of each load [eV/Å], shape [S, A, 2].
        node_area, thickness: as for coarse_grain.
        unloaded: a dump without load for each load, whose displacement is subtracted: runs of one
            Langevin seed share most of their noise. One alone serves every load; none is fine.
        average: of the frames of each dump.
        progress: show a progress bar over the dumps.

    Raises InputError as its parts do, and for forces or unloaded dumps that do not fit, or whose
    ids differ.
    """
    if len(unloaded) not in (0, 1, len(dumps)):
        raise InputError(f"unloaded: expected 0, 1 or {len(dumps)} dumps, got {len(unloaded)}")
    force = np.asarray(force, dtype=float)
    if len(force) != len(dumps):
        raise InputError(f"force: expected one field for each of {len(dumps)} dumps")
    ids = atoms.ids
    if ids is None and len(dumps):
        ids = next(dump_frames(dumps[0])).ids

    def displacement(path: str | os.PathLike[str]) -> np.ndarray:
        return dump_displacement(
            path, atoms.reference, ids=ids, box=atoms.box, skip=average.skip, iota=average.iota
        )

    bar = tqdm([*unloaded, *dumps], desc="dumps", unit="dump", disable=not progress)
    averages = [displacement(path) for path in bar]
    fields, at_rest = np.stack(averages[len(unloaded) :]), averages[: len(unloaded)]
    u, b = coarse_grain(
        omega,
        displacement=fields - np.stack(at_rest) if at_rest else fields,
        force=force,
        mass=atoms.mass,
        node_area=node_area,
        thickness=thickness,
    )
    names = {"load_id": np.array([Path(path).name for path in dumps])}
    return Samples(nodes_of(points), u, b, names)


def _opened(path: str | os.PathLike[str]) -> TextIO:
    if str(path).endswith(".gz"):
        return gzip.open(path, "rt", encoding="utf-8")
    return open(path, encoding="utf-8")


def _frames(file: TextIO) -> Iterator[str]:
    """The text of one frame after the other, with what stands before its time step."""
    lines: list[str] = []
    begun = False
    for line in file:
        if line.startswith("ITEM:"):
            starts = line.startswith((FRAME, *BEFORE_FRAME))
            if starts and begun:
                yield "".join(lines)
                lines, begun = [], False
            begun = begun or line.startswith(FRAME)
            if not (starts or begun):
                raise ValueError(f"expected '{FRAME}', got {line.strip()[:60]!r}")
        if lines or line.startswith("ITEM:"):
            lines.append(line)
        elif line.strip():
            raise ValueError(f"expected '{FRAME}', got {line.strip()[:60]!r}")
    if lines:
        yield "".join(lines)


def _read(text: str) -> Frame:
    """A frame from its text. Raises ValueError, or what ASE runs into."""
    head, _, rest = text.partition("ITEM: ATOMS ")
    header, _, rows = rest.partition("\n")
    columns = tuple(header.split())
    if head.startswith("ITEM: UNITS"):
        units = head.split("\n")[1].strip()
        if units not in ANGSTROM_UNITS:
            raise ValueError(f"expected units {' or '.join(ANGSTROM_UNITS)}, got {units}")
    if columns and "id" not in columns:
        raise ValueError(f"expected the column id, got {header.strip()}")
    # ASE sorts by id and forgets it, so it gets the ids under a name of its own to keep; and as
    # the types it wants when there is no column that tells elements.
    known = {"element", "mass", "type"} & set(columns)
    name = ID if known else "type"
    used = next((column for column in POSITIONS if column in columns), None)
    if used is None or used.replace("x", "y") not in columns:
        raise ValueError(f"expected x and y of one kind, as xu yu, got {header.strip()}")
    if not {"z", "zu", "zs", "zsu"} & set(columns):
        raise ValueError(f"expected z beside x and y, got {header.strip()}")
    # A sheet's z is not looked at, but ASE wants it of the kind of x and y.
    height = {f"z{kind}": used.replace("x", "z") for kind in ("", "u", "s", "su")}
    renamed = {"id": name} | ({} if set(height.values()) & set(columns) else height)
    given = " ".join(renamed.get(column, column) for column in columns)
    atoms = read_lammps_dump_text(io.StringIO(f"{head}ITEM: ATOMS {given}\n{rows}"), index=-1)
    announced = int(text.split("ITEM: NUMBER OF ATOMS\n", 1)[1].split("\n", 1)[0])
    if len(atoms) != announced:
        raise ValueError(f"{announced} atoms announced, {len(atoms)} there")
    cell = np.asarray(atoms.cell)
    tilted = bool((cell != np.diag(np.diag(cell))).any())
    if tilted and used != "xu":
        raise ValueError(f"expected the columns xu, yu, zu in a tilted box, got {used}")
    x = atoms.get_positions()[:, :2]
    if used in ("xs", "xsu"):
        x = x + np.ravel(atoms.get_celldisp())[:2]  # ASE leaves the corner of the box out
    if not np.isfinite(x).all():
        raise ValueError("positions that are not finite")
    ids = atoms.arrays[name]
    order = np.argsort(ids)
    ids = ids[order]
    if (twice := ids[1:][ids[1:] == ids[:-1]]).size:
        raise ValueError(f"the id {twice[0]} comes twice")
    types = atoms.arrays["type"][order] if "type" in columns else None
    box = None if tilted else (float(cell[0, 0]), float(cell[1, 1]))
    return Frame(ids, x[order], types, box, columns)
