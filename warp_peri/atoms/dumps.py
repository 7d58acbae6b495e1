"""Trajectories of LAMMPS or ASE: frames, mean displacements, samples on nodes."""

from __future__ import annotations

import io
import os
import re
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, TextIO

import ase.io
import numpy as np
import scipy.sparse as sp
from ase.io.extxyz import key_val_str_to_dict
from ase.io.formats import filetype
from numpy import ndarray
from numpy.linalg import norm, pinv
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from tqdm import tqdm

from warp_peri.atoms.coarse_graining import coarse_grain, masses_of
from warp_peri.errors import InputError, StrPath, Values, warn
from warp_peri.files.atomic import MARKS, check_regular, check_xml, content, encoding_of, unpacked
from warp_peri.points.arguments import MOST, Natural, Positive, check_shape, checked, plain, typed
from warp_peri.points.points import PointsLike, Samples, nearest, nodes_of

EXPECTED = "a LAMMPS dump (text, packed or not), .extxyz, .xyz or .traj"
BEGIN = "ITEM: TIMESTEP", "ITEM: UNITS", "ITEM: TIME"
"""Lines that a frame begins with; the others are of `dump_modify units yes` and `time yes`."""
ANGSTROM_UNITS = "metal", "real"
"""Units of LAMMPS whose lengths are in Å."""
POSITIONS = "x", "xs", "xu", "xsu"
"""Columns of positions, in the order in which they are looked for."""
IMAGES = "ix", "iy", "iz"
LARGEST_FRAME = 2**31
"""Characters of a frame of text, at most; a small packed file may hold more."""
LONGEST = 2**16
"""Characters of a line."""
OF_ASE = ".xyz", ".extxyz", ".traj"
"""Endings of files that ASE reads, frame by frame."""
ROUND = 1e-9
"""Part of a box's longest edge that tilts it: less is rounding."""


@dataclass(frozen=True)
class DumpFrame:
    """One frame of a trajectory, its atoms in the order of their ids.

    Attributes:
        ids: rising, shape [A]; 1, 2, … in a file without them.
        x, z: positions [Å], shape [A, 2], and third coordinates, shape [A].
        types: of the atoms, shape [A]; None without that column.
        columns: names of the file's columns.
        cell: edges of the box as rows [Å], shape [3, 3].
        unwrapped: whether positions go on beyond the box: columns xu or xsu, or images added.
    """

    ids: ndarray
    x: ndarray
    types: ndarray | None
    columns: tuple[str, ...]
    z: ndarray
    cell: ndarray
    unwrapped: bool = False

    @property
    def box(self) -> tuple[float, float] | None:
        """Periods of the box [Å]; None where it is tilted, or there is none."""
        size = np.diag(self.cell)
        if min(size[:2]) <= 0 or np.abs(self.cell - np.diag(size)).max() > ROUND * self.cell.max():
            return None
        return float(size[0]), float(size[1])


@typed
def iter_dump(path: StrPath) -> Iterator[DumpFrame]:
    """Iterate over the frames of a trajectory, one in memory at a time.

    Reads LAMMPS dumps (`dump custom`) as text or packed by gzip, bzip2, xz or zstd, with the
    columns id, x, y, z, or the wrapped, unwrapped or scaled forms of the last three; .xyz, .extxyz
    and .traj by ASE. Wrapped positions are unwrapped by the images ix, iy, iz, with a warning.

    Raises InputError for other files, an incomplete frame, ids that repeat or change, and wrapped
    atoms of a tilted box without images.
    """
    number, first = 0, None
    try:
        for frame in _frames_of(path):
            first = first or frame
            if frame is first:
                if frame.unwrapped and not {"xu", "xsu"} & set(frame.columns):
                    warn(f"{path}: unwrapped by the images ix, iy, iz")
            elif not np.array_equal(first.ids, frame.ids):
                raise ValueError("expected the ids of frame 1, got others")
            if frame.box is None and not frame.unwrapped and jumps(frame, first.x):
                raise ValueError("atoms jump by an edge of the tilted box: expected xu, yu, zu")
            yield frame
            number += 1
    except FileNotFoundError:
        raise InputError(f"{path}: no such dump") from None
    except InputError:
        raise
    except Exception as error:  # what reads a broken file runs into anything
        raise InputError(
            f"{path}: frame {number + 1} cannot be read ({error}); expected {EXPECTED}"
        ) from None
    if number == 0:
        raise InputError(f"{path}: expected {EXPECTED}; found no frame")


