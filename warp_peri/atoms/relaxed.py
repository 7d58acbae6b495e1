"""Relaxation of crystal structures, and their smallest cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import ase
import numpy as np
from ase.constraints import FixSymmetry
from ase.data import vdw_radii
from ase.filters import FrechetCellFilter
from ase.geometry import minkowski_reduce
from ase.neighborlist import neighbor_list
from ase.optimize import BFGS
from ase.spacegroup.symmetrize import refine_symmetry
from numpy import ndarray
from numpy.linalg import det, inv, norm, solve, svd
from scipy.linalg import polar, sqrtm

from warp_peri.atoms.calculator_noise import ON_SITES, TIMES, Noise, measured, strained
from warp_peri.core import elastic
from warp_peri.core.elastic import COUNTED, KNOWN, PAIRS, by_spglib, kinds_of, symmetric_part
from warp_peri.errors import InputError, Several, warn
from warp_peri.points.arguments import EV_IN_TPA, is_number

VACUUM = 8.0
"""A gap between atoms [Å] that counts as vacuum."""
WIDE = 5.0
"""A gap [Å] that is no vacuum yet, and wide for a solid."""
HEIGHT = 40.0
"""Of the box around a sheet, beside the sheet itself [Å]."""
FULL, UPON = 0.999, 0.5
"""Occupancy of a site that an atom fills; distance [Å] that no two atoms are nearer than."""
UNSAID = "?", "."
"""Values of CIF that are unknown, or do not apply."""
FLAT = 1e-3
"""Smallest singular value of the directions of a cell's edges."""
ALMOST, RIGHT = 1e-3, 1e-3
"""Of a turn's matrix, off whole numbers that it is meant to have; cosine of a right angle."""
ROUNDING = 1e-6
"""Relative, of lengths."""
USUAL_RADIUS = 2.0
"""Van der Waals radius [Å] of elements that have none in ASE's table."""
QUIET, STEPS, NOISY_STEPS = 1e-5, 1000, 200
"""Forces [eV/Å] that a structure is relaxed to, and the steps that it may take, under noise too."""
RESIDUAL_FORCE, RESIDUAL_STRESS = 1e-3, 1e-4
"""Forces [eV/Å] and stress [TPa] that are taken for none."""
MOVED = 0.01
"""Strain by which the cell may relax without a word."""
STRAINED, LIKE = 0.01, 0.5
"""Strain at which stress is compared with the energy's slope; relative difference of the same."""
VOIGT = "xx", "yy", "zz", "yz", "xz", "xy"


@dataclass(frozen=True)
class Reference:
    """Crystal at rest, with the noise of its calculator.

    Attributes:
        cell: its smallest cell, an ase.Atoms without a calculator; a sheet lies across z.
        thickness: of a sheet [Å], or None.
        stress: that it is held under [TPa], shape [d, d]; None for one at rest.
        noise: of the calculator's forces.
        said: notes on what was found or chosen, by name.
    """

    cell: ase.Atoms
    thickness: float | None
    stress: ndarray | None
    noise: Noise
    said: dict[str, str]

    @property
    def dimension(self) -> int:
        """2 for a sheet, 3 for a solid."""
        return 3 if self.thickness is None else 2


def check_sites(atoms: ase.Atoms) -> None:
    """Raise InputError for coinciding atoms, and for shared sites, of which ASE keeps one atom."""
    for site in (atoms.info.get("occupancy") or {}).values():
        if len(site) > 1 or not all(
            part in UNSAID or (is_number(part) and part >= FULL) for part in site.values()
        ):
            raise InputError(
                "structure: expected sites of one element, got one of "
                f"{', '.join(f'{kind} {part}' for kind, part in site.items())}"
            )
    if not (mass := atoms.get_masses() > 0).all():
        raise InputError(f"structure: expected masses > 0, got another of atom {mass.argmin()}")
    edges, x = np.array(atoms.cell), np.array(atoms.positions)
    if not len(atoms) or not (np.isfinite(edges).all() and np.isfinite(x).all()):
        raise InputError("structure: expected one atom or more, at finite places in a finite cell")
    edges = edges[np.array(atoms.pbc) | edges.any(axis=1)]
    lengths = norm(edges, axis=1)
    if not lengths.all() or svd(edges / lengths[:, None])[1].min(initial=1.0) < FLAT:
        raise InputError("structure: expected edges of the cell that span one, got some in a plane")
    first, second, apart = neighbor_list("ijd", atoms, UPON)
    if len(apart):
        n = apart.argmin()
        pair = f"{apart[n]:.2g} Å between {first[n]} and {second[n]} of {len(atoms)}"
        raise InputError(
            f"structure: expected atoms {UPON:g} Å apart, got {pair}; is a site there twice?"
        )


