"""Noisy calculators: noise measured, rules of force constants, moduli with true errors."""

from dataclasses import replace
from typing import ClassVar

import numpy as np
from ase.build import bulk
from ase.calculators.calculator import Calculator
from ase.calculators.emt import EMT
from ase.neighborlist import neighbor_list
from numpy import array, eye, pi, sqrt
from numpy.linalg import eigh, inv, norm
from numpy.random import default_rng

import warp_peri as wp
from tests.crystal.crystals import CUBES
from tests.support import filterwarnings, near, refused, slow, sup
from tests.support.problems import normal, slope
from warp_peri.atoms import calculator_noise as noises
from warp_peri.atoms import phonons
from warp_peri.atoms.calculator_noise import Symmetric, bent_by_strain, joined, measured, projected
from warp_peri.atoms.calculators import lammps_calculator
from warp_peri.atoms.force_constants import from_supercell
from warp_peri.atoms.phonons import at_zone_edge, check_phonons, finite_differences
from warp_peri.atoms.relaxed import at_rest
from warp_peri.crystals import NonAnalyticCorrection, from_calculator

ALUMINIUM = {"C11": 53.3253, "C12": 32.8906, "C44": 36.2004}
"""Under EMT, by finite strains of 1e-4 [GPa]."""
Rounded = type("Rounded", (EMT,), {"get_forces": lambda *of: EMT.get_forces(*of).round(5)})
"""Forces with five decimals."""
REST = 2.8246
CELL = bulk("Al", a=2**0.5 * REST)


class Noisy(Calculator):
    """Gaussian noise on forces, a tenth of it on the stress over the root of the atoms' number."""

    def __init__(self, inner, noise, seed=0):
        super().__init__()
        self.inner, self.noise, self.rng = inner, noise, default_rng(seed)
        self.implemented_properties = list(inner.implemented_properties)

    def calculate(self, atoms=None, properties=(), changes=()):
        super().calculate(atoms, properties, changes)
        one = atoms.copy()
        one.calc = self.inner
        forces, stress, random = one.get_forces(), one.get_stress(), self.rng.standard_normal
        stress = stress + 0.1 * self.noise / sqrt(len(one)) * random(6)
        forces = forces + self.noise * random(forces.shape)
        self.results = {**self.inner.results, "forces": forces, "stress": stress}


def test_noise_is_measured_and_rounding_of_forces_is_noise():
    cell = bulk("Al", a=3.994)
    assert measured(cell, EMT(), False).rounding
    noisy, rounded = (measured(cell, one, False) for one in (Noisy(EMT(), 1e-4), Rounded()))
    near(noisy.force, 1e-4, 0.25)
    near(noisy.stress, 0.1e-4 * 0.1602, 0.5)
    near(rounded.force, 1e-5 / 12**0.5, 0.25)
    assert not any(one.rounding for one in (noisy, rounded))


def test_a_noisy_calculator_gives_a_law_whose_errors_are_true_and_small():
    aluminium = wp.fit_crystal(bulk("Al"), Noisy(EMT(), 1e-5, 3), supercell=(5, 5, 5))
    figures = aluminium.content()
    bars = figures["standard_errors_GPa"]
    for name, true in ALUMINIUM.items():
        value = figures["moduli_GPa"]["atoms"][name]
        assert abs(value - true) < 3 * bars[name] < 0.003 * true
        assert abs(figures["moduli_GPa"]["law"][name] - value) < 1e-3
    assert set(aluminium.said) >= {"noise", "displacements", "both"}
    assert "agree" in aluminium.said["both"]
    exact = from_calculator(bulk("Al", a=3.99413), EMT(), (5, 5, 5))
    true, none, _ = at_zone_edge(replace(exact, doubt=0 * exact.values[None]))
    found, bar, most = at_zone_edge(aluminium.atoms)
    assert none < abs(found - true) < 3 * bar < 3 * most + 1e-12 < 0.01
    assert f"{found:.3f} ± {bar:.2g} THz" in aluminium.said["phonons at the zone's edge"]
    assert 0 < aluminium.law.provenance["moduli_error"] == aluminium.unsure < 0.003