def jumps(frame: DumpFrame, x: ndarray) -> bool:
    """Whether any atom is half an edge of the box or more from positions x, shape [A, 2]."""
    edges = frame.cell[np.abs(frame.cell[:, :2]).max(axis=1) > ROUND * np.abs(frame.cell).max()]
    return bool((np.abs((frame.x - x) @ pinv(edges[:, :2])) >= 0.5).any())


def _frames_of(path: StrPath) -> Iterator[DumpFrame]:
    check_regular(path)
    with open(path, "rb") as file:
        head = file.read(64)
    if str(path).endswith(OF_ASE) and not head.startswith(b"ITEM:"):
        yield from _by_ase(path)
    else:
        with io.TextIOWrapper(unpacked(path, head), encoding=encoding_of(head)) as lines:
            yield from _of_lammps(lines)


def _of_lammps(file: io.TextIOWrapper) -> Iterator[DumpFrame]:
    """Iterate over the frames of a LAMMPS dump's text, each with all atoms that it announces."""
    items: dict[str, list[str]] = {}
    title, size, announced = "", 0, -1
    for line in iter(lambda: file.readline(LONGEST), ""):
        size += len(line)
        if len(line) == LONGEST or size > LARGEST_FRAME:
            raise ValueError(f"expected lines of less than {LONGEST} signs, frames {LARGEST_FRAME}")
        if not items and line.strip() and not line.startswith(BEGIN):
            raise ValueError(f"expected '{BEGIN[0]}', got {line.strip()[:60]!r}")
        if line.startswith("ITEM: ") and announced < 0:
            title = line[6:].strip()
            items[title] = []
            if title.startswith("ATOMS "):
                announced = int(items["NUMBER OF ATOMS"][0])
        elif items and line.strip():
            items[title].append(line)
        if items and len(items[title]) == announced:
            yield _of_items(items, title.split()[1:], items[title])
            items, size, announced = {}, 0, -1
    if items:
        raise ValueError(f"{announced} atoms announced, {len(items[title])} there")


def _of_items(items: dict[str, list[str]], columns: list[str], rows: list[str]) -> DumpFrame:
    """Build a frame from a dump's lines by title; raises ValueError, or what parsing runs into."""
    if (units := items.get("UNITS", ["metal"])[0].strip()) not in ANGSTROM_UNITS:
        raise ValueError(f"expected units {' or '.join(ANGSTROM_UNITS)}, got {units}")
    (bounds,) = (title for title in items if title.startswith("BOX BOUNDS"))
    if "abc" in bounds:
        raise ValueError("a box of general edges (triclinic/general yes) is not read")
    used = next((name for name in POSITIONS if name in columns), "x")
    heights = used.replace("x", "z"), "z", "zu", "zs", "zsu"  # a sheet's: nobody looks at it
    wanted = ["id", used, used.replace("x", "y"), next((h for h in heights if h in columns), "z")]
    if len({*columns}) < len(columns) or not {*wanted} <= {*columns}:
        raise ValueError(
            f"expected the columns id, x, y and z of one kind, each once, got {' '.join(columns)}"
        )
    wanted += [name for name in ("type", *IMAGES) if name in columns]
    table = np.loadtxt(rows, usecols=[columns.index(name) for name in wanted], ndmin=2)
    values = dict(zip(wanted, table.T))
    limits = np.array([[float(word) for word in line.split()] for line in items[bounds]])
    xy, xz, yz = tilt = limits[:, 2] if limits.shape[1] == 3 else np.zeros(3)
    low = limits[:, 0] - [min(0.0, xy, xz, xy + xz), min(0.0, yz), 0.0]
    high = limits[:, 1] - [max(0.0, xy, xz, xy + xz), max(0.0, yz), 0.0]
    if not (np.isfinite(limits).all() and (high >= low).all()):
        raise ValueError("expected a box of finite edges, its upper ends above the lower ones")
    cell = np.diag(high - low)
    cell[1, 0], cell[2, 0], cell[2, 1] = tilt
    x = low + table[:, 1:4] @ cell if used in ("xs", "xsu") else table[:, 1:4]
    if tilt.any() and used in ("x", "xs") and not {*IMAGES} <= {*values}:
        raise ValueError(
            f"expected xu, yu, zu in a tilted box, got {used}; or {used} with ix, iy, iz"
        )
    return _ordered(values, x, cell, columns, used in ("xu", "xsu"))


