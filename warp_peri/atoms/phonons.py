"""Force constants and phonons of a structure, by its calculator or by phonopy."""

from __future__ import annotations

import io
import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import ase
import h5py
import numpy as np
from ase.data import atomic_masses
from numpy import ndarray
from numpy.linalg import det, eigh, eigvalsh, inv, norm

from warp_peri.atoms.calculator_noise import TIMES, projected, rattled
from warp_peri.atoms.calculators import Asked
from warp_peri.atoms.force_constants import (
    EDGE,
    STEP,
    TINY,
    WIDER,
    ForceConstants,
    NonAnalyticCorrection,
    forces_of,
    from_supercell,
)
from warp_peri.atoms.relaxed import VACUUM, Reference, check_sites, gap, oriented, thickness_of
from warp_peri.errors import InputError, Several, Shape, StrPath, optional, warn
from warp_peri.files.atomic import check_hdf5, check_yaml, content
from warp_peri.points.arguments import ArrayMap, Positive, checked, offered, typed
from warp_peri.points.points import grid_points, whole_numbers

WIDTHS = 10.0, 14.0, 18.0, 22.0, 26.0, 32.0, 40.0
"""Of supercells [Å], tried in turn."""
DECAYED_FORCE, DECAYED_FORCE_ROUGH = 1e-5, 0.05
"""Force at half the width of a supercell, over the largest, that is none; that of a surface that
is rough, whose forces far away are no noise."""
MOST_ATOMS, NOISY_ATOMS, MOST_ASKED = 6000, 700, 10**6
"""In a supercell; where forces are noisy strains tell moduli better than what is further away. One
that is asked for may have more."""
GRID = {2: 24, 3: 8}
"""Wave vectors along each reciprocal edge that are looked at for soft modes."""
SOFT = 1e-5
"""Of the largest eigenvalue: a negative one beyond it is no rounding."""
LOOSE = (
    "structure: parts of it feel no force from the rest; expected one crystal, without loose atoms "
    "or layers"
)
THZ = 15.633302
"""√(eV/Å²/amu) / 2π [THz]."""


def force_constants(
    reference: Reference, calculator: Any, supercell: Sequence[int] | None = None
) -> tuple[ForceConstants, dict[str, str]]:
    """Force constants of a crystal at rest by finite differences, and notes on them by name.

    Under noise all atoms are displaced at once (`rattled`). By default the supercell is the
    smallest at half whose width a displaced atom's forces have ended.
    """
    d, cell = reference.dimension, reference.cell
    if "born_effective_charges" in getattr(calculator, "implemented_properties", ()):
        warn("calculator: its Born charges are not read; a folder of phonopy with BORN has them")
    if supercell is None:
        repeats = wide_enough(reference, calculator, WIDTHS)
    else:
        repeats = counted("supercell", supercell, len(cell), flat=d == 2)
    many, how = cell.repeat(repeats), {"thickness": reference.thickness, "stress": reference.stress}
    said: dict[str, str] = {}
    if reference.noise.rounding:
        found = _by_differences(cell, many, calculator, **how)
    else:
        found, said = rattled(cell, many, calculator, reference.noise, **how)
    check_phonons(found)
    return found, {"force constants": f"{_cells(repeats[:d])}, {len(many)} atoms"} | said


def counted(name: str, repeats: Any, atoms: int, *, flat: bool = False) -> Shape:
    """Check how often a cell of so many atoms is repeated: one atom alone has no forces."""
    counts = whole_numbers(name, repeats)
    many = 1 < atoms * math.prod(counts) <= MOST_ASKED
    if len(counts) != 3 or (flat and counts[2] != 1) or not many:
        what = f"three counts ≥ 1{', a sheet’s third 1,' * flat} and 2 to {MOST_ASKED} atoms"
        raise InputError(f"{name}: expected {what}, got {counts}")
    return counts


def _cells(repeats: Sequence[int]) -> str:
    return f"{' x '.join(map(str, repeats))} cells"


def wide_enough(reference: Reference, calculator: Any, widths: Sequence[float]) -> Shape:
    """Repeats of the cell at half of whose width forces have ended, or the most that may be."""
    cell, d = reference.cell, reference.dimension
    heights = 1 / norm(inv(np.array(cell.cell)), axis=0)
    most = MOST_ATOMS if reference.noise.rounding else NOISY_ATOMS
    repeats, rim = (), np.nan
    for width in widths:
        count = np.where(np.arange(3) < d, np.ceil(width / heights), 1).astype(int)
        many = cell.repeat(wider := tuple(count.tolist()))
        if repeats and len(many) > most:
            break
        rim, none = _at_rim(many, calculator, (count * heights)[:d].min(), reference)
        repeats = wider
        if rim <= none:
            return repeats
    warn(
        f"supercell: at half the width of {_cells(repeats[:d])} forces still are {rim:.1e} of the "
        "largest; supercell=… takes a wider one"
    )
    return repeats


