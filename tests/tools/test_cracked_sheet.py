"""Cracked sheets of atoms: what is cut, forces without the cut bonds, the fold."""

from dataclasses import replace

import numpy as np
import pytest

from tools.cracked_sheet import (
    CutSession,
    Pulled,
    _uniaxial_stress,
    cracked_sheet,
    finished,
    longer_cutoff,
    opened,
    opened_ends,
)
from tools.elastic import elastic_constants
from tools.graphene import bond_length
from warp_peri import InputError

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


def test_bonds_that_are_open_are_no_rest(tmp_path):
    body = cracked_sheet([], half=8.0)
    with CutSession(body, longer_cutoff(tmp_path)) as session:
        apart = 3 * body.positions  # no atom sees another any more, so that no force is left
        held = replace(body, held=np.ones(len(apart), bool))
        held.held[len(apart) // 2] = False
        pulled = Pulled(held, session)
        assert pulled.rest(body.positions)[1]
        assert not pulled.rest(apart)[1]


def test_finished_sheets_lack_nothing(tmp_path):
    kept = tmp_path / "atoms.json"
    assert finished(kept, "strain") == {}
    kept.write_text('{"old": {"strain": 0.03}, "new": {"strain": 0.04, "half_length": 3.0}}')
    assert set(finished(kept, "strain")) == {"old", "new"}
    assert set(finished(kept, "strain", "half_length")) == {"new"}
    for text in ("{", "[1]", '{"old": 3}'):
        kept.write_text(text)
        with pytest.raises(InputError, match="expected sheets that were pulled before"):
            finished(kept, "strain")


def test_an_open_crack_ends_between_the_last_bond_it_cuts_and_the_next():
    slanted = np.array([(-9.0, -6.5), (8.0, 5.0)])
    other = np.array([(3.5 * STEP, 0.0), (6.5 * STEP, 0.0)])
    body = cracked_sheet([slanted, other], half=22.0)
    tips = opened_ends(body, slanted)
    along = (slanted[1] - slanted[0]) / np.linalg.norm(slanted[1] - slanted[0])
    away = (tips - slanted[0]) @ [-along[1], along[0]]
    assert np.abs(away).max() < 1e-12  # on its line
    assert np.abs(tips - slanted).max() < STEP
    assert opened(body, slanted) == pytest.approx(np.linalg.norm(tips[1] - tips[0]))
    row = opened_ends(body, other)
    assert row == pytest.approx(np.array([(3 * STEP, 0), (6 * STEP, 0)]), abs=STEP)
    assert opened(body, other) == pytest.approx(3 * STEP)
    assert opened_ends(cracked_sheet([], half=22.0), other) == pytest.approx(row)
    for wrong in ((-1e-3, 1e-3), (-40.0, 40.0)):  # no bond, and none left
        with pytest.raises(InputError, match="expected to meet bonds, and some beyond"):
            opened(body, np.array([(wrong[0], 3.1), (wrong[1], 3.1)]))


@pytest.mark.slow
def test_a_small_sheet_holds_until_its_fold(tmp_path):
    body = cracked_sheet([np.array([(-3 * STEP, 0.0), (3 * STEP, 0.0)])], half=16.0)
    with CutSession(body, longer_cutoff(tmp_path)) as session:
        low, high = Pulled(body, session).critical_strain(0.05)
    assert 0.03 < low < high < 0.12
    assert high / low < 1.03
