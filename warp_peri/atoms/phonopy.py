"""Folders that phonopy computed: force constants, with the charges of ions."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any

import ase
import h5py
import numpy as np

from warp_peri.atoms.calculator_noise import projected
from warp_peri.atoms.force_constants import ForceConstants
from warp_peri.atoms.ions import NonAnalyticCorrection
from warp_peri.atoms.relaxed import VACUUM, check_sites, gap, thickness_of
from warp_peri.errors import InputError, optional, warn
from warp_peri.files.foreign import check_hdf5, check_yaml, content
from warp_peri.points.arguments import Positive, typed

WITHOUT = "phonopy: pip install 'warp_peri[phonons]'"
MOST = 20_000
"""Atoms of a supercell."""
BESIDE = ("FORCE_CONSTANTS", "force_constants.hdf5", "FORCE_SETS", "BORN")
"""Files that are read where they lie beside the one that is named."""
YAML = ("phonopy.yaml", "phonopy_params.yaml", "phonopy_disp.yaml")


@typed
def from_phonopy(
    path: str | os.PathLike[str], *, thickness: Positive | None = None
) -> ForceConstants:
    """Force constants of what phonopy computed.

    Beside phonopy.yaml may lie FORCE_CONSTANTS, force_constants.hdf5, FORCE_SETS and BORN; nothing
    is read of any other folder. Units are those that phonopy has for the code it names.
    Force constants are brought to what space group, exchange of atoms, translations and rotations
    ask, and how far they move is their error. With Born charges the field of the ions is part of
    every wave (theory, T18); a solid of several elements without BORN is warned of.

    Args:
        path: phonopy.yaml, phonopy_params.yaml or phonopy_disp.yaml, or the folder that has one.
        thickness: of a sheet across z [Å]; by default as `fit_crystal` has it.

    Raises InputError where phonopy is not installed, for files that it does not read, for forces
    that are not there, and for Born charges of a sheet.
    """
    file = _yaml(Path(path))
    beside = {name: file.parent / name for name in BESIDE if (file.parent / name).is_file()}
    try:
        found, told = _opened(file, beside)
        force_constants = _force_constants(found, told, beside)
        ions, reader = told.nac_params, optional("phonopy.file_IO", WITHOUT)
        if "BORN" in beside:
            ions = reader.parse_BORN(found.primitive, filename=beside["BORN"])
        codes = optional("phonopy.interface.calculator", WITHOUT)
        units = codes.get_calculator_physical_units(found.calculator)
    except Exception as error:  # phonopy raises whatever its parsing runs into
        raise InputError(f"{path}: phonopy does not read it ({error})") from None
    if force_constants is None:
        raise InputError(f"{path}: expected FORCE_CONSTANTS or FORCE_SETS beside it, found neither")
    small, large, x = found.primitive, found.supercell, units.distance_to_A
    cell, supercell = (
        ase.Atoms(part.numbers, positions=x * part.positions, cell=x * part.cell, pbc=True)
        for part in (small, large)
    )
    check_sites(cell)
    if small.magnetic_moments is not None:  # sites that they tell apart are no images
        cell.set_initial_magnetic_moments(small.magnetic_moments)
    displaced = np.asarray(small.p2s_map).tolist()
    phi = units.force_to_eVperA / x * np.asarray(force_constants)
    phi = phi if len(phi) == len(displaced) else phi[displaced]
    if gap(cell, 2)[0] >= VACUUM and thickness is None:
        thickness = thickness_of(cell)[0]
    polar = None
    if ions is not None:
        polar = NonAnalyticCorrection(np.asarray(ions["born"]), np.asarray(ions["dielectric"]))
    elif thickness is None and len(set(cell.numbers)) > 1:
        warn(f"{file.parent}: no BORN is there; the field of ions with charges misses in its waves")
    if thickness is not None and polar is None and np.abs(cell.cell[:2, 2]).max() > 1e-6:
        raise InputError(f"{path}: expected a sheet across z")
    return projected(cell, supercell, phi, displaced, thickness=thickness, polar=polar)


def _opened(file: Path, beside: dict[str, Path]) -> tuple[Any, Any]:
    """phonopy's crystal, and what its file says; nothing is read that lies elsewhere."""
    for name, path in beside.items():
        if name.endswith(".hdf5"):
            with h5py.File(path) as held:
                check_hdf5(held, path.stat().st_size)
        else:
            content(path)
    text = content(file)
    check_yaml(file, text)
    told: Any = optional("phonopy.interface.phonopy_yaml", WITHOUT).PhonopyYaml()
    told.read(io.StringIO(text.decode()))
    if getattr(told, "site_mixture_scheme", None) is not None:
        raise InputError("site_mixture_scheme: sites of several elements are not read")
    matrix, primitive = told.supercell_matrix, told.primitive_matrix
    matrix = np.eye(3, dtype=int) if matrix is None else np.asarray(matrix)
    cells = abs(np.linalg.det(matrix))
    if cells * len(told.unitcell) > MOST:
        raise InputError(f"supercell_matrix: expected at most {MOST} atoms, got {cells:.0f} cells")
    primitive = "auto" if primitive is None else primitive
    made = optional("phonopy", WITHOUT).Phonopy
    return made(told.unitcell, matrix, primitive, calculator=told.calculator, log_level=0), told


def _force_constants(found: Any, told: Any, beside: dict[str, Path]) -> Any:
    """Of phonopy's own file, else of those beside it, else from its forces; None without them."""
    reader, rows = optional("phonopy.file_IO", WITHOUT), found.primitive.p2s_map
    if told.force_constants is not None:
        return told.force_constants
    if "FORCE_CONSTANTS" in beside:
        return reader.parse_FORCE_CONSTANTS(filename=beside["FORCE_CONSTANTS"], p2s_map=rows)
    if (name := "force_constants.hdf5") in beside:
        helper = optional("phonopy.cui.load_helper", WITHOUT)
        return helper.read_force_constants_from_hdf5(beside[name], rows, found.calculator)
    data, count = told.dataset or {}, len(found.supercell)
    if "forces" not in data | data.get("first_atoms", [{}])[0]:
        if "FORCE_SETS" not in beside:
            return None
        data = reader.parse_FORCE_SETS(natom=count, filename=beside["FORCE_SETS"])
        if data.get("natom", count) != count:
            raise InputError(f"FORCE_SETS: expected forces on {count} atoms, got {data['natom']}")
    moved = [one["displacement"] for one in data.get("first_atoms", [])]
    if not all(np.linalg.norm(one) > 0 for one in moved):
        raise InputError("displacement: expected one of every first atom, got 0 0 0")
    found.dataset = data
    by = "symfc" if "displacements" in data else None
    found.produce_force_constants(calculate_full_force_constants=False, fc_calculator=by)
    return found.force_constants


def _yaml(path: Path) -> Path:
    """phonopy's file, of a folder the first of YAML that is there."""
    there = [one for one in (path, *(path / name for name in YAML)) if one.is_file()]
    if not there:
        raise InputError(
            f"{path}: expected a file of phonopy or a folder with {' or '.join(YAML)}; "
            "`phonopy-init --dim …` (once `phonopy -d`) writes the last beside a code's unit cell"
        )
    return there[0]