def differences(cell, many):
    """Φ [n, N, 3, 3] of a cell with repeats of it."""
    forces = phonons.forces_of(many, EMT())
    return finite_differences(forces, many.positions.copy(), range(len(cell)))[0]


def test_broken_force_constants_are_brought_to_the_rules_and_the_shift_is_their_error():
    """Of a hexagonal crystal of two atoms."""
    cell = bulk("Ni", "hcp", a=2.47, c=4.03)
    many = cell.repeat((3, 3, 2))
    phi = differences(cell, many)
    noise = normal(phi.shape, 1)
    size = 1e-3 * sup(phi)
    kept, true = (projected(cell, many, one, (0, 1)) for one in (phi + size * noise, phi))
    zeroth, first, second = kept.moments()
    top = sup(kept.values)
    assert sup(zeroth.sum(2)) < 1e-9 * top
    assert sup(first - first.swapaxes(2, 3)) < 1e-7 * top
    assert sup(second - second.transpose(2, 3, 0, 1)) < 1e-6 * top
    broken = from_supercell(cell, many, phi + size * noise, (0, 1))
    near(kept.doubt[0], kept.values - broken.values, 1e-12 * top, 1)
    off = (kept.values - true.values)[kept.vectors.any(1)]  # all sums are at the atoms
    assert norm(off) < 0.3 * size * sqrt(noise.size)
    kept = replace(kept, edge=0.0, cut=None)  # a supercell as narrow as this is warned of
    assert 0 < wp.atoms.crystal_from_force_constants(kept).unsure < 0.1


def test_an_imaginary_phonon_is_refused_beyond_three_standard_errors():
    atoms = from_calculator(bulk("Cu", "sc", a=2.4), EMT(), (4, 4, 4))
    with refused(r"imaginary phonon, the worst of [\d.]+ ± [\d.e-]+i THz"):
        check_phonons(replace(atoms, doubt=1e-3 * atoms.values[None]))
    unsure = replace(atoms, doubt=0.5 * atoms.values[None])
    check_phonons(unsure)
    with refused(r"a stable crystal, got the stiffness -[\d.e+-]+ eV"):
        unsure.effective(array([[0.0, 0.0, 1.0], [0.9, 0.9, 0.9]]))


def test_born_charges_sum_to_zero_and_their_self_term_is_symmetric():
    """Sites of symmetry 3: charges with an antisymmetric part, as of aluminium in corundum."""
    turned = array([[2.9, 0.2, 0.0], [-0.2, 2.9, 0.0], [0.0, 0.0, 2.8]])
    other = np.diag([-1.5, -2.1, -1.8])  # of two charges alone that are opposite all is symmetric
    born = array([turned, other, 0.1 * eye(3) - turned - other])
    polar = NonAnalyticCorrection(born, 3 * eye(3), decay=1.0)
    assert sup(polar.born.sum(0)) < 1e-12
    cell = array([[4.0, 0, 0], [-2.0, 12**0.5, 0], [0, 0, 5.0]])
    x = array([[0, 0, 0], [2.0, 1.1, 1.3], [0.3, 2.0, 3.1]])
    D = polar.matrix(array([[0.1, 0.2, 0.05]]), cell, x)[0].reshape(9, 9)
    near(D.conj().T, D, 1e-12)


def test_forces_that_are_rough_are_none_sooner():
    reference = at_rest(bulk("Cu"), EMT())
    noise = replace(measured(reference.cell, EMT(), False), force=1e-6, rough=1.0)
    rough = replace(reference, noise=noise)  # whose forces far away are no noise
    assert phonons.wide_enough(rough, EMT(), (4.0, 6.0, 8.0)) == (3, 3, 3)


class Dimpled(EMT):
    """EMT and bonds that are stiffer on their first hundredth of an angstrom, or the width."""

    default_parameters: ClassVar = EMT.default_parameters | {"width": 0.01, "stiff": 0.5}

    def calculate(self, *given, **named):
        super().calculate(*given, **named)
        i, r, way = neighbor_list("idD", self.atoms, 1.15 * REST)
        width = self.parameters.width
        depth = 0.5 * self.parameters.stiff * width**2 * np.exp(-(((r - REST) / width) ** 2))
        pull = (2 * depth * (r - REST) / width**2 / r)[:, None] * way  # on i, to its neighbour
        np.add.at(self.results["forces"], i, pull)
        virial = 0.5 * pull.T @ way / self.atoms.get_volume()
        self.results["stress"] += virial[(0, 1, 2, 1, 0, 0), (0, 1, 2, 2, 2, 1)]
        self.results["energy"] -= depth.sum() / 2


