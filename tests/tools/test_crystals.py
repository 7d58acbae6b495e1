"""Recipes of crystals: at rest, and stiff as LAMMPS finds them when it strains a period."""

import numpy as np
import pytest

from tools.crystals import RECIPES, at_rest, force_constants, isotropic_lps, session, spacing_of
from warp_peri.atoms.phonons import wave_loads
from warp_peri.core.elastic import allowed_tensors
from warp_peri.core.groups import point_group
from warp_peri.materials.crystal_fit import from_phonons

STRAIN = 1e-3
"""Below it the steps of a tabulated potential show."""


def strained_stress(name, along):
    """dσ/dε of a period that is stretched along an axis, its atoms relaxed [TPa]."""
    recipe, found = RECIPES[name], []
    for sign in (1, -1):
        cell, _ = at_rest(name)
        edges = np.diag(cell.cell).copy()
        edges[along] *= 1 + sign * STRAIN
        cell.set_cell(edges, scale_atoms=True)
        wide = cell.repeat([1 if n > 20 else int(np.ceil(20 / n)) for n in edges])
        with session(name, wide) as lammps:
            lammps.relax(1e-10)
            stress = lammps.stress()
        if recipe.thickness is not None:
            stress *= edges[2] / recipe.thickness
        found.append(stress)
    return (found[0] - found[1]) / (2 * STRAIN)


@pytest.mark.parametrize(
    ("name", "along"),
    [
        ("stretched-graphene", 1),
        pytest.param("Mg", 2, marks=pytest.mark.slow),
        pytest.param("MgO", 0, marks=pytest.mark.slow),
    ],
)
def test_moduli_from_phonons_are_those_of_a_strained_period(name, along):
    recipe, atoms = RECIPES[name], force_constants(name)
    d = atoms.dimension
    C = atoms.elastic(allowed_tensors(recipe.symmetry, point_group(recipe.symmetry, d), np.eye(d)))
    slope = strained_stress(name, along)
    assert C[along, along, along, along] == pytest.approx(slope[along, along], rel=2e-3)


def test_nodes_out_of_step_with_atoms_see_their_answers():
    """Graphene: a law of its phonons answers unseen loads; on average smoothing takes nothing."""
    atoms = force_constants("graphene")
    h = spacing_of(np.diag(atoms.cell), RECIPES["graphene"])
    loads = wave_loads(atoms, h, longest=18.0, shortest=4.0, loads=4, seed=5)
    law = from_phonons(atoms, h, 2.5 * h, symmetry="6mm")
    E_res, E_u = loads.errors_of(law)
    assert E_u < 1.3
    assert E_res < 6.0
    assert loads.errors(atoms.effective)[1] < 0.3
    assert loads.errors_of(isotropic_lps(atoms, h, 2 * h))[1] > 2 * E_u