def oriented(atoms: ase.Atoms, turning: bool, thickness: Any) -> tuple[ase.Atoms, bool]:
    """Structure with a sheet across z, in the middle of a high box, and whether it is a sheet;
    InputError for neither sheet nor solid, and the thickness of a solid."""
    check_sites(atoms)
    periodic = np.array(atoms.pbc)
    if not periodic.any():
        raise InputError("structure: expected a crystal with a periodic cell, got a free cluster")
    empty = [a for a in range(3) if not periodic[a] or gap(atoms, a)[0] >= VACUUM]
    if len(empty) > 1:
        raise InputError(f"structure: expected a sheet or a solid, got {len(empty)} free edges")
    if not empty and thickness is not None:
        raise InputError("thickness: the structure is a solid, periodic in space; expected none")
    ready = atoms.copy()
    ready.set_constraint()
    if not empty:
        widest = max(gap(atoms, a)[0] for a in range(3))
        if widest >= WIDE:
            told = f"a gap of {widest:.3g} Å along an edge; a sheet has {VACUUM:g} Å or more"
            warn(f"structure: taken for a solid, with {told}")
        ready.pbc = True
        return to_shared_axes(ready) if turning else ready, False
    (axis,) = empty
    if periodic[axis]:  # a sheet that the period cuts is put together at the gap
        ready.wrap(center=gap(atoms, axis)[1] + 0.5, pbc=np.arange(3) == axis, eps=ROUNDING)
    first, second, _ = np.roll(atoms.cell, 2 - axis, axis=0)
    up = np.cross(first, second)
    ready.set_cell([first, second, up] if turning or up[2] > 0 else [second, first, -up])
    if turning:
        ready.set_cell(ready.cell.standard_form()[0], scale_atoms=True)
    elif abs(up[2]) < (1 - FLAT**2) * norm(up):
        raise InputError("structure: expected a sheet across z; its strains have names in x and y")
    ready.center(vacuum=HEIGHT / 2, axis=2)
    ready.pbc = True
    return ready, True


def gap(atoms: ase.Atoms, axis: int) -> tuple[float, float]:
    """Largest gap between atoms along an edge [Å], and the fraction of the edge where it ends."""
    cell = atoms.cell.complete()  # of a sheet that has no third edge too
    part = np.sort(cell.scaled_positions(atoms.positions)[:, axis] % 1.0)
    apart = 1 / norm(inv(np.array(cell))[:, axis])
    steps = np.diff(part, prepend=part[-1] - 1)
    return steps.max() * apart, part[steps.argmax()]


def crystal_of(atoms: ase.Atoms) -> Several:
    """Crystal for spglib: edges, fractional positions, and numbers that tell atoms apart."""
    return np.array(atoms.cell), atoms.get_scaled_positions(), kinds_of(atoms)[0]


def to_shared_axes(atoms: ase.Atoms) -> ase.Atoms:
    """Turn a solid to spglib's standard axes, where these share more rotations with the lattice."""
    given = crystal_of(atoms)
    group = elastic.group_of_structure(*given)
    turn = np.array(by_spglib("get_symmetry_dataset", given, ON_SITES).std_rotation_matrix)
    before, after = (  # rotations that nodes share
        (np.abs(turns - np.rint(turns)).max(axis=(1, 2)) < 1e-6).sum()
        for turns in (group, turn @ group @ turn.T)
    )
    if after > before:
        atoms = atoms.copy()
        atoms.set_cell(np.array(atoms.cell) @ turn.T, scale_atoms=True)
    return atoms


def exact_cell(atoms: ase.Atoms) -> ase.Atoms:
    """Cell symmetrised within 1e-4 Å, also to the rotations that a lattice of nodes shares."""
    found = by_spglib("get_symmetry", crystal_of(atoms), ON_SITES)
    W, edges = found["rotations"].astype(float), np.array(atoms.cell).T
    metric = (W.mT @ (edges.T @ edges) @ W).mean(axis=0)
    back = inv(edges)
    edges = np.real(sqrtm(back.T @ metric @ back)) @ edges
    turns = edges @ W @ inv(edges)
    whole = np.rint(turns)
    near = np.abs(turns - whole).max(axis=(1, 2)) < ALMOST
    turn, _ = polar((turns[near] @ whole[near].mT).mean(axis=0))
    exact: ase.Atoms = atoms.copy()
    exact.set_cell(edges.T @ turn, scale_atoms=True)
    return exact


