"""Force constants of a crystal by its calculator, checked: how far forces reach, what is soft."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence
from typing import Any

import ase
import numpy as np
from ase.data import atomic_masses
from ase.optimize import BFGS

from warp_peri.core.elastic import PAIRS, from_voigt
from warp_peri.errors import InputError
from warp_peri.micromodulus.force_constants import (
    STEP,
    ForceConstants,
    Polar,
    finite_differences,
    from_supercell,
)
from warp_peri.structures.rest import QUIET, STEPS, Reference, stress_of

WIDTHS = (10.0, 14.0, 18.0, 22.0, 26.0, 32.0, 40.0)
"""Of supercells [Å], tried in turn."""
REACHED = 1e-5
"""Force at half the width of a supercell, over the largest, that is none."""
MOST_ATOMS = 6000
WITH_IONS = 14.0
"""Width of a supercell [Å] where Born charges take off what reaches further."""
GRID = {2: 24, 3: 8}
"""Wave vectors along each reciprocal edge that are looked at for soft modes."""
SOFT = 1e-5
"""Of the largest eigenvalue: a negative one beyond it is no rounding."""
LOOSE = (
    "structure: parts of it feel no force from the rest; expected one crystal, without loose atoms "
    "or layers"
)
STRAIN = 1e-3
"""Of the finite strains that moduli are checked with."""
BORN, DIELECTRIC = "born_effective_charges", "dielectric_tensor"
"""ASE's names for what a calculator may give."""
NEUTRAL = 1e-3
"""Charges [e] that are none."""
THZ = 15.633302
"""√(eV/Å²/amu) / 2π [THz]."""


def force_constants(
    reference: Reference, calculator: Any, supercell: Sequence[int] | None = None
) -> tuple[ForceConstants, str]:
    """Φ of a crystal at rest by finite differences, and what supercell was taken.

    Args:
        reference: at rest.
        calculator: with forces.
        supercell: repeats of the smallest cell along its edges; by default the smallest supercell
            at half whose width a displaced atom's forces have ended.

    A calculator that gives Born charges (ASE's `born_effective_charges` and `dielectric_tensor`)
    has the field of its ions in every wave, in any supercell (theory.md, T18).

    Raises InputError for repeats that are not three counts, a crystal with imaginary phonons, Born
    charges of a sheet, or without the dielectric tensor.
    """
    d, cell = reference.dimension, reference.cell
    polar = born_charges(reference, calculator)
    if supercell is not None:
        repeats = tuple(int(n) for n in supercell)
        if len(repeats) != 3 or min(repeats) < 1 or (d == 2 and repeats[2] != 1):
            raise InputError(f"supercell: expected three counts, a sheet's third 1, got {repeats}")
    else:
        widths = WIDTHS if polar is None else (WITH_IONS,)
        repeats = _wide_enough(reference, calculator, widths)
    many = cell.repeat(repeats)
    forces, x = forces_of(many, calculator), np.array(many.positions)
    phi, change = finite_differences(forces, x, range(len(cell)))
    found = from_supercell(
        cell,
        many,
        phi,
        range(len(cell)),
        thickness=reference.thickness,
        polar=polar,
        stress=reference.stress,
        change=change,
    )
    check_phonons(found)
    ions = "" if polar is None else ", and the field of ions by the calculator's Born charges"
    return found, f"{' x '.join(map(str, repeats[:d]))} cells, {len(many)} atoms{ions}"


def born_charges(reference: Reference, calculator: Any) -> Polar | None:
    """Charges that a calculator gives under ASE's names; None where it has none, or they vanish.

    Raises InputError for those of a sheet, or without the dielectric tensor.
    """
    given = getattr(calculator, "implemented_properties", ())
    if BORN not in given:
        return None
    cell = reference.cell.copy()
    cell.calc = calculator
    born = np.asarray(calculator.get_property(BORN, cell), dtype=float)
    if np.abs(born).max() < NEUTRAL:
        return None
    if reference.dimension == 2:
        raise InputError(
            "calculator: it gives Born charges of a sheet; the field of a sheet's ions is another "
            "than a solid's, and no law here has it"
        )
    if DIELECTRIC not in given:
        raise InputError(f"calculator: it gives {BORN} without {DIELECTRIC}; expected both")
    return Polar(born, np.asarray(calculator.get_property(DIELECTRIC, cell), dtype=float))


def forces_of(many: ase.Atoms, calculator: Any) -> Any:
    many = many.copy()
    many.calc = calculator

    def forces(x: np.ndarray) -> np.ndarray:
        many.positions[:] = x
        return np.array(many.get_forces(apply_constraint=False))

    return forces


