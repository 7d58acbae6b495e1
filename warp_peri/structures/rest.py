"""Structures at rest, and phonopy's folders."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ase
import numpy as np
from ase.data import vdw_radii
from ase.filters import FrechetCellFilter
from ase.optimize import BFGS
from ase.stress import voigt_6_to_full_3x3_stress

from warp_peri.core.groups import by_spglib
from warp_peri.errors import InputError
from warp_peri.micromodulus.force_constants import ForceConstants, Polar, from_supercell
from warp_peri.points.unit_names import STRESSES
from warp_peri.structures.calculators import LammpsError
from warp_peri.structures.cells import (
    FLAT,
    ON_SITES,
    VACUUM,
    exact_cell,
    gap,
    oriented,
    smallest,
    to_shared_axes,
)

USUAL_RADIUS = 2.0
"""Van der Waals radius [Å] of elements that have none in ASE's table."""
QUIET, STEPS = 1e-5, 1000
"""Forces [eV/Å] that a structure is relaxed to, and the steps that it may take."""
RESIDUAL_FORCE, RESIDUAL_STRESS = 1e-3, 1e-4
"""Forces [eV/Å] and stress [TPa] that are taken for none."""
MOVED = 0.01
"""Strain by which the cell may relax without a word."""
VOIGT = ("xx", "yy", "zz", "yz", "xz", "xy")
PLACES = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


@dataclass(frozen=True)
class Reference:
    """A crystal at rest.

    Attributes:
        cell: its smallest cell, an ase.Atoms without a calculator; a sheet lies across z.
        thickness: of a sheet [Å], or None.
        stress: that it is held under [TPa], shape [d, d]; None for one at rest.
        spacing: that its nodes have unless another is asked for [Å].
        said: what was found or chosen, by name.
    """

    cell: ase.Atoms
    thickness: float | None
    stress: np.ndarray | None
    spacing: float
    said: dict[str, str]

    @property
    def dimension(self) -> int:
        """2 for a sheet, 3 for a solid."""
        return 3 if self.thickness is None else 2


def at_rest(
    atoms: ase.Atoms, calculator: Any, *, thickness: float | None = None, hold: Sequence[str] = ()
) -> Reference:
    """The smallest cell of a structure where no atom feels a force and what is free no stress.

    Args:
        atoms: the structure, periodic in the plane (a sheet) or in space.
        calculator: with forces, and stress unless all strains are held.
        thickness: of a sheet [Å]; by default from the lowest to the highest nucleus and a van der
            Waals radius beyond each.
        hold: strains that stay as they are: of xx, yy, zz, yz, xz, xy, or "all".

    Raises InputError for a structure that is no crystal, sites that are not full, strains that are
    not known, and where relaxation leaves a force or a stress.
    """
    held = set(VOIGT) if "all" in hold else set(hold)
    if not held <= set(VOIGT):
        raise InputError(f"hold: expected all, or of {', '.join(VOIGT)}, got {' '.join(hold)}")
    if thickness is not None and not 0 < thickness < np.inf:
        raise InputError(f"thickness: expected a length > 0 [Å], got {thickness}")
    cell, flat = oriented(atoms, turning=not held or held >= set(VOIGT))
    turned = (
        min(np.abs(np.array(cell.cell)[0] - edge).max() for edge in np.array(atoms.cell)) > FLAT
    )
    if not flat and thickness is not None:
        raise InputError("thickness: the structure is a solid, periodic in space; expected none")
    cell = smallest(cell, flat, calculator)
    cell.calc = calculator
    before = np.array(cell.cell)
    _check_forces(cell)
    _relax(cell, flat, held)
    strain = np.linalg.svd(np.linalg.solve(before, np.array(cell.cell)), compute_uv=False) - 1
    if flat:
        strain = np.delete(strain, np.abs(strain).argmin())  # across it nothing is relaxed
    if not held:  # disorder that has relaxed leaves a smaller cell, its axes a little off
        cell = exact_cell(smallest(cell if flat else to_shared_axes(cell), flat, calculator))
        cell.calc = calculator
    size, rule = thickness, "as given"
    if flat and size is None:
        size, rule = thickness_of(cell)
    stress = _stress_left(cell, size, flat, held)
    said = {
        "structure": f"{cell.get_chemical_formula()}, {'a sheet' if flat else 'a solid'}",
        "cell": " x ".join(f"{length:.5g}" for length in cell.cell.lengths()[: 2 if flat else 3])
        + f" Å, {len(cell)} atoms",
    }
    if turned:
        said["axes"] = (
            "turned: x along an edge of the cell, z across"
            if flat
            else "turned to those of the conventional cell"
        )
    if np.abs(strain).max() > MOVED:
        said["relaxed"] = f"the cell by strains of {strain.min():+.1%} to {strain.max():+.1%}"
    if size is not None:
        said["thickness"] = f"{size:.4g} Å, {rule}"
        said["bending"] = "not in the law: it moves a sheet in its plane only"
    cell.calc = None
    return Reference(cell, size, stress, usual_spacing(cell, flat), said)


