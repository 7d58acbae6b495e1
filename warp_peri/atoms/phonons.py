"""Force constants and phonons of a structure, and what their waves say."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import ase
import numpy as np
from ase.data import atomic_masses

from warp_peri.atoms.calculator_noise import TIMES, rattled
from warp_peri.atoms.force_constants import EDGE, STEP, ForceConstants, forces_of, from_calculator
from warp_peri.atoms.relaxed import Reference
from warp_peri.errors import InputError, warn

WIDTHS = (10.0, 14.0, 18.0, 22.0, 26.0, 32.0, 40.0)
"""Of supercells [Å], tried in turn."""
DECAYED_FORCE, DECAYED_FORCE_ROUGH = 1e-5, 0.05
"""Force at half the width of a supercell, over the largest, that is none; that of a surface that
is rough, whose forces far away are no noise."""
MOST_ATOMS, NOISY_ATOMS = 6000, 700
"""In a supercell; where forces are noisy strains tell moduli better than what is further away."""
GRID = {2: 24, 3: 8}
"""Wave vectors along each reciprocal edge that are looked at for soft modes."""
SOFT = 1e-5
"""Of the largest eigenvalue: a negative one beyond it is no rounding."""
MEMORY = re.compile("memory|alloc", re.IGNORECASE)
"""In what a calculator says where it has too little."""
LOOSE = (
    "structure: parts of it feel no force from the rest; expected one crystal, without loose atoms "
    "or layers"
)
BORN = "born_effective_charges"
"""ASE's name for what a calculator may give."""
THZ = 15.633302
"""√(eV/Å²/amu) / 2π [THz]."""


def force_constants(
    reference: Reference, calculator: Any, supercell: Sequence[int] | None = None
) -> tuple[ForceConstants, dict[str, str]]:
    """Φ of a crystal at rest by finite differences, and what was taken for it, by name.

    Under noise all atoms are displaced at once, and Φ has its standard errors (`rattled`).

    Args:
        reference: at rest.
        calculator: with forces.
        supercell: repeats of the smallest cell along its edges; by default the smallest supercell
            at half whose width a displaced atom's forces have ended.

    Born charges of a calculator are not read, with a warning. Raises InputError for repeats that
    are not three counts, and a crystal with imaginary phonons.
    """
    d, cell = reference.dimension, reference.cell
    if BORN in getattr(calculator, "implemented_properties", ()):
        warn("calculator: its Born charges are not read; a folder of phonopy with BORN has them")
    if supercell is None:
        repeats = wide_enough(reference, calculator, WIDTHS)
    else:
        repeats = tuple(int(n) for n in supercell)
        if len(repeats) != 3 or min(repeats) < 1 or (d == 2 and repeats[2] != 1):
            raise InputError(f"supercell: expected three counts, a sheet's third 1, got {repeats}")
    many = cell.repeat(repeats)
    told = {"force constants": f"{_cells(repeats[:d])}, {len(many)} atoms"}
    thickness, stress = reference.thickness, reference.stress
    if reference.noise is None:
        exact = from_calculator(cell, calculator, repeats, thickness=thickness)
        found = replace(exact, stress=stress)
    else:
        how = {"thickness": thickness, "stress": stress}
        found, said = rattled(cell, many, calculator, reference.noise, **how)
        told |= said
    check_phonons(found)
    return found, told


def _cells(repeats: Sequence[int]) -> str:
    return f"{' x '.join(map(str, repeats))} cells"


def wide_enough(reference: Reference, calculator: Any, widths: Sequence[float]) -> tuple[int, ...]:
    """Repeats of the cell at half of whose width forces have ended, or the widest that may be.

    A supercell that the calculator has no memory for is told.
    """
    cell, d = reference.cell, reference.dimension
    heights = 1 / np.linalg.norm(np.linalg.inv(np.array(cell.cell)), axis=0)
    most = MOST_ATOMS if reference.noise is None else NOISY_ATOMS
    repeats, rim, ended = (), np.nan, "supercell=… takes a wider one"
    for width in widths:
        count = np.where(np.arange(3) < d, np.ceil(width / heights), 1).astype(int)
        many = cell.repeat(wider := tuple(count.tolist()))
        if repeats and len(many) > most:
            break
        try:
            rim, none = _at_rim(many, calculator, (count * heights)[:d].min(), reference)
        except (MemoryError, RuntimeError) as error:  # networks' libraries raise the latter
            if not (repeats and MEMORY.search(f"{type(error).__name__} {error}")):
                raise
            ended = f"{len(many)} atoms need more memory than there is"
            break
        repeats = wider
        if rim <= none:
            return repeats
    still = f"forces still are {rim:.1e} of the largest"
    warn(f"supercell: at half the width of {_cells(repeats[:d])} {still}; {ended}")
    return repeats