def smallest(atoms: ase.Atoms, flat: bool) -> ase.Atoms:
    """Primitive cell in the same axes, with all arrays of atoms; a sheet's third edge stays."""
    small = elastic.primitive_cell(crystal_of(atoms), ON_SITES)
    if len(small[2]) >= len(atoms):
        return atoms
    edges = np.array(small[0])
    x = small[1] @ edges
    if flat:
        (up,) = np.flatnonzero(np.abs(edges[:, :2]).max(axis=1) < 1e-6)
        edges = edges[[(up + 1) % 3, (up + 2) % 3, up]]
        if det(edges) < 0:
            edges[2] *= -1
        x[:, 2] %= abs(edges[2, 2])
    one: ase.Atoms = atoms[kinds_of(atoms)[1][small[2]]]
    one.set_cell(edges)
    one.positions[:] = x
    return one


def _told_apart(atoms: ase.Atoms) -> None:
    """Warn of arrays beside those of calculators that tell atoms of one element apart."""
    kinds = len(kinds_of(atoms, KNOWN)[1])
    own = [name for name in atoms.arrays if name not in COUNTED]
    if names := [n for n in own if len(kinds_of(atoms, (*KNOWN, n))[1]) > kinds]:
        told = f"atoms of one element are told apart by {', '.join(names)}"
        warn(f"structure: {told}; delete from atoms.arrays what is none of the crystal")


def at_rest(
    atoms: ase.Atoms, calculator: Any, *, thickness: float | None = None, hold: Sequence[str] = ()
) -> Reference:
    """Relax a structure's smallest cell in forces and free stresses; arguments of `fit_crystal`."""
    held = set(VOIGT) if "all" in hold else set(hold)
    if not held <= set(VOIGT):
        raise InputError(f"hold: expected all, or of {', '.join(VOIGT)}, got {hold!r:.60}")
    cell, flat = oriented(atoms, not held or held >= set(VOIGT), thickness)
    turned = np.abs(np.array(cell.cell)[0] - np.array(atoms.cell)).max(axis=1).min() > FLAT
    _told_apart(cell)
    cell = smallest(cell, flat)
    short = minkowski_reduce(np.array(cell.cell), [True, True, not flat])[0]
    if norm(short) < (1 - ROUNDING) * norm(cell.cell):
        cell.set_cell(short)  # a skewed cell's repeats would be many
    cell.calc = calculator
    cell, strain, noise = _settled(cell, flat, held)
    kind, lengths = "a sheet" if flat else "a solid", cell.cell.lengths()[: 3 - flat]
    shape = f"{' x '.join(f'{one:.5g}' for one in lengths)} Å, {len(cell)} atoms"
    said = {"structure": f"{cell.get_chemical_formula()}, {kind}", "cell": shape}
    if noise.rounding:
        said["noise"] = f"{noise.force:.1e} eV/Å, which is rounding"
    if turned:
        where = ": x along an edge of the cell, z across" if flat else " to the conventional cell's"
        said["axes"] = f"turned{where}"
    if np.abs(strain).max() > MOVED:
        said["relaxed"] = f"the cell by strains of {strain.min():+.1%} to {strain.max():+.1%}"
    size, rule = thickness_of(cell) if flat and thickness is None else (thickness, "as given")
    stress = _stress_left(cell, size, flat, held, noise)
    if flat:
        said["thickness"] = f"{size:.4g} Å, {rule}"
        said["bending"] = "not in the model: it moves a sheet in its plane only"
    cell.calc = None
    return Reference(cell, size, stress, noise, said)


def _settled(cell: ase.Atoms, flat: bool, held: set[str]) -> tuple[ase.Atoms, ndarray, Noise]:
    """Relaxed cell, its strain on the way there, and the noise of its calculator."""
    calculator, before = cell.calc, np.array(cell.cell)
    cell.get_forces()  # before what may fail without a word
    _check_stress(cell, flat)
    noise = measured(cell, calculator, flat)
    _relax(cell, flat, held, noise)
    strain = svd(solve(before, np.array(cell.cell)), compute_uv=False) - 1
    if flat:
        strain = np.delete(strain, np.abs(strain).argmin())  # across it nothing is relaxed
    if not noise.rounding:  # it breaks the symmetry, which takes most of it away
        refine_symmetry(cell, noise.sites)
    if not held:  # disorder that has relaxed leaves a smaller cell, its axes a little off
        cell = exact_cell(smallest(cell if flat else to_shared_axes(cell), flat))
    cell.calc = calculator
    if not noise.rounding:
        refine_symmetry(cell, noise.sites)
        _relax(cell, flat, held, noise)
        if not held:  # steps under noise turn and shear a cell in its last digits
            cell = exact_cell(cell)
            cell.calc = calculator
        here = measured(cell, calculator, flat)  # dimples lie at rest, not where a cell was given
        noise = noise if here.rounding else here
    return cell, strain, noise


