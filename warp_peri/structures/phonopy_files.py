"""Force constants from the files of phonopy, with Born charges where there are some."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

import ase
import numpy as np

from warp_peri.errors import InputError
from warp_peri.micromodulus.force_constants import ForceConstants, Polar, from_supercell
from warp_peri.structures.cells import VACUUM, gap
from warp_peri.structures.rest import thickness_of

YAML = ("phonopy.yaml", "phonopy_params.yaml", "phonopy_disp.yaml")
"""Of a folder, the first that is there is read."""


def from_phonopy(path: str | os.PathLike[str], *, thickness: float | None = None) -> ForceConstants:
    """Force constants of what phonopy computed.

    Beside phonopy.yaml may lie FORCE_CONSTANTS, force_constants.hdf5, FORCE_SETS and BORN, which
    are read as phonopy itself reads them. With Born charges the field of the ions is part of every
    wave (theory.md, T18); a solid of several elements without BORN is warned of.

    Args:
        path: phonopy.yaml, phonopy_params.yaml or phonopy_disp.yaml, or the folder that has one.
        thickness: of a sheet across z [Å]; by default as `from_atoms` has it.

    Raises InputError where phonopy is not installed, for files that it does not read or that are
    not in eV and Å, for forces that are not there, and for Born charges of a sheet.
    """
    try:
        import phonopy
        from phonopy.interface import calculator
    except ImportError:
        raise InputError("phonopy: pip install 'warp_peri[phonons]'") from None
    file = _yaml(Path(path))
    beside: dict[str, Any] = {
        f"{name.split('.')[0].lower()}_filename": file.parent / name
        for name in ("force_constants.hdf5", "FORCE_CONSTANTS", "FORCE_SETS", "BORN")
        if (file.parent / name).is_file()
    }
    if thickness is not None and "born_filename" in beside:
        raise InputError(f"{path}: BORN: expected a solid; the field of a sheet's ions is another")
    try:
        found: Any = phonopy.load(file, **beside, log_level=0)
    except Exception as error:  # phonopy raises whatever its parsing runs into
        hint = "" if file.suffix in (".yaml", ".yml") else "; a structure needs a calculator"
        raise InputError(f"{path}: phonopy does not read it ({error}){hint}") from None
    units: Any = vars(calculator)["get_calculator_physical_units"](found.calculator)
    if units.distance_to_A != 1 or units.force_constants_unit != "eV/angstrom^2":
        raise InputError(
            f"{path}: expected files in eV and Å, those of {found.calculator} are in "
            f"{units.length_unit} and {units.force_constants_unit}; convert them first"
        )
    if found.force_constants is None:
        raise InputError(f"{path}: expected FORCE_CONSTANTS or FORCE_SETS beside it, found neither")
    small, large = found.primitive, found.supercell
    cell, supercell = (
        ase.Atoms(part.numbers, positions=part.positions, cell=part.cell, pbc=True)
        for part in (small, large)
    )
    displaced = np.asarray(small.p2s_map)
    phi = np.asarray(found.force_constants)
    phi = (phi if len(phi) == len(displaced) else phi[displaced]).transpose(0, 2, 1, 3)
    if gap(cell, 2) >= VACUUM and thickness is None:
        thickness = thickness_of(cell)[0]
    polar = None
    if found.nac_params is not None:
        born, dielectric = (np.asarray(found.nac_params[n]) for n in ("born", "dielectric"))
        polar = Polar(born, dielectric)
    elif thickness is None and len(set(cell.numbers)) > 1:
        warnings.warn(
            f"{file.parent}: no BORN is there; if ions carry charges, their field misses in its "
            "waves",
            stacklevel=2,
        )
    across = float(np.abs(cell.cell[:2, 2]).max()) < 1e-6
    if thickness is not None and polar is None and not across:
        raise InputError(f"{path}: expected a sheet across z")
    return from_supercell(
        cell, supercell, phi, displaced.tolist(), thickness=thickness, polar=polar
    )


def _yaml(path: Path) -> Path:
    if path.is_file():
        return path
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    for name in YAML:
        if (path / name).is_file():
            return path / name
    raise InputError(f"{path}: expected a file of phonopy or a folder with {' or '.join(YAML)}")
