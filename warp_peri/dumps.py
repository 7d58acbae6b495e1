"""Displacement of atoms from LAMMPS dump files, reduced frame by frame, whatever their length."""

from __future__ import annotations

import gzip
import io
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TextIO

import numpy as np
import scipy.sparse as sp
from ase.io.lammpsrun import read_lammps_dump_text
from numpy.typing import ArrayLike
from tqdm import tqdm

from warp_peri.coarse_graining import coarse_grain
from warp_peri.dataset import PointSet
from warp_peri.errors import InputError

FRAME = "ITEM: TIMESTEP"


def dump_positions(path: str | os.PathLike[str]) -> Iterator[np.ndarray]:
    """Positions of every frame of a text dump [Å], shape [A, 2], atoms in the order of their ids.

    One frame is in memory at a time; the text of each is read by ASE. A name that ends in .gz is
    unpacked on the way.

    Args:
        path: a dump with the columns id, x, y, z, or the wrapped, unwrapped or scaled forms of the
            last three that ASE knows.

    Raises InputError for a file that is not such a dump, or ends in the middle of a frame.
    """
    number = 0
    try:
        with _opened(path) as file:
            for text in _frames(file):
                number += 1
                atoms = read_lammps_dump_text(io.StringIO(text), index=-1)
                announced = int(text.split("ITEM: NUMBER OF ATOMS\n", 1)[1].split("\n", 1)[0])
                if len(atoms) != announced:
                    raise ValueError(f"{announced} atoms announced, {len(atoms)} there")
                x = atoms.get_positions()[:, :2]
                if not np.isfinite(x).all():
                    raise ValueError("positions that are not finite")
                yield x
    except FileNotFoundError:
        raise InputError(f"{path}: no such dump") from None
    # ASE meets broken frames with whatever its parsing runs into.
    except (OSError, EOFError, ValueError, IndexError, KeyError, RuntimeError, TypeError) as error:
        raise InputError(f"{path}: frame {number} is not one of a LAMMPS dump ({error})") from None
    if number == 0:
        raise InputError(f"{path}: expected a LAMMPS text dump, found no '{FRAME}'")


def dump_masses(path: str | os.PathLike[str], masses: Sequence[float]) -> np.ndarray:
    """Mass of every atom of the first frame of a dump, shape [A], by id.

    Args:
        path: as for dump_positions, with the column type.
        masses: of the types 1, 2, … in any unit.

    Raises InputError for a dump without the column, or a type without a mass.
    """
    next(dump_positions(path))  # says what is wrong with it otherwise
    with _opened(path) as file:
        header, _, rows = next(_frames(file)).partition("ITEM: ATOMS ")[2].partition("\n")
    columns = header.split()
    if "type" not in columns:
        raise InputError(f"{path}: expected the columns id and type, got {header.strip()}")
    wanted = [columns.index(name) for name in ("id", "type")]
    number, kind = np.loadtxt(io.StringIO(rows), usecols=wanted, dtype=int, ndmin=2, unpack=True)
    if kind.min() < 1 or kind.max() > len(masses):
        raise InputError(
            f"mass: expected one for each of the types {kind.min()} to {kind.max()} of {path}, "
            f"got {len(masses)}"
        )
    return np.asarray(np.take(masses, kind[np.argsort(number)] - 1), dtype=float)