def _ordered(
    values: Values, x: ndarray, cell: ndarray, columns: Sequence[str], free: bool
) -> DumpFrame:
    """Build a frame of columns by name with atoms by rising id, checked, unwrapped by their images
    unless their positions already are `free`."""
    if not free and {*IMAGES} <= {*values}:
        free, x = True, x + np.stack([values[name] for name in IMAGES], axis=1) @ cell
    x = checked("positions", x)
    order, whole = np.argsort(values["id"]), {}
    for name in {"id", "type"} & {*values}:
        one = values[name][order]
        if not ((one >= 1) & (one < MOST) & (one % 1 == 0)).all():
            raise ValueError(f"{name}: expected whole numbers from 1")
        whole[name] = one.astype(np.int64)
    ids, x = whole["id"], x[order]
    if (twice := ids[1:][ids[1:] == ids[:-1]]).size:
        raise ValueError(f"the id {twice[0]} comes twice")
    return DumpFrame(ids, x[:, :2], whole.get("type"), tuple(columns), x[:, 2], cell, free)


def _xyz_frames(lines: TextIO) -> Iterator[str]:
    """Iterate over the texts of an xyz file's frames; ValueError for one without what it claims."""
    line = lines.readline()
    while line.strip():
        rows, count = [line, *islice(lines, 1 + int(line))], int(line)
        columns = str(key_val_str_to_dict(rows[1]).get("Properties")).split(":")[2::3]
        if len(rows) < 2 + count or sum(abs(int(one)) for one in columns) > sum(map(len, rows)):
            raise ValueError("expected atoms and columns that are there, as it claims")
        while (line := lines.readline()).lstrip().startswith("VEC"):
            rows.append(line)
        yield "".join(rows)


def _by_ase(path: StrPath) -> Iterator[DumpFrame]:
    """Iterate over frames read by ASE, types by atomic number, ids a column or the file's order."""
    with open(path, encoding="utf-8-sig") as lines:  # never by what it looks like
        found: Any = (ase.io.read(io.StringIO(t), format="extxyz") for t in _xyz_frames(lines))
        if str(path).endswith(".traj"):
            found = ase.io.iread(os.fspath(path), ":", "traj", do_not_split_by_at_sign=True)
        for atoms in found:
            types = 1 + np.unique(atoms.numbers, return_inverse=True)[1]
            values = {"id": np.arange(1, len(atoms) + 1)} | atoms.arrays | {"type": types}
            cell = np.array(atoms.cell) * atoms.pbc[:, None]
            yield _ordered(values, atoms.positions, cell, [*atoms.arrays], free=False)


FORMATS = (
    "aims, cfg, cif, espresso-in, extxyz, gen, gromacs, lammps-data, lammps-dump-text, "
    "proteindatabank, traj, vasp, vasp-xml, xsf"
)
"""Those of ASE whose readers open no other file and run nothing."""
CLAIMS = (
    r"(?m)NUMBER OF ATOMS.*\n\s*\S+|^\s*\S+\s+atoms\s*(?:#.*)?$|(?:particles|entry_count)\s*=\s*\S+"
)
"""Where a text says how much of something follows."""


def _check_claims(form: str, path: StrPath) -> None:
    """Raise ValueError for a file that claims more atoms or columns than it has signs."""
    with open(path, encoding="utf-8", errors="replace") as lines:
        if form == "extxyz":
            for _ in _xyz_frames(lines):
                pass
        text = "" if form in ("extxyz", "traj") else lines.read()
    said = text.split("\n")[5:7] if form == "vasp" else re.findall(CLAIMS, text)
    counts = re.findall(r"(?<![^\s=])\+?(\d[\d_]*)(?!\S)", re.sub("[!#].*", "", "\n".join(said)))
    if sum(map(int, counts)) > len(text):
        raise ValueError("expected atoms and columns that are there, as it claims")


LARGEST_HEADER = 2**16
"""Bytes of a file of atoms by which its kind is told."""


