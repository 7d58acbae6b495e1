"""Cracks along other directions of graphene: which edge is nearest, and where they run."""

import json

import numpy as np
import pytest

from examples.studies.crack_directions import Sheets, crack, kink, main
from tools.cracked_sheet import cracked_sheet, opened
from tools.graphene import bond_length

STEP = float(np.sqrt(3) * bond_length())


def test_zigzag_directions_come_every_sixty_degrees():
    assert [kink(angle) for angle in (0, 20, 30, 45, 60, 100, 120)] == [0, 20, 30, 15, 0, 20, 0]


@pytest.mark.parametrize("turned", [0.0, 19.10660535, 30.0])
def test_cracks_keep_away_from_atoms_and_the_sheet_is_turned(turned):
    ends = crack(turned, 8, STEP)
    body = cracked_sheet([ends], half=20.0, turned=turned)
    assert np.abs(body.positions[:, 1] - ends[0, 1]).min() > 0.2
    bonds = np.diff(body.positions[body.bonds], axis=1)[:, 0]
    angles = np.degrees(np.arctan2(bonds[:, 1], bonds[:, 0])) % 60
    expected = (90 - turned) % 60  # bonds stand across zigzag directions
    assert np.abs((angles - expected + 30) % 60 - 30).max() < 1e-6


@pytest.mark.parametrize(("turned", "bonds"), [(0.0, 8), (30.0, 10)])
def test_a_crack_is_as_long_as_the_bonds_that_it_cuts(turned, bonds):
    ends = crack(turned, 8, STEP)
    body = cracked_sheet([ends], half=24.0, turned=turned)
    assert body.cut.sum() == bonds
    between = STEP if turned == 0 else 1.5 * bond_length()
    assert opened(body, ends) == pytest.approx(bonds * between)


def test_a_stronger_sheet_has_a_shorter_zone_and_its_cracks_hold_longer():
    known = Sheets(1.0, (0.1, 0.12), STEP, {40: lambda half: half})
    assert known.strength(0.0) == known.strength(60.0) == pytest.approx(0.1)
    assert known.strength(30.0) == pytest.approx(0.12)
    assert known.zone(0.1, 0.0) == pytest.approx(0.1 / (2 * np.pi * 0.01) / STEP)
    strains = [known.critical(0.1, turned, 12.0, 40) for turned in (0.0, 15.0, 30.0)]
    assert strains[0] < strains[1] < strains[2] < np.sqrt(0.1 / 12)
    assert known.needed(strains[2], 30.0, 12.0) == pytest.approx(0.1)


@pytest.mark.slow
def test_an_armchair_crack_follows_from_a_zigzag_one(tmp_path, capsys):
    assert main(["--cases", "2", "--json", "--out", str(tmp_path)]) == 0
    zigzag, armchair = json.loads(capsys.readouterr().out)["cracks"].values()
    assert armchair["atoms"] > 1.05 * zigzag["atoms"]
    assert abs(armchair["error"]) < 0.0033