def dump_displacement(
    path: str | os.PathLike[str],
    reference: ArrayLike,
    *,
    box: tuple[float, float] | None = None,
    skip: int = 0,
    iota: float | None = None,
) -> np.ndarray:
    """Displacement from the reference [Å], shape [A, 2], over the frames of a dump.

    Args:
        path: as for dump_positions.
        reference: positions without load [Å], shape [A, 2], by id.
        box: periods of the atoms [Å], for dumps of wrapped positions; None for a free body.
        skip: frames at the begin that are left out.
        iota: ι of the smoothing u ← (1 − ι) u + ι u_frame from u = 0 (You et al. 2021, 2.10); None
            for the plain average.

    Raises InputError for another number of atoms, too few frames, or ι outside 0 … 1.
    """
    reference = np.asarray(reference, dtype=float)
    if iota is not None and not 0 < iota <= 1:
        raise InputError(f"iota: expected 0 < ι ≤ 1, got {iota}")
    if skip < 0:
        raise InputError(f"skip: expected a number of frames ≥ 0, got {skip}")
    total, frames = np.zeros_like(reference), 0
    for x in dump_positions(path):
        if x.shape != reference.shape:
            raise InputError(f"{path}: expected {len(reference)} atoms, got {len(x)}")
        frames += 1
        if frames <= skip:
            continue
        u = x - reference
        if box is not None:
            u -= box * np.rint(u / box)
        total += u if iota is None else iota * (u - total)
    if frames <= skip:
        raise InputError(f"{path}: expected more than {skip} frames, got {frames}")
    return total if iota is not None else total / (frames - skip)


def coarse_grain_dumps(
    dumps: Sequence[str | os.PathLike[str]],
    omega: sp.csr_array,
    points: PointSet,
    *,
    reference: ArrayLike,
    force: ArrayLike,
    node_area: float,
    thickness: float,
    mass: ArrayLike = 1.0,
    unloaded: Sequence[str | os.PathLike[str]] = (),
    box: tuple[float, float] | None = None,
    skip: int = 0,
    iota: float | None = None,
    progress: bool = False,
) -> PointSet:
    """Samples on nodes from the dump of each load.

    Args:
        dumps: one for each load.
        omega: smoothing functions of the nodes and atoms (see smoothing_matrix), shape [N, A].
        points: the nodes.
        reference: positions without load [Å], shape [A, 2], by id.
        force: external forces on the atoms of each load [eV/Å], shape [S, A, 2].
        node_area, thickness, mass: as for coarse_grain.
        unloaded: a dump without load for each load, whose displacement is subtracted: runs of one
            Langevin seed share most of their noise. One alone serves every load; none is fine.
        box, skip, iota: as for dump_displacement.
        progress: show a progress bar over the dumps.

    Raises InputError as its parts do, and for forces or unloaded dumps that do not fit.
    """
    if len(unloaded) not in (0, 1, len(dumps)):
        raise InputError(f"unloaded: expected 0, 1 or {len(dumps)} dumps, got {len(unloaded)}")
    force = np.asarray(force, dtype=float)
    if len(force) != len(dumps):
        raise InputError(f"force: expected one field for each of {len(dumps)} dumps")

    def displacement(path: str | os.PathLike[str]) -> np.ndarray:
        return dump_displacement(path, reference, box=box, skip=skip, iota=iota)

    bar = tqdm([*unloaded, *dumps], desc="dumps", unit="dump", disable=not progress)
    found = [displacement(path) for path in bar]
    at_rest, fields = found[: len(unloaded)], []
    for number, u in enumerate(found[len(unloaded) :]):
        if at_rest:
            u = u - at_rest[number if len(at_rest) > 1 else 0]
        fields.append(u)
    u, b = coarse_grain(
        omega,
        displacement=np.stack(fields),
        force=force,
        mass=mass,
        node_area=node_area,
        thickness=thickness,
    )
    return PointSet(
        x=points.x,
        interior=points.interior,
        spacing=points.spacing,
        u=u,
        b=b,
        samples={"load_id": np.array([Path(path).name for path in dumps])},
    )


def _opened(path: str | os.PathLike[str]) -> TextIO:
    if str(path).endswith(".gz"):
        return gzip.open(path, "rt", encoding="utf-8")
    return open(path, encoding="utf-8")


def _frames(file: TextIO) -> Iterator[str]:
    """The text of one frame after the other."""
    lines: list[str] = []
    for line in file:
        if line.startswith(FRAME) and lines:
            yield "".join(lines)
            lines = []
        if lines or line.startswith(FRAME):
            lines.append(line)
        elif line.strip():
            raise ValueError(f"expected '{FRAME}', got {line.strip()[:60]!r}")
    if lines:
        yield "".join(lines)