@typed
def read_structure(path: Path) -> Any:
    """Read the last structure of a file, packed or not, by ASE; InputError for any other file.
    Refuses dumps without elements and data files without masses: types are no atomic numbers."""
    if path.is_dir():
        raise InputError(f"{path}: expected a file; a folder of phonopy goes without a calculator")
    whole = content(path)
    check_xml(path, whole)
    if whole.startswith(MARKS):
        whole = whole.decode(encoding_of(whole), "replace").encode()
    head = whole[:LARGEST_HEADER]
    of_lammps = re.search(rb"xlo\s+xhi", head)
    if head.startswith(b"ITEM:") and b" element" not in head:
        raise InputError(f"{path}: expected a structure with its elements, got a dump without")
    if of_lammps and not re.search(rb"(?m)^\s*Masses", head):
        raise InputError(f"{path}: expected the masses of the types in a data file, got none")
    packed = path.suffix.lower() in (".gz", ".bz2", ".xz", ".zst")
    with tempfile.TemporaryDirectory() as folder:  # ASE goes by the ending alone
        readable = Path(folder, path.stem if packed else path.name)
        readable.write_bytes(whole)
        try:
            form = "lammps-data" if of_lammps else filetype(str(readable))
            if form not in FORMATS.split(", "):
                also = "ase.io.read gives Atoms, which fit_crystal takes too"
                raise InputError(f"expected one of {FORMATS}, got {form}; {also}")
            _check_claims(form, readable)
            return ase.io.read(str(readable), -1, form, do_not_split_by_at_sign=True)
        except Exception as error:  # ASE's readers raise whatever their parsing runs into
            why = str(error)
            if not isinstance(error, InputError):
                why = f"ASE reads no structure from it ({type(error).__name__}: {error})"
                why += f"; expected one of {FORMATS}"
            if "atom_style" in why:
                why += "; a data file of LAMMPS says it behind Atoms, as in: Atoms # charge"
            raise InputError(f"{path}: {why}") from None


TORN, NEAR = 1.5, 1.3
"""Lengths of a bond that broke, over what it was, and of bonds over the usual one."""


@typed
def read_masses(path: StrPath, masses: Sequence[float]) -> ndarray:
    """Mass of every atom of a dump's first frame, [A] by id, from the masses of types 1, 2, …"""
    frame = next(iter_dump(path))
    if frame.types is None:
        raise InputError(f"{path}: expected the columns id and type, got {' '.join(frame.columns)}")
    if (most := frame.types.max()) > len(masses):
        raise InputError(
            f"masses: expected one for each of the types 1 to {most} of {path}, got {len(masses)}"
        )
    each = checked("masses", masses, float, ("T",))
    return masses_of(each[frame.types - 1], len(frame.types))


@typed
def mean_displacement(
    path: StrPath,
    reference: ArrayLike,
    *,
    ids: ArrayLike | None = None,
    box: tuple[float, float] | None = None,
    skip: Natural = 0,
) -> ndarray:
    """Mean displacement from the reference [Å] over the frames of a dump, shape [A, 2].

    Args:
        path: as for iter_dump.
        reference: positions without load [Å], shape [A, 2], by id.
        ids: of the atoms of the reference, rising, shape [A]; None takes the dump's.
        box: periods of the atoms [Å], for dumps of wrapped positions; None for a free body.
        skip: frames at the begin that are left out.

    Raises InputError for other atoms, a box other than the header's, atoms beyond half the box
    without one, and too few frames.
    """
    reference = checked("reference", reference, shape=("A", 2))
    ids = None if ids is None else plain("ids", ids)
    total, frames = np.zeros_like(reference), 0
    for frames, frame in enumerate(iter_dump(path), 1):
        x = frame.x
        if x.shape != reference.shape:
            raise InputError(f"{path}: expected {len(reference)} atoms, got {len(x)}")
        if ids is not None and not np.array_equal(frame.ids, ids):
            raise InputError(f"{path}: expected the ids of the reference's atoms, got others")
        if box is not None:
            check_box(path, box, frame.box, 1e-5)
        if frames <= skip:
            continue
        if box is None and not frame.unwrapped and jumps(frame, reference):
            raise InputError(f"{path}: box: atoms moved beyond half the box; are they wrapped?")
        total += nearest(x - reference, box)
    if frames <= skip:
        raise InputError(f"{path}: expected more than {skip} frames, got {frames}")
    return total / (frames - skip)


@typed
def check_box(
    path: StrPath, box: tuple[float, float], header: tuple[float, float] | None, tolerance: float
) -> None:
    """Raise InputError unless periods agree with a dump's header within the relative tolerance."""
    if header is None:
        raise InputError(f"{path}: box: expected an orthogonal box in the dump, got a tilted one")
    sides = checked("header", header, shape=(2,))
    if not np.allclose(checked("box", box, shape=(2,)), sides, rtol=tolerance, atol=0):
        wanted, got = (" x ".join(f"{L:.9g}" for L in one) for one in (sides, box))
        raise InputError(f"{path}: box: expected the header's {wanted} Å, got {got} Å")


@typed
@dataclass(frozen=True)
class ReferenceAtoms:
    """Atoms of the dumps: reference positions without load [Å], [A, 2], by id, and mass [A] or of
    all. The mass is in any unit; ids and box are as of `mean_displacement`."""

    reference: ArrayLike
    mass: ArrayLike = 1.0
    ids: ArrayLike | None = None
    box: tuple[float, float] | None = None