def _at_rim(
    many: ase.Atoms, calculator: Any, width: float, reference: Reference
) -> tuple[float, float]:
    """Relative force at half a supercell's width from a displaced atom, and what counts as none."""
    noise, x, rim = reference.noise, np.array(many.positions), 0.0
    none = DECAYED_FORCE_ROUGH if noise.rough else DECAYED_FORCE
    forces = forces_of(many, calculator)
    still, far = forces(x), many.get_distances(0, range(len(many)), mic=True)
    for axis in range(reference.dimension):
        moved = x.copy()
        moved[0, axis] += STEP if noise.rounding else noise.length
        change = np.abs(forces(moved) - still).max(axis=1)
        if not change.max() > 0:
            raise InputError(LOOSE)
        rim = max(rim, change[far > EDGE * width].max(initial=0.0) / change.max())
        none = max(none, TIMES**2 * noise.force / change.max())
    return rim, none


def check_phonons(atoms: ForceConstants) -> None:
    """Raise InputError for imaginary phonons on a grid of waves, and for loose parts. A sheet's
    mean height is held, so that its bending is not looked at."""
    d = atoms.dimension
    parts = grid_points(np.arange(GRID[d]) / GRID[d], d)
    parts = np.where(parts > 0.5, parts - 1, parts)
    parts = parts[parts @ [1.0, 1e-3, 1e-6][:d] >= 0]
    k, size, waves = _phonons(atoms, parts)
    worst = size[:, 0].argmin()
    least, top = size[worst, 0], size[:, -2 if d == 2 else -1].max()  # a sheet's last is held
    error = atoms.stiffness_error(k[worst], waves[worst, 0])
    if least >= -max(SOFT * top, TIMES * error):
        if eigvalsh(atoms.dynamical(k))[:, 0].max() <= SOFT * np.abs(atoms.values).max():
            raise InputError(LOOSE)
        return
    imaginary = THZ * np.sqrt(-least)
    bar = f" ± {imaginary * error / (-2 * least):.2g}" if error > SOFT * top else ""
    raise InputError(
        f"structure: expected a stable crystal, got an imaginary phonon, the worst of "
        f"{imaginary:.2f}{bar}i THz at k = {np.round(parts[worst], 4).tolist()} of the reciprocal "
        f"edges ({np.round(k[worst], 4).tolist()} 1/Å); relax it in a larger cell"
    )


def _phonons(atoms: ForceConstants, parts: ndarray) -> Several:
    """Phonons at fractions [K, d] of reciprocal edges: k [1/Å], ω², modes/√mass [K, 3 n, n, 3]."""
    d = atoms.dimension
    k = 2 * np.pi * parts @ inv(atoms.cell[:d, :d]).T
    weight = 1 / np.sqrt(np.repeat(atomic_masses[atoms.species], 3))
    size, modes = eigh(atoms.dynamical(k, moving=3) * weight * weight[:, None])
    return k, size, (modes.mT * weight).reshape(*size.shape, -1, 3)


def at_zone_edge(atoms: ForceConstants) -> tuple[float, float, float]:
    """Softest phonon [THz] at halves of the reciprocal edges, its error, and the largest error."""
    parts = grid_points((0, 0.5), atoms.dimension)[1:]
    k, size, waves = _phonons(atoms, parts)
    off = np.array([atoms.stiffness_error(*pair) for pair in zip(k, waves)])
    low, middle, high = (THZ * np.sqrt(np.clip(size + way * off, 0, None)) for way in (-1, 0, 1))
    soft, error = middle.argmin(), (high - low) / 2
    return middle.flat[soft], error.flat[soft], error.max()


def finite_differences(
    forces: ArrayMap, positions: ndarray, displaced: Sequence[int]
) -> tuple[ndarray, float]:
    """Force constants Φ [eV/Å²] of some atoms with all, by fourth-order differences, [n, N, 3, 3].

    Also returns the relative change of Φ from one step to one five times as wide: 1e-3 or less
    where the energy is smooth.
    """
    phi, change = np.zeros((len(displaced), len(positions), 3, 3)), 0.0
    for (row, i), axis in itertools.product(enumerate(displaced), range(3)):
        near, wide = slopes = np.zeros((2, len(positions), 3))
        for slope, length in zip(slopes, (STEP, WIDER * STEP)):
            for sign in 1, -1:
                moved = positions.copy()
                moved[i, axis] += sign * length
                slope += sign * forces(moved) / (2 * length)
        phi[row, :, axis] = -(WIDER**2 * near - wide) / (WIDER**2 - 1)
        change = max(change, np.abs(near - wide).max())
    return phi, change / max(np.abs(phi).max(), TINY)