def _at_rim(
    many: ase.Atoms, calculator: Any, width: float, reference: Reference
) -> tuple[float, float]:
    """The force at half a supercell's width from a displaced atom, over the largest; none's."""
    noise, x, rim, none = reference.noise, np.array(many.positions), 0.0, DECAYED_FORCE
    forces = forces_of(many, calculator)
    still, far = forces(x), many.get_distances(0, range(len(many)), mic=True)
    for axis in range(reference.dimension):
        moved = x.copy()
        moved[0, axis] += STEP if noise is None else noise.length
        change = np.abs(forces(moved) - still).max(axis=1)
        if not change.max() > 0:
            raise InputError(LOOSE)
        rim = max(rim, float(change[far > EDGE * width].max(initial=0.0) / change.max()))
        if noise is not None:
            least = TIMES**2 * noise.force / float(change.max())
            none = max(none, least, DECAYED_FORCE_ROUGH if noise.rough else 0.0)
    return rim, none


def check_phonons(atoms: ForceConstants) -> None:
    """Raise InputError for imaginary phonons, with the worst wave vector.

    A grid of waves is looked at, and the edges of the zone with it; a sheet's mean height is held,
    so that its bending is not. Raises it too for parts that feel no force from the rest.
    """
    d = atoms.dimension
    parts = np.array(list(itertools.product(np.arange(GRID[d]) / GRID[d], repeat=d)))
    parts = np.where(parts > 0.5, parts - 1, parts)
    parts = parts[parts @ [1.0, 1e-3, 1e-6][:d] >= 0]
    k, size, waves = _phonons(atoms, parts)
    worst = int(size[:, 0].argmin())
    least, top = size[worst, 0], size[:, -2 if d == 2 else -1].max()  # a sheet's last is held
    error = 0.0
    if atoms.doubt is not None and least < 0:
        error = float(atoms.stiffness_error(k[worst], waves[worst, 0]))
    if least >= -max(SOFT * top, TIMES * error):
        stiffest = np.linalg.eigvalsh(atoms.dynamical(k))[:, 0].max()
        if stiffest <= SOFT * np.abs(atoms.values).max():
            raise InputError(LOOSE)
        return
    imaginary = THZ * np.sqrt(-least)
    bar = f" ± {imaginary * error / (-2 * least):.2g}" if error > SOFT * top else ""
    raise InputError(
        f"structure: expected a stable crystal, got an imaginary phonon, the worst of "
        f"{imaginary:.2f}{bar}i THz at k = {np.round(parts[worst], 4).tolist()} of the reciprocal "
        f"edges ({np.round(k[worst], 4).tolist()} 1/Å); relax it in a larger cell"
    )


def _phonons(atoms: ForceConstants, parts: np.ndarray) -> tuple[np.ndarray, ...]:
    """At parts [K, d] of the reciprocal edges: k [1/Å], ω², and modes over √mass [K, 3 n, n, 3]."""
    d = atoms.dimension
    k = 2 * np.pi * parts @ np.linalg.inv(atoms.cell[:d, :d]).T
    weight = 1 / np.sqrt(np.repeat(atomic_masses[atoms.species], 3))
    size, modes = np.linalg.eigh(atoms.dynamical(k, moving=3) * weight * weight[:, None])
    return k, size, (modes.swapaxes(1, 2) * weight).reshape(*size.shape, -1, 3)


def at_zone_edge(atoms: ForceConstants) -> tuple[float, float, float]:
    """The softest phonon [THz] at halves of the reciprocal edges, its error, the largest error."""
    parts = np.array(list(itertools.product((0, 0.5), repeat=atoms.dimension)))[1:]
    k, size, waves = _phonons(atoms, parts)
    off = np.array([atoms.stiffness_error(*pair) for pair in zip(k, waves)])
    low, middle, high = (THZ * np.sqrt(np.clip(size + way * off, 0, None)) for way in (-1, 0, 1))
    soft, error = middle.argmin(), (high - low) / 2
    return float(middle.flat[soft]), float(error.flat[soft]), float(error.max())