UNLIKE = 1.1
"""Times that loads per mass of two species may differ without a word."""
SPECIES = 20
"""Masses above which they are no species, but each atom's own."""


@typed
def coarse_grain_dumps(
    dumps: Sequence[StrPath],
    omega: sp.csr_array,
    points: PointsLike,
    atoms: ReferenceAtoms,
    *,
    force: ArrayLike,
    node_area: Positive,
    thickness: Positive,
    unloaded: Sequence[StrPath] = (),
    skip: Natural = 0,
    progress: bool = False,
) -> Samples:
    """Coarse-grain dumps, one for each load, to samples on the nodes `points`.

    Args:
        omega, node_area, thickness: as for coarse_grain.
        force: external forces on the atoms of each load [eV/Å], shape [S, A, 2].
        unloaded: dumps without load, one for each load or for all, whose displacement is
            subtracted: runs of one Langevin seed share most of their noise.
        skip: frames at the begin of each dump that are left out.

    Warns of forces not shared among species by mass, types without masses, and torn sheets.
    Raises InputError as its parts do, and for forces or dumps that do not belong together.
    """
    if not len(dumps) or len(unloaded) not in (0, 1, len(dumps)):
        raise InputError(
            "dumps, unloaded: expected 1 or more, and 0, 1 or as many, got "
            f"{len(dumps)} and {len(unloaded)}"
        )
    reference = checked("reference", atoms.reference, shape=("A", 2))
    force = checked("force", force, shape=(len(dumps), len(reference), 2))
    mass, nodes = masses_of(atoms.mass, len(reference)), nodes_of(points)
    if sp.issparse(omega):
        check_shape("omega", omega, (len(nodes.x), len(reference)))
    fields: Values = {"force": force, "mass": mass, "node_area": node_area}
    fields["thickness"] = thickness
    coarse_grain(omega, displacement=0 * force, **fields)  # refuses before dumps are read
    _warn_of_shares(force, mass)
    first = next(iter_dump(dumps[0]))
    if np.ndim(atoms.mass) == 0 and first.types is not None and np.ptp(first.types):
        warn(f"mass: {dumps[0]} has atoms of several types, all taken as equal: give each its mass")
    ids = first.ids if atoms.ids is None else atoms.ids
    averages = []
    for path in tqdm([*unloaded, *dumps], desc="dumps", unit="dump", disable=not progress):
        averages.append(mean_displacement(path, reference, ids=ids, box=atoms.box, skip=skip))
        _warn_of_torn(Path(path), reference, averages[-1], atoms.box)
    moved = np.stack(averages[len(unloaded) :])
    if len(unloaded):
        moved -= np.stack(averages[: len(unloaded)])
    u, b = coarse_grain(omega, displacement=moved, **fields)
    return Samples(nodes, u, b, {"load_id": np.array([Path(path).name for path in dumps])})


def _warn_of_shares(force: ndarray, mass: ndarray) -> None:
    """Warn where forces are not shared among species as their masses are."""
    kinds = np.unique(mass)
    if not force.size or len(kinds) > SPECIES:
        return
    size = [np.sqrt(np.square(force[:, mass == one]).mean()) / one for one in kinds]
    if max(size) > UNLIKE * min(size):
        warn(
            f"force: atoms of masses {', '.join(f'{one:g}' for one in kinds)} carry loads per mass "
            f"of {', '.join(f'{each / max(size):.2g}' for each in size)}, relative: expected a "
            "load over the atoms of a cell by mass; otherwise they move against each other"
        )


def _warn_of_torn(path: Path, x: ndarray, moved: ndarray, box: tuple[float, float] | None) -> None:
    """Warn of neighbouring atoms that are further apart than nodes can follow."""
    near = cKDTree(x if box is None else x % box, boxsize=box).query(x, k=min(7, len(x)))[1][:, 1:]
    apart = nearest(x[near] - x[:, None], box)
    length = norm(apart, axis=-1)
    longer = norm(apart + moved[near] - moved[:, None], axis=-1) > TORN * length
    usual = np.median(length[:, :3].max(axis=1, initial=0.0))
    bonds = (length > usual / NEAR) & (length < NEAR * usual)  # no atoms above each other
    if count := (longer & bonds).any(axis=1).sum():
        warn(
            f"{path.name}: {count} of {len(x)} atoms are {TORN - 1:.0%} or more further from a "
            "neighbour than without load: the sheet is torn, and no smooth field describes it"
        )
