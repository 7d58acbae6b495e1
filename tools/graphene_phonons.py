"""Force constants of graphene at 0 K."""

import ase
import numpy as np

from tools.graphene import THICKNESS, bond_length, sheet
from tools.lammps_session import LammpsSession
from warp_peri.atoms.force_constants import ForceConstants, finite_differences, from_supercell

CELLS = (9, 6)
"""Of the supercell, four atoms each; forces reach two bonds."""


def force_constants() -> ForceConstants:
    """Of the rectangular cell of four atoms, by finite differences on a supercell."""
    flat, box = sheet(bond_length(), cells=CELLS)
    x = np.pad(flat, ((0, 0), (0, 1)))
    cell = [box[0] / CELLS[0], box[1] / CELLS[1], 20.0]
    one = ase.Atoms("C4", positions=x[:4], cell=cell, pbc=True)
    many = ase.Atoms(f"C{len(x)}", positions=x, cell=[*box, 20.0], pbc=True)
    with LammpsSession(flat, box=box) as session:

        def forces(moved: np.ndarray) -> np.ndarray:
            return np.pad(session.forces(moved[:, :2]), ((0, 0), (0, 1)))

        phi, change = finite_differences(forces, x, range(4))
    return from_supercell(one, many, phi, range(4), thickness=THICKNESS, change=change)
