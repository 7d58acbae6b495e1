"""Cracks that are asked for by their ends: which continuum speaks, and against atoms."""

import json

import numpy as np
import pytest

from examples.cracked_graphene import main
from examples.cracks.cohesive_zone import RowLaw
from tools.row_separation import Whole
from warp_peri import InputError

FITTED = {"24 bonds": {"strain": 0.03152}}
"""What the atoms of the fitted crack were measured at."""


def asked(capsys, folder, *words):
    (folder / "atoms.json").write_text(json.dumps(FITTED))
    status = main(["--json", "--out", str(folder), "--cracks", *words])
    return status, capsys.readouterr()


def test_ends_of_cracks_are_four_numbers_and_lie_in_the_sheet(tmp_path, capsys):
    with pytest.raises(InputError, match="expected x and y of both ends, got 3 numbers"):
        asked(capsys, tmp_path, "1", "2", "3")


def test_cracks_end_where_bonds_do_also_where_they_leave_atoms_bare():
    known = Whole(0.1, 0.7, RowLaw([0, 1, 2, 3], [0, 1, 0.5, 0]), None)
    row, bare = known.ends([[(-9, 0), (9, 0)], [(-9, 8), (9, 8)]], (24.0, 18.0))
    for ends, y in ((row, 0.0), (bare, 8.0)):
        assert np.allclose(ends[:, 1], y)
        assert np.abs(np.abs(ends[:, 0]) - 9).max() < 1.3  # half a step between upright bonds
    rim = known.rim((24.0, 18.0))
    assert 24 < rim[0] < 25.3
    assert 18 < rim[1] < 20.2


@pytest.mark.slow
def test_two_cracks_off_the_middle_line_are_those_of_the_atoms(tmp_path, capsys):
    words = ["-25", "8", "5", "8", "-5", "-8", "25", "-8", "--half", "60", "50", "--pull"]
    status, out = asked(capsys, tmp_path, *words)
    found = json.loads(out.out)
    assert status == 0
    assert found["by"] == "rows"
    assert abs(found["error"]) < 0.0091


@pytest.mark.slow
def test_a_crack_at_an_angle_is_that_of_the_atoms(tmp_path, capsys):
    words = ["-20", "-10", "10", "8", "--half", "50", "50", "--pull"]
    _, out = asked(capsys, tmp_path, *words)
    found = json.loads(out.out)
    assert found["by"] == "kinks"
    assert abs(found["error"]) < 0.0091


@pytest.mark.slow
def test_a_slight_slope_changes_little(tmp_path, capsys):
    """One way speaks of rows, the other of kinks."""
    strains = []
    for end in ("0", "0.001"):
        _, out = asked(capsys, tmp_path, *f"-16 0 16 {end} --half 40 60".split())
        strains.append(json.loads(out.out))
    assert [found["by"] for found in strains] == ["rows", "kinks"]
    assert strains[1]["predicted"] == pytest.approx(strains[0]["predicted"], rel=0.01)