@typed
def from_calculator(
    structure: Any, calculator: Any, repeats: Sequence[int], *, thickness: Positive | None = None
) -> ForceConstants:
    """Force constants of a crystal at rest, an ase.Atoms, by an ASE calculator on a supercell.
    `repeats` of the cell must be wider than twice what forces reach; `thickness` of a sheet, which
    lies across z [Å]. InputError for that of a solid, and for a sheet without."""
    repeat = offered(structure, "repeat", "from_calculator", "an ase.Atoms")
    if oriented(structure, False, thickness)[1] and thickness is None:
        raise InputError("thickness: the structure is a sheet, whose thickness [Å] is missing")
    if structure.cell.rank < 3:
        raise InputError("structure: expected three edges; atoms.center(10, 2) makes a sheet's")
    many = repeat(counted("repeats", repeats, len(structure)))
    return _by_differences(structure, many, Asked(calculator), thickness=thickness)


def _by_differences(cell: Any, many: Any, calculator: Any, **how: Any) -> ForceConstants:
    first = range(len(cell))
    phi, change = finite_differences(forces_of(many, calculator), many.positions, first)
    return replace(from_supercell(cell, many, phi, first, **how), change=change)


WITHOUT = "phonopy: pip install 'warp_peri[phonons]'"
FACTOR = 0.01
"""Relative, within which a factor of charges is that of the code's units."""
MOST = 20_000
"""Atoms of a supercell."""
YAML = "phonopy.yaml", "phonopy_params.yaml", "phonopy_disp.yaml"


@typed
def from_phonopy(path: StrPath, *, thickness: Positive | None = None) -> ForceConstants:
    """Read the force constants that phonopy computed.

    They are symmetrised (space group, exchange of atoms, translations, rotations); how far they
    move is their error. With Born charges the field of the ions is part of every wave (theory,
    T18); a solid of several elements without BORN is warned of.

    `path` is phonopy.yaml, phonopy_params.yaml or phonopy_disp.yaml, or its folder; only
    FORCE_CONSTANTS, force_constants.hdf5, FORCE_SETS and BORN beside it are read, in phonopy's
    units. `thickness` of a sheet across z [Å] is as of `fit_crystal`. Raises InputError without
    phonopy or forces, for files it cannot read, for charges of a sheet.
    """
    path = Path(path)
    file = next(filter(Path.is_file, (path, *(path / name for name in YAML))), None)
    if file is None:
        raise InputError(
            f"{path}: expected a file of phonopy or a folder with {' or '.join(YAML)}; "
            "`phonopy-init --dim …` (once `phonopy -d`) writes the last beside a code's unit cell"
        )
    names = "FORCE_CONSTANTS", "force_constants.hdf5", "FORCE_SETS", "BORN"
    beside = {name: file.parent / name for name in names if (file.parent / name).is_file()}
    try:
        found, told = _opened(file)
        force_constants = _force_constants(found, told, beside)
        ions, reader = told.nac_params, optional("phonopy.file_IO", WITHOUT)
        if "BORN" in beside:  # all its rows, which an empty one would end
            rows = "\n".join(filter(str.strip, content(beside["BORN"]).decode().split("\n")))
            ions = reader.parse_BORN_from_strings(rows, found.primitive)
        codes = optional("phonopy.interface.calculator", WITHOUT)
        units = codes.get_calculator_physical_units(found.calculator)
        usual = units.nac_factor
        if not abs((ions or {}).get("factor", usual) / usual - 1) <= FACTOR:
            raise InputError(f"BORN: expected the factor {usual:.6g} or none, got {ions['factor']}")
    except Exception as error:  # phonopy raises whatever its parsing runs into
        raise InputError(
            f"{path}: phonopy does not read {', '.join([file.name, *beside])} ({error})"
        ) from None
    if force_constants is None:
        raise InputError(f"{path}: expected FORCE_CONSTANTS or FORCE_SETS beside it, found neither")
    small, x = found.primitive, units.distance_to_A
    cell, supercell = (
        ase.Atoms(part.numbers, positions=x * part.positions, cell=x * part.cell, pbc=True)
        for part in (small, found.supercell)
    )
    check_sites(cell)
    if small.magnetic_moments is not None:  # sites that they tell apart are no images
        cell.set_initial_magnetic_moments(small.magnetic_moments)
    displaced = np.asarray(small.p2s_map).tolist()
    phi = units.force_to_eVperA / x * checked("force constants", force_constants)
    phi = phi[displaced] if len(phi) == len(supercell) else phi
    if gap(cell, 2)[0] >= VACUUM and thickness is None:
        thickness = thickness_of(cell)[0]
    polar = None
    if ions is not None:
        polar = NonAnalyticCorrection(ions["born"], ions["dielectric"])
    elif thickness is None and len(set(cell.numbers)) > 1:
        warn(f"{file.parent}: no BORN is there; the field of ions with charges misses in its waves")
    if thickness is not None and polar is None and np.abs(cell.cell[:2, 2]).max() > 1e-6:
        raise InputError(f"{path}: expected a sheet across z")
    return projected(cell, supercell, phi, displaced, thickness=thickness, polar=polar)