def stress(strain):
    """Of the dimpled crystal along x [GPa]."""
    cell = bulk("Al", a=2**0.5 * REST, cubic=True)
    cell.set_cell(array(cell.cell) * [1 + strain, 1, 1], scale_atoms=True)
    cell.calc = Dimpled()
    return 160.2176634 * cell.get_stress()[0]


@slow
@filterwarnings("ignore:force constants:UserWarning")  # what is rough has no end
def test_a_surface_with_a_dimple_is_measured_beyond_it_and_its_spread_is_an_error():
    found = measured(CELL, Noisy(Dimpled(), 3e-6), False)
    assert found.rough > 100 * found.force
    assert found.length == 0.03
    assert measured(CELL, Noisy(EMT(), 3e-6), False).rough == 0
    crystal = wp.fit_crystal(CELL, Noisy(Dimpled(), 3e-6))
    figures = crystal.content()
    value, bar = figures["moduli_GPa"]["atoms"]["C11"], figures["standard_errors_GPa"]["C11"]
    strains = 1e-3, *(noises.LARGEST * size for size in noises.PULLED)
    small, *sizes = (slope(stress, strain, order=2) for strain in strains)  # secants: C11
    assert small > 1.2 * sizes[-1]  # the dimple is there
    assert abs(value - sizes[-1]) < bar
    assert abs(value - small) < 3 * bar < small
    assert sup(value - array(sizes)) < 1.05 * bar
    assert "largest steps" in crystal.said["rough"]


def test_strains_tell_moduli_and_not_how_all_waves_change_with_the_displacement():
    cell = bulk("Cu", a=3.59)
    every = Symmetric(cell, cell.repeat(3), (0,))
    phi = differences(cell, cell.repeat(3))
    atoms = replace(every.pairs, values=every.values(phi))
    rng = default_rng(2)
    _, free = every.rules()
    each = free @ free.T * (0.05 * np.tensordot(every.basis, phi, 4))
    each = every.values(np.tensordot(each.T, every.basis, 1))
    k = array([[0.5, 0.5, 0], [0.5, 0, 0]]) @ (2 * pi * inv(cell.cell).T)
    for spread in (each, None):
        share = []
        for _ in range(20):
            one, other = np.tensordot(rng.standard_normal((2, len(each))), each, 1)
            true = replace(atoms, values=atoms.values + one)
            C = true.nearest_elastic(CUBES)[0]
            found = replace(atoms, doubt=other[None], spread=spread)
            told, _, _ = joined(found, CUBES, C, 1e-4 * C[None])
            size, waves = eigh(told.dynamical(k))
            off = np.einsum("kai,kab,kbi->ki", waves.conj(), true.dynamical(k), waves).real - size
            error = [told.stiffness_error(q, w.T.reshape(3, 1, 3)) for q, w in zip(k, waves)]
            share.append(np.abs(off) < 2 * array(error))
        within = np.mean(share)
        assert within > 0.9 if spread is not None else within < 0.6


def test_what_is_rough_is_told_from_what_is_smooth_by_stress_over_strain():
    """Of smooth potentials it changes by less; some surfaces strains alone show to be rough."""
    tungsten = lammps_calculator("eam/alloy", ["W"], "W_zhou.eam.alloy")
    for name, calculator in (("Al", EMT()), ("W", tungsten)):
        cell = at_rest(bulk(name), calculator).cell
        assert 0 < bent_by_strain(cell, calculator, False, 0.0) < noises.BENDING
    found = measured(CELL, Noisy(Dimpled(width=0.03, stiff=0.1), 3e-6), False)
    rough = found.rough / found.linear
    assert noises.BENDING < rough < noises.ROUGH  # less than asked of displacements
    assert found.length == 0.03
    assert measured(CELL, Noisy(EMT(), 1e-3), False).rough == 0  # noise is not taken for it
