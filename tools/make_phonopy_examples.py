"""Small files of phonopy to read: copper by ASE's EMT, magnesium oxide of rigid ions by LAMMPS.

python tools/make_phonopy_examples.py examples/phonopy
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import ase
import ase.build
import numpy as np
from ase.calculators.emt import EMT

from tools.crystals import at_rest, session

Forces = Callable[[ase.Atoms], np.ndarray]
STEP = 0.01
"""Of the atoms that are displaced [Å]."""


def write(folder: Path, cell: ase.Atoms, repeats: int, forces: Forces, born: str = "") -> None:
    """phonopy_disp.yaml, FORCE_SETS and BORN of one crystal.

    `forces`: of an ase.Atoms [eV/Å]; `born`: content of the file of that name.
    """
    from phonopy import Phonopy
    from phonopy.file_IO import write_FORCE_SETS
    from phonopy.structure.atoms import PhonopyAtoms

    folder.mkdir(parents=True, exist_ok=True)
    unit = PhonopyAtoms(
        symbols=cell.get_chemical_symbols(), cell=cell.cell, positions=cell.positions
    )
    made: Any = Phonopy(unit, np.diag([repeats] * 3), primitive_matrix="F")
    made.generate_displacements(distance=STEP)
    found = []
    for moved in made.supercells_with_displacements:
        atoms = ase.Atoms(moved.symbols, positions=moved.positions, cell=moved.cell, pbc=True)
        found.append(forces(atoms))
    made.forces = np.round(found, 10)
    made.save(
        folder / "phonopy_disp.yaml", settings={"force_sets": False, "force_constants": False}
    )
    write_FORCE_SETS(made.dataset, folder / "FORCE_SETS")
    if born:
        (folder / "BORN").write_text(born)


def copper(atoms: ase.Atoms) -> np.ndarray:
    atoms.calc = EMT()
    return atoms.get_forces()


def magnesia(atoms: ase.Atoms) -> np.ndarray:
    with session("MgO", atoms) as lammps:
        return lammps.forces(atoms.positions)


if __name__ == "__main__":
    out = Path(sys.argv[1])
    write(out / "copper", ase.build.bulk("Cu", a=3.5898, cubic=True), 3, copper)
    ions = "14.399645\n1 0 0 0 1 0 0 0 1\n2 0 0 0 2 0 0 0 2\n-2 0 0 0 -2 0 0 0 -2\n"
    write(out / "magnesia", at_rest("MgO")[0], 3, magnesia, ions)
