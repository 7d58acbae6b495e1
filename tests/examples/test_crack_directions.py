"""Cracks along other directions of graphene: which edge is nearest, and where they run."""

import json

import numpy as np
import pytest

from examples.studies.crack_directions import crack, kink, main
from tools.cracked_sheet import cracked_sheet
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


@pytest.mark.slow
def test_an_armchair_crack_follows_from_a_zigzag_one(tmp_path, capsys):
    assert main(["--cases", "2", "--json", "--out", str(tmp_path)]) == 0
    zigzag, armchair = json.loads(capsys.readouterr().out).values()
    assert armchair["atoms"] > 1.05 * zigzag["atoms"]
    assert abs(armchair["error"]) < 0.02
