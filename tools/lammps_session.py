"""LAMMPS inside this process: energy, forces, stress and dynamics of atoms in one plane."""

import ctypes
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Self

import ase.data
import numpy as np

from warp_peri.atoms.calculators import (
    LammpsError,
    check_path,
    lammps_class,
    lammps_words,
    potential_file,
)

POTENTIAL = "SiC_1989.tersoff"
BAR_IN_EV_PER_CUBIC_ANGSTROM = 1e5 * 1e-30 / 1.602176634e-19
CARBON_MASS = float(ase.data.atomic_masses[ase.data.atomic_numbers["C"]])
"""[amu]"""

_HEIGHT = 20.0  # of the LAMMPS box [Å]; the atoms stay at z = 0 and never see their images


class LammpsSession:
    """Atoms in the plane z = 0 under a Tersoff potential, evaluated by LAMMPS.

    The atoms move in x and y only. Sessions are independent of each other; `close` (or the end of
    a `with` block) frees one.
    """

    def __init__(
        self,
        positions: np.ndarray,
        *,
        box: tuple[float, float] | None,
        potential: str | Path | None = None,
        elements: Sequence[str] = ("C",),
    ) -> None:
        """Hand the atoms to LAMMPS.

        `positions`: [Å], shape [A, 2]; `box`: periods (Lx, Ly) [Å], None for a free body;
        `potential`: a Tersoff file with entries for the elements, by default the wheel's own
        POTENTIAL; `elements`: of the atoms, in turn.

        Raises ValueError for positions or periods that are not finite, no such element, or a path
        that LAMMPS would take for a command, FileNotFoundError for a missing potential,
        LammpsError when LAMMPS fails.
        """
        positions = np.asarray(positions, dtype=float)
        file = potential_file(POTENTIAL) if potential is None else Path(potential)
        _check(positions, box, file, elements)
        low = positions.min(axis=0) if box is None else positions.mean(axis=0) - np.divide(box, 2)
        high = positions.max(axis=0) if box is None else low + box
        margin = 20.0 if box is None else 0.0
        edges = [low[0] - margin, high[0] + margin, low[1] - margin, high[1] + margin]
        self.atoms = len(positions)
        self._height_over_bar = _HEIGHT * BAR_IN_EV_PER_CUBIC_ANGSTROM
        self._xyz = np.zeros((self.atoms, 3))
        self._xyz[:, :2] = positions
        cell = " ".join(f"{edge:.17g}" for edge in [*edges, -_HEIGHT / 2, _HEIGHT / 2])
        types = (1 + np.arange(self.atoms) % len(elements)).tolist()
        masses = [ase.data.atomic_masses[ase.data.atomic_numbers[name]] for name in elements]
        with lammps_words():
            self._lammps = lammps_class()(cmdargs=["-log", "none", "-screen", "none", "-nocite"])
            for line in (
                "units metal",
                "atom_style atomic",
                "atom_modify map array sort 0 0",
                f"boundary {'f f p' if box is None else 'p p p'}",
                f"region cell block {cell}",
                f"create_box {len(elements)} cell",
                *(f"mass {n} {float(mass)}" for n, mass in enumerate(masses, start=1)),
            ):
                self._lammps.command(line)
            ids = list(range(1, self.atoms + 1))
            self._lammps.create_atoms(self.atoms, ids, types, self._xyz.ravel().tolist())
            if self._lammps.get_natoms() != self.atoms:
                raise LammpsError(f"LAMMPS took {self._lammps.get_natoms()} of {self.atoms} atoms")
            for line in (
                "pair_style tersoff",
                f'pair_coeff * * "{file}" {" ".join(elements)}',
                "neighbor 0.1 bin",
                "thermo_modify lost error norm no",
            ):
                self._lammps.command(line)

    def forces(self, positions: np.ndarray) -> np.ndarray:
        """Forces on the atoms [eV/Å] at `positions` [Å], both of shape [A, 2].

        Raises LammpsError when LAMMPS fails, e.g. because an atom left the box of a free body.
        """
        self._xyz[:, :2] = positions
        address = self._xyz.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
        with lammps_words():
            self._lammps.scatter_atoms("x", 1, 3, address)
            # A full set-up costs a quarter more than reusing neighbour lists and cannot go stale.
            self._lammps.command("run 0 post no")
            flat = np.ctypeslib.as_array(self._lammps.gather_atoms("f", 1, 3))
        return flat.reshape(-1, 3)[:, :2].copy()

    def trajectory(
        self,
        positions: np.ndarray,
        force: np.ndarray,
        *,
        temperature: float,
        seed: int,
        steps: int,
        timestep: float,
        damping: float,
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Langevin dynamics under a constant load: positions and internal forces of every step.

        Atoms begin without potential energy to speak of, so with twice their kinetic energy. Two
        trajectories of one seed have the same initial velocities and the same random forces on
        every atom, whatever the load.

        `positions`: to start from [Å], `force`: on the atoms from outside [eV/Å], shapes [A, 2];
        `temperature`: [K]; `seed`: of velocities and random forces, from 1; `timestep`, and
        `damping`, in which friction stops an atom: [ps].

        Yields positions [Å], wrapped into the box, and forces between atoms [eV/Å], shapes [A, 2],
        views that the next step overwrites.

        Raises LammpsError when LAMMPS fails, e.g. because an atom was lost.
        """
        self.forces(positions)
        with lammps_words():
            self._lammps.command(f"timestep {timestep:.17g}")
        fixes = self._langevin(temperature, damping, seed)
        with lammps_words():
            self._lammps.numpy.fix_external_get_force("push")[: self.atoms, :2] = force
            self._lammps.command("run 0 post no")
        try:
            for _ in range(steps):
                with lammps_words():
                    self._lammps.command("run 1 pre no post no")
                    x = self._lammps.numpy.extract_atom("x")
                    inner = self._lammps.numpy.extract_fix("inner", 1, 2)
                yield x[: self.atoms, :2], inner[: self.atoms, :2]
        finally:
            for name in fixes:
                self._lammps.command(f"unfix {name}")

    def _langevin(self, temperature: float, damping: float, seed: int) -> Sequence[str]:
        """Draw velocities and set up friction, random forces and a load; the fixes to undo."""
        kelvin = f"{temperature:.17g}"
        fixes = {
            "inner": "store/force",  # before the others, so that it sees the atoms' own forces
            "push": "external pf/array 1",
            "simulate": "nve",
            "heat": f"langevin {kelvin} {kelvin} {damping:.17g} {seed} zero yes",
            "plane": "setforce NULL NULL 0",
        }
        with lammps_words():
            self._lammps.command(
                f"velocity all create {2 * temperature:.17g} {seed} mom yes rot no dist gaussian"
            )
            self._lammps.command("velocity all set NULL NULL 0")
            for name, words in fixes.items():
                self._lammps.command(f"fix {name} all {words}")
        return list(fixes)

    def write_dump(self, path: str | Path) -> None:
        """Write the positions last given to `forces` as a LAMMPS text dump.

        Raises ValueError for a path that LAMMPS would take for a command.
        """
        check_path("path", Path(path))
        with lammps_words():
            self._lammps.command(
                f'write_dump all custom "{path}" id type x y z modify sort id format float %.15g'
            )

    def membrane_stress(self) -> np.ndarray:
        """Stress times thickness [eV/Å²], shape [2, 2], at the positions last given to `forces`.

        Only a periodic sheet has one.
        """
        xx, yy, xy = (self._lammps.get_thermo(name) for name in ("pxx", "pyy", "pxy"))
        return -self._height_over_bar * np.array([[xx, xy], [xy, yy]])

    def close(self) -> None:
        """Free the atoms; the session is of no use afterwards."""
        self._lammps.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _check(
    positions: np.ndarray, box: tuple[float, float] | None, file: Path, elements: Sequence[str]
) -> None:
    """Refuse what a session cannot be made of, as LammpsSession says."""
    if positions.ndim != 2 or positions.shape[1] != 2 or len(positions) == 0:
        raise ValueError(f"positions: expected shape [A, 2], got {list(positions.shape)}")
    if not np.isfinite(positions).all():
        raise ValueError("positions: expected finite values")
    if box is not None and not all(math.isfinite(side) and side > 0 for side in box):
        raise ValueError(f"box: expected two lengths > 0, got {box}")
    if not file.is_file():
        raise FileNotFoundError(f"interatomic potential not found: {file}")
    check_path("potential", file)
    if not elements or not set(elements) <= set(ase.data.chemical_symbols[1:]):
        raise ValueError(f"elements: expected chemical symbols, got {list(elements)}")
