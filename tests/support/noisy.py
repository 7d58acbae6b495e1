"""Calculators whose forces are noisy, and magnesium oxide whose ions' charges are told."""

import numpy as np
from ase.calculators.calculator import Calculator

import warp_peri as wp
from warp_peri.atoms.phonons import BORN, DIELECTRIC

LEWIS_CATLOW = (
    "pair_style buck/coul/long 8.0 10.0",
    "pair_coeff * * 0 1 0",
    "pair_coeff 1 2 1428.5 0.2945 0",
    "pair_coeff 2 2 22764.3 0.149 27.88",
    "kspace_style ewald 1e-9",
)
"""Rigid ions (G. V. Lewis and C. R. A. Catlow, 1985)."""


class Noisy(Calculator):
    """A calculator with Gaussian noise on its forces, and a tenth of it [eV/Å³] on its stress.

    Noise of the stress falls with the root of the number of atoms.
    """

    def __init__(self, inner, noise, seed=0):
        super().__init__()
        self.inner, self.noise, self.rng = inner, noise, np.random.default_rng(seed)
        self.implemented_properties = list(inner.implemented_properties)

    def calculate(self, atoms=None, properties=(), changes=()):
        super().calculate(atoms, properties, changes)
        one = atoms.copy()
        one.calc = self.inner
        forces, stress, random = one.get_forces(), one.get_stress(), self.rng.standard_normal
        stress = stress + 0.1 * self.noise / np.sqrt(len(one)) * random(6)
        forces = forces + self.noise * random(forces.shape)
        self.results = {**self.inner.results, "forces": forces, "stress": stress}


def rigid_ions():
    """Magnesium oxide by LAMMPS."""
    wp.atoms.find_mpi()
    from ase.calculators.lammpslib import LAMMPSlib

    class RigidIons(LAMMPSlib):
        implemented_properties = (*LAMMPSlib.implemented_properties, BORN, DIELECTRIC)

        def calculate(self, atoms=None, properties=(), changes=()):
            super().calculate(atoms, ["energy", "forces", "stress"], changes)
            charges = np.where(atoms.numbers == 12, 2.0, -2.0)
            self.results[BORN] = charges[:, None, None] * np.eye(3)
            self.results[DIELECTRIC] = np.eye(3)

    return RigidIons(
        lmpcmds=list(LEWIS_CATLOW),
        atom_types={"Mg": 1, "O": 2},
        lammps_header=["units metal", "atom_style charge", "atom_modify map array sort 0 0"],
        amendments=["set type 1 charge 2.0", "set type 2 charge -2.0"],
        keep_alive=True,
        log_file=None,
    )
