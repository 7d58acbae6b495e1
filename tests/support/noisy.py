"""Calculators whose forces are noisy."""

import numpy as np
from ase.calculators.calculator import Calculator


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
