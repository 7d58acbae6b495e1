"""Displacement of atoms from their trajectories, reduced frame by frame, whatever their length."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import ase
import ase.io
import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from tqdm import tqdm

from warp_peri.errors import InputError
from warp_peri.files.atomic import whole_file
from warp_peri.points.arrays import checked
from warp_peri.points.interpolation import interpolation, mean_spacing
from warp_peri.points.samples import PointsLike, Samples, nodes_of
from warp_peri.sources.coarse_graining import coarse_grain
from warp_peri.sources.dump_files import Frame, dump_frames, jumps

BOX_TOLERANCE = 1e-5
"""Relative difference of a given period from that of a dump's header."""
TORN, NEAR = 1.5, 1.3
"""Lengths of a bond that broke, over what it was, and of bonds over the usual one."""


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
    reference = checked("reference", reference, shape=("A", 2))
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
        elif jumps(frame, reference):
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


UNLIKE = 1.1
"""Times that loads per mass of two species may differ without a word."""
SPECIES = 20
"""Masses above which they are no species, but each atom's own."""


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

    Warns of forces that are not shared among species as their masses are, and of torn sheets.
    Raises InputError as its parts do, and for forces or unloaded dumps that do not fit, or whose
    ids differ.
    """
    if not len(dumps):
        raise InputError("dumps: expected one or more, got none")
    if len(unloaded) not in (0, 1, len(dumps)):
        raise InputError(f"unloaded: expected 0, 1 or {len(dumps)} dumps, got {len(unloaded)}")
    force = checked("force", force, shape=(len(dumps), "A", 2))
    ids = atoms.ids
    _warn_of_shares(force, np.broadcast_to(np.asarray(atoms.mass, float), force.shape[1]))
    if ids is None and len(dumps):
        ids = next(dump_frames(dumps[0])).ids

    def displacement(path: str | os.PathLike[str]) -> np.ndarray:
        return dump_displacement(
            path, atoms.reference, ids=ids, box=atoms.box, skip=average.skip, iota=average.iota
        )

    bar = tqdm([*unloaded, *dumps], desc="dumps", unit="dump", disable=not progress)
    averages = [displacement(path) for path in bar]
    for path, moved in zip((*unloaded, *dumps), averages):
        _warn_of_torn(Path(path), np.asarray(atoms.reference, dtype=float), moved, atoms.box)
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


def _warn_of_shares(force: np.ndarray, mass: np.ndarray) -> None:
    """Say where the forces of loads are not shared among species as their masses are."""
    kinds = np.unique(mass)
    if not force.size or len(kinds) > SPECIES:
        return
    size = [np.sqrt(np.square(force[:, mass == one]).mean()) / one for one in kinds]
    if max(size) > UNLIKE * min(size):
        shares = ", ".join(f"{each / max(size):.2g}" for each in size)
        warnings.warn(
            f"force: atoms of masses {', '.join(f'{one:g}' for one in kinds)} carry loads per mass "
            f"of {shares}, relative: what a cell's mean by mass does then is not the answer to its "
            "load alone; a load is to go over the atoms of a cell by mass",
            stacklevel=3,
        )


def _warn_of_torn(
    path: Path, x: np.ndarray, moved: np.ndarray, box: tuple[float, float] | None
) -> None:
    """Say how many of the neighbours of atoms are further apart than nodes can follow."""
    near = cKDTree(x if box is None else x % box, boxsize=box).query(x, k=min(7, len(x)))[1][:, 1:]
    apart = x[near] - x[:, None]
    if box is not None:
        apart = apart - np.rint(apart / box) * np.asarray(box)
    length = np.linalg.norm(apart, axis=-1)
    longer = np.linalg.norm(apart + moved[near] - moved[:, None], axis=-1) > TORN * length
    usual = np.median(length[:, :3].max(axis=1, initial=0.0))
    bonds = (length > usual / NEAR) & (length < NEAR * usual)  # no atoms above each other
    if count := int((longer & bonds).any(axis=1).sum()):
        warnings.warn(
            f"{path.name}: {count} of {len(x)} atoms are {TORN - 1:.0%} or more further from a "
            "neighbour than without load: the sheet is torn there, and no field on nodes is what "
            "they do",
            stacklevel=3,
        )


def write_atoms(
    path: str | os.PathLike[str],
    frame: Frame,
    displacement: ArrayLike,
    points: PointsLike,
    u: ArrayLike,
    *,
    symbols: Sequence[str] = ("C",),
) -> int:
    """Displacement of atoms, of the model at their places, and the difference, as extxyz.

    OVITO shows the columns displacement, model and error as they are. Atoms further than a spacing
    from every node are left out.

    Args:
        path: of the file to write, .extxyz.
        frame: where the atoms are without load, as of dump_frames.
        displacement: of the atoms [Å], shape [A, 2], by id.
        points: nodes of the model, in Å.
        u: the model's displacement on them [Å], shape [N, 2].
        symbols: of the types 1, 2, … of the frame.

    Returns how many atoms were written. Raises InputError for shapes that do not fit, types without
    a symbol, or atoms that are all away from the nodes.
    """
    nodes = nodes_of(points)
    displacement = checked("displacement", displacement, shape=frame.x.shape)
    u = checked("u", u, shape=nodes.x.shape)
    types = np.ones(len(frame.x), int) if frame.types is None else frame.types
    if types.min() < 1 or types.max() > len(symbols):
        raise InputError(f"symbols: expected one for each type up to {types.max()}, got {symbols}")
    near = cKDTree(nodes.x).query(frame.x)[0] <= (nodes.spacing or mean_spacing(nodes))
    if not near.any():
        raise InputError("points: expected nodes around the atoms, all atoms are away from them")
    model = interpolation(nodes.x, frame.x[near]) @ u
    atoms = ase.Atoms(
        [symbols[kind - 1] for kind in types[near]],
        positions=np.column_stack([frame.x, frame.z])[near],
        cell=frame.cell,
    )
    atoms.arrays["id"] = frame.ids[near]
    moved = displacement[near]
    for name, field in (("displacement", moved), ("model", model), ("error", model - moved)):
        atoms.arrays[name] = np.pad(field, ((0, 0), (0, 1)))
    with whole_file(path) as part:
        ase.io.write(part, atoms, format="extxyz")
    return int(near.sum())