def _check_stress(cell: ase.Atoms, flat: bool) -> None:
    """Raise InputError for a stress that is not the energy's derivative by strain, to 1 %."""
    way = np.diag([1.0, 0.7, 0.0 if flat else 0.4])
    turns = np.eye(3) + STRAINED * np.array([0.5, 1.5, 1.0])[:, None, None] * way
    less, more, middle = strained(cell.calc, cell, turns)
    try:
        gain = more.get_potential_energy() - less.get_potential_energy()
        stress = middle.get_stress(voigt=False)
    except Exception:  # without energies nothing is compared, of a stress relaxation tells
        return
    wanted = gain / STRAINED / middle.get_volume()
    told = (stress * (way / (1 + STRAINED * np.diag(way)))).sum()
    if abs(told - wanted) > LIKE * abs(wanted):
        raise InputError(
            f"calculator: expected stress in eV/Å³, tension positive, got {told:.3g} at "
            f"{STRAINED:.0%} of strain where the energy says {wanted:.3g}"
        )


def _relax(cell: ase.Atoms, flat: bool, held: set[str], noise: Noise) -> None:
    """Relax atoms and the strains that are not held; under noise within the given symmetry."""
    # a force, or a stress on the cell, that is told from none
    quiet = max(QUIET, 2 * noise.force, 2 * noise.stress / EV_IN_TPA * cell.get_volume())
    steps = STEPS if noise.rounding else NOISY_STEPS
    if not noise.rounding:
        cell.set_constraint(FixSymmetry(cell, ON_SITES))  # exact forces keep it by themselves
    free = [name not in held and not (flat and "z" in name) for name in VOIGT]
    try:
        moving: Any = FrechetCellFilter(cell, mask=free) if any(free) else cell
        done = BFGS(moving, logfile=None).run(fmax=quiet, steps=steps)
    except NotImplementedError as error:
        raise InputError(
            f"calculator: it gives no stress ({error}); relax elsewhere and hold all"
        ) from None
    cell.set_constraint()
    force = np.abs(cell.get_forces()).max()
    if not done and force > max(RESIDUAL_FORCE, TIMES * quiet):
        raise InputError(
            f"structure: {steps} steps of relaxation leave a force of {force:.2g} eV/Å"
        )


def _stress_left(
    cell: ase.Atoms, thickness: float | None, flat: bool, held: set[str], noise: Noise
) -> ndarray | None:
    """Residual stress of the strains that are held, [d, d]; None without any."""
    d = 2 if flat else 3
    try:
        stress = cell.get_stress(voigt=False)[:d, :d]
    except NotImplementedError:
        warn("calculator: it gives no stress; the crystal is taken to be at rest")
        return None
    stress = stress * EV_IN_TPA * (cell.cell[2, 2] / thickness if flat else 1.0)
    none = max(RESIDUAL_STRESS, 2 * TIMES * noise.stress)
    for name, (i, j) in zip(VOIGT, PAIRS[3]):
        if max(i, j) < d and name not in held and abs(stress[i, j]) > none:
            left = 1e3 * stress[i, j]
            raise InputError(f"structure: relaxation left a stress {name} of {left:.3g} GPa")
    return None if np.abs(stress).max() <= none else symmetric_part(stress)


def thickness_of(cell: ase.Atoms) -> tuple[float, str]:
    """Thickness [Å] of a sheet from outermost nuclei and their van der Waals radii, and a note."""
    z = np.array(cell.positions)[:, 2]
    radii = [vdw_radii[cell.numbers[n]] for n in (z.argmin(), z.argmax())]
    known = np.nan_to_num(radii, nan=USUAL_RADIUS)
    guess = " (2 Å where none is known)" if np.isnan(radii).any() else ""
    return float(np.ptp(z) + known.sum()), (
        f"{np.ptp(z):.4g} Å between outermost nuclei and van der Waals radii of "
        f"{known[0]:.3g} and {known[1]:.3g} Å{guess}"
    )


def usual_spacing(cell: ase.Atoms, flat: bool) -> float:
    """Default node spacing [Å]: the edge of a cube as large as the conventional cell. A hexagonal
    cell counts twice; of a sheet the longer edge of its smallest rectangle, or √(2 area)."""
    if not flat:
        found = by_spglib("get_symmetry_dataset", crystal_of(cell), ON_SITES)
        volume = abs(cell.get_volume()) * len(found.std_types) / len(cell)
        hexagonal = 143 <= found.number <= 194 and "R" not in found.international
        return float((volume * (2 if hexagonal else 1)) ** (1 / 3))
    edges = minkowski_reduce(np.array(cell.cell), [True, True, False])[0][:2]
    a, b = sorted(edges, key=norm)
    for pair in (a, b), (a, 2 * b - a), (a, 2 * b + a), (a + b, a - b):
        first, second = norm(pair, axis=1)
        if abs(pair[0] @ pair[1]) < RIGHT * first * second:
            return float(max(first, second))
    return float(np.sqrt(2 * norm(np.cross(a, b))))