def _wide_enough(reference: Reference, calculator: Any, widths: Sequence[float]) -> tuple[int, ...]:
    cell, d = reference.cell, reference.dimension
    edges = np.array(cell.cell)
    heights = 1 / np.linalg.norm(np.linalg.inv(edges), axis=0)
    rim = 0.0
    repeats: tuple[int, ...] = (1, 1, 1)
    for width in widths:
        counts = np.ceil(width / heights).astype(int)
        counts[d:] = 1
        if repeats != (1, 1, 1) and np.prod(counts) * len(cell) > MOST_ATOMS:
            break
        repeats = tuple(counts.tolist())
        if len(widths) == 1:
            return repeats
        many = cell.repeat(repeats)
        at_rest, x = forces_of(many, calculator), np.array(many.positions)
        still, rim = at_rest(x), 0.0
        part = (x - x[0]) @ np.linalg.inv(np.array(many.cell))
        far = np.linalg.norm((part - np.rint(part)) @ np.array(many.cell), axis=1)
        for axis in range(d):
            moved = x.copy()
            moved[0, axis] += STEP
            change = np.abs(at_rest(moved) - still).max(axis=1)
            if not change.max() > 0:
                raise InputError(LOOSE)
            outside = far > 0.45 * (counts * heights)[:d].min()
            rim = max(rim, float(change[outside].max(initial=0.0) / change.max()))
        if rim <= REACHED:
            return repeats
    warnings.warn(
        f"supercell: at half the width of {' x '.join(map(str, repeats[:d]))} cells forces still "
        f"are {rim:.1e} of the largest; supercell=… takes a wider one",
        stacklevel=4,
    )
    return repeats


def check_phonons(atoms: ForceConstants) -> None:
    """Raise InputError for imaginary phonons, with the worst wave vector.

    A grid of waves is looked at, and the edges of the zone with it; a sheet's mean height is held,
    so that its bending is not. Raises it too for parts that feel no force from the rest.
    """
    d = atoms.dimension
    back = 2 * np.pi * np.linalg.inv(atoms.cell[:d, :d]).T
    line = np.arange(GRID[d]) / GRID[d]
    parts = np.array(list(itertools.product(line, repeat=d)))
    parts = np.where(parts > 0.5, parts - 1, parts)
    parts = parts[parts @ [1.0, 1e-3, 1e-6][:d] >= 0]
    weight = 1 / np.sqrt(np.repeat(atomic_masses[atoms.species], 3))
    D = atoms.dynamical(parts @ back, moving=3) * weight * weight[:, None]
    least = np.linalg.eigvalsh(D)
    worst = int(least[:, 0].argmin())
    top = least[:, -2 if d == 2 else -1].max()  # above it is what a mean height is held with
    if least[worst, 0] >= -SOFT * top:
        stiffest = np.linalg.eigvalsh(atoms.dynamical(parts @ back))[:, 0].max()
        if stiffest <= SOFT * np.abs(atoms.values).max():
            raise InputError(LOOSE)
        return
    k, imaginary = parts[worst] @ back, THZ * np.sqrt(-least[worst, 0])
    raise InputError(
        f"structure: expected a stable crystal, got an imaginary phonon, the worst of "
        f"{imaginary:.2f}i THz at k = {np.round(parts[worst], 4).tolist()} of the reciprocal edges "
        f"({np.round(k, 4).tolist()} 1/Å); displace atoms along it in a larger cell and relax"
    )


def strained_moduli(reference: Reference, calculator: Any) -> np.ndarray | None:
    """C_ijkl [TPa] by finite strains of the cell, atoms relaxed, [d, d, d, d]; None without stress.

    Differences of the second Piola–Kirchhoff stress S = det F · F⁻¹ σ F⁻ᵗ, so that the stress of a
    crystal that is held counts as (T19) has it.
    """
    d = reference.dimension
    columns = []
    for i, j in PAIRS[d]:
        found = []
        for sign in (1, -1):
            strain = np.zeros((3, 3))
            strain[i, j] += sign * STRAIN / 2
            strain[j, i] += sign * STRAIN / 2
            F = np.eye(3) + strain
            cell = reference.cell.copy()
            cell.set_cell(np.array(cell.cell) @ F, scale_atoms=True)
            cell.calc = calculator
            BFGS(cell, logfile=None).run(fmax=QUIET, steps=STEPS)
            try:
                sigma = stress_of(cell, reference.thickness)[:d, :d]
            except NotImplementedError:
                return None
            inside = np.linalg.inv(F[:d, :d])
            found.append(np.linalg.det(F[:d, :d]) * inside @ sigma @ inside.T)
        slope = (found[0] - found[1]) / (2 * STRAIN)
        columns.append([slope[pair] for pair in PAIRS[d]])
    matrix = np.array(columns)
    return from_voigt((matrix + matrix.T) / 2)
