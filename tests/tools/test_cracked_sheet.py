"""Cracked sheets of atoms: what is cut, forces without the cut bonds, the fold."""

import numpy as np
import pytest

from tools.cracked_sheet import (
    CutSession,
    Pulled,
    _uniaxial_stress,
    cracked_sheet,
    longer_cutoff,
)
from tools.elastic import elastic_constants
from tools.graphene import bond_length

STEP = np.sqrt(3) * bond_length()


@pytest.mark.parametrize("bonds", [4, 5])
def test_a_zigzag_crack_cuts_upright_bonds(bonds):
    ends = np.array([(-bonds * STEP / 2, 0), (bonds * STEP / 2, 0)]) + (STEP / 2) * (bonds % 2)
    body = cracked_sheet([ends * (1, 0)], half=12.0)
    assert body.cut.sum() == bonds
    middle = body.positions[body.bonds[body.cut]].mean(axis=1)
    assert np.abs(middle[:, 1]).max() < 1e-9
    assert np.bincount(body.bonds[~body.cut].ravel()).min() >= 2


def test_an_uncut_sheet_is_at_rest_and_a_cut_one_is_not(tmp_path):
    potential = longer_cutoff(tmp_path)
    inside = []
    for cracks in ([], [np.array([(-2 * STEP, 0.0), (2 * STEP, 0.0)])]):
        body = cracked_sheet(cracks, half=12.0)
        with CutSession(body, potential) as session:
            forces = session.forces(body.positions)
            inside.append(np.abs(forces[~body.held]).max())
    assert inside[0] < 1e-6
    assert inside[1] > 1


def test_a_whole_sheet_has_the_moduli_at_small_strains_and_a_largest_stress(tmp_path):
    bond, potential = bond_length(), longer_cutoff(tmp_path)
    constants = elastic_constants(bond)
    stiffness = constants["lambda"] + 2 * constants["mu"]
    stress = [_uniaxial_stress(bond, e, potential, 1) for e in (1e-4, 0.1, 0.18, 0.3)]
    assert stress[0] == pytest.approx(1e-4 * stiffness, rel=2e-3)
    assert stress[1] < stress[2] > stress[3]


def test_atoms_across_a_hexagon_stay_strangers_where_a_sheet_contracts(tmp_path):
    bond, potential = bond_length(), longer_cutoff(tmp_path)
    strains = np.array([-0.03, -0.05, -0.07])  # a cut-off of 2.8 Å would reach them at −0.042
    stress = [_uniaxial_stress(bond, e, potential, 1) for e in strains]
    slopes = np.diff(stress) / np.diff(strains)
    assert slopes[1] == pytest.approx(slopes[0], rel=0.2)


@pytest.mark.slow
def test_a_small_sheet_holds_until_its_fold(tmp_path):
    body = cracked_sheet([np.array([(-3 * STEP, 0.0), (3 * STEP, 0.0)])], half=16.0)
    with CutSession(body, longer_cutoff(tmp_path)) as session:
        low, high = Pulled(body, session).critical_strain(0.05)
    assert 0.03 < low < high < 0.12
    assert high / low < 1.03