def _check_forces(cell: ase.Atoms) -> None:
    """Raise InputError for a calculator that gives no forces; LAMMPS has words of its own."""
    try:
        cell.get_forces(apply_constraint=False)
    except LammpsError:
        raise
    except Exception as error:  # calculators raise whatever they run into
        kinds, kind = ", ".join(sorted(set(cell.get_chemical_symbols()))), type(error).__name__
        raise InputError(f"calculator: it gives no forces for {kinds} ({kind}: {error})") from None


def _relax(cell: ase.Atoms, flat: bool, held: set[str]) -> None:
    free = [name not in held and not (flat and "z" in name) for name in VOIGT]
    try:
        moving: Any = FrechetCellFilter(cell, mask=free) if any(free) else cell
        done = BFGS(moving, logfile=None).run(fmax=QUIET, steps=STEPS)
    except NotImplementedError as error:
        raise InputError(
            f"calculator: it gives no stress ({error}); relax the cell elsewhere and hold all"
        ) from None
    force = float(np.abs(cell.get_forces(apply_constraint=False)).max())
    if not done and force > RESIDUAL_FORCE:
        raise InputError(
            f"structure: after {STEPS} steps of relaxation a force of {force:.2g} eV/Å is left"
        )


def stress_of(cell: ase.Atoms, thickness: float | None) -> np.ndarray:
    """Cauchy stress [TPa] of a structure with its calculator, [3, 3]; a sheet's over its own."""
    stress = voigt_6_to_full_3x3_stress(cell.get_stress(apply_constraint=False))
    if thickness is not None:
        stress = stress * (cell.cell[2, 2] / thickness)
    return np.asarray(stress * STRESSES["eV/angstrom^3"])


def _stress_left(
    cell: ase.Atoms, thickness: float | None, flat: bool, held: set[str]
) -> np.ndarray | None:
    """The stress of the strains that are held, [d, d]; None where there is none.

    Raises InputError for a stress where the strain is free.
    """
    d = 2 if flat else 3
    try:
        stress = stress_of(cell, thickness)[:d, :d]
    except NotImplementedError:
        warnings.warn(
            "calculator: it gives no stress; the crystal is taken to be at rest", stacklevel=3
        )
        return None
    for name, (i, j) in zip(VOIGT, PLACES):
        if max(i, j) < d and name not in held and abs(stress[i, j]) > RESIDUAL_STRESS:
            raise InputError(
                f"structure: relaxation left a stress {name} of {1e3 * stress[i, j]:.3g} GPa"
            )
    if np.abs(stress).max() <= RESIDUAL_STRESS:
        return None
    return np.asarray((stress + stress.T) / 2)


def thickness_of(cell: ase.Atoms) -> tuple[float, str]:
    """By the rule that Reference states [Å]."""
    z = np.array(cell.positions)[:, 2]
    radii = [vdw_radii[cell.numbers[n]] for n in (z.argmin(), z.argmax())]
    known = [USUAL_RADIUS if np.isnan(r) else float(r) for r in radii]
    guess = " (2 Å where none is known)" if np.isnan(radii).any() else ""
    return float(np.ptp(z) + sum(known)), (
        f"{np.ptp(z):.4g} Å between outermost nuclei and van der Waals radii of "
        f"{known[0]:.3g} and {known[1]:.3g} Å{guess}"
    )


def usual_spacing(cell: ase.Atoms, flat: bool) -> float:
    """Of nodes [Å]: by the conventional cell's volume, of a sheet by its smallest rectangle."""
    return _sheet_spacing(cell) if flat else _solid_spacing(cell)


def _solid_spacing(cell: ase.Atoms) -> float:
    """Edge of a cube with the volume of the conventional cell, twice that of a hexagonal one."""
    given = np.array(cell.cell), cell.get_scaled_positions(), cell.numbers
    found = by_spglib("get_symmetry_dataset", given, ON_SITES)
    if found is None:
        return float(abs(cell.get_volume()) ** (1 / 3))
    volume = abs(cell.get_volume()) * len(found.std_types) / len(cell)
    hexagonal = 143 <= found.number <= 194 and "R" not in found.international
    return float((volume * (2 if hexagonal else 1)) ** (1 / 3))


def _sheet_spacing(cell: ase.Atoms) -> float:
    """The longer edge of the smallest rectangle; √(2 area) where no small one is a cell."""
    a, b = np.array(cell.cell)[:2, :2]
    for _ in range(100):
        if b @ b < a @ a:
            a, b = b, a
        shift = np.rint((a @ b) / (a @ a))
        if not shift:
            break
        b = b - shift * a
    part = abs(a @ b) / (a @ a)
    if part < 1e-3:
        return float(np.linalg.norm(b))
    if abs(part - 0.5) < 1e-3:  # a, and what stands on it
        return float(max(np.linalg.norm(a), 2 * abs(a[0] * b[1] - a[1] * b[0]) / np.linalg.norm(a)))
    if abs(np.linalg.norm(a) / np.linalg.norm(b) - 1) < 1e-3:  # a rhombus: its diagonals
        return float(max(np.linalg.norm(a + b), np.linalg.norm(a - b)))
    return float(np.sqrt(2 * abs(a[0] * b[1] - a[1] * b[0])))


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