def _opened(file: Path) -> tuple[Any, Any]:
    """Open a phonopy file: phonopy's crystal, and the file's content."""
    text = content(file)
    check_yaml(file, text)
    told = optional("phonopy.interface.phonopy_yaml", WITHOUT).PhonopyYaml()
    told.read(io.StringIO(text.decode()))
    if getattr(told, "site_mixture_scheme", None) is not None:
        raise InputError("site_mixture_scheme: sites of several elements are not read")
    block = re.search(rb"(?m)^supercell_matrix:[^a-z]*", text)  # phonopy cuts off what is no count
    if block and (part := re.search(rb"\d*\.\d*[1-9]", block[0])):
        raise InputError(f"supercell_matrix: expected whole numbers, got {part[0].decode()}")
    matrix, primitive = told.supercell_matrix, told.primitive_matrix
    matrix = np.eye(3, dtype=int) if matrix is None else matrix
    cells = abs(det(matrix))
    if cells * len(told.unitcell) > MOST:
        raise InputError(f"supercell_matrix: expected at most {MOST} atoms, got {cells:.0f} cells")
    primitive = "auto" if primitive is None else primitive
    made = optional("phonopy", WITHOUT).Phonopy
    return made(told.unitcell, matrix, primitive, calculator=told.calculator, log_level=0), told


def _force_constants(found: Any, told: Any, beside: dict[str, Path]) -> Any:
    """Force constants of phonopy's file, else of those beside it, else of its forces; or None."""
    reader, rows = optional("phonopy.file_IO", WITHOUT), found.primitive.p2s_map
    n, count, data = len(rows), len(found.supercell), told.dataset or {}
    if told.force_constants is not None:
        return told.force_constants
    if path := beside.get("FORCE_CONSTANTS"):
        got = _counts(path, 11)
        if got not in ([count, count**2], [count, count, count**2], [n, count, n * count]):
            raise InputError(
                f"FORCE_CONSTANTS: expected {n} or {count}, {count}, and a tensor for each pair of "
                f"atoms, got {got}"
            )
        return reader.parse_FORCE_CONSTANTS(filename=path, p2s_map=rows)
    if path := beside.get("force_constants.hdf5"):
        with h5py.File(path) as held:
            check_hdf5(held)
        by = optional("phonopy.cui.load_helper", WITHOUT).read_force_constants_from_hdf5
        return by(path, rows, found.calculator)
    if "forces" not in data | data.get("first_atoms", [{}])[0]:
        if not (path := beside.get("FORCE_SETS")):
            return None
        got = _counts(path, 4 + 3 * count)
        if not got[-1] or (got != [count, got[-1], got[-1]] and len(_counts(path, 6 * count)) > 1):
            raise InputError(
                f"FORCE_SETS: expected {count}, a count and as many sets of {4 + 3 * count} "
                f"numbers, or sets of {6 * count}, got {got[-1]} sets behind {got[:2]}"
            )
        data = reader.parse_FORCE_SETS(natom=count, filename=path)
    for one in data.get("first_atoms", []):
        if one["number"] not in range(count) or not norm(one["displacement"]) > 0:
            raise InputError(
                f"displacement: expected one of an atom from 1 to {count}, got "
                f"{one['displacement']} of {one['number'] + 1}"
            )
    found.dataset = data
    by = "symfc" if "displacements" in data else None
    found.produce_force_constants(calculate_full_force_constants=False, fc_calculator=by)
    return found.force_constants


def _counts(path: Path, width: int) -> list[float]:
    """Numbers of a text file before its rows of that width, and how many rows there are."""
    words = content(path).split()
    return [*map(float, words[: len(words) % width]), len(words) // width]
