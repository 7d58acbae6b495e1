"""Groups of cracks: rows and steps are the sheet's own, and one of them against its atoms."""

import json

import numpy as np
import pytest

from examples.studies.crack_groups import CASES, FITTED, ends, main
from tools.cracked_sheet import cracked_sheet
from tools.graphene import bond_length
from tools.row_separation import row_law


@pytest.mark.parametrize("case", list(CASES))
def test_cases_cut_one_bond_a_step_between_rows_of_atoms(case):
    cracks, half, _ = CASES[case]
    body = cracked_sheet(ends(case), half=half)
    assert body.cut.sum() == sum(last - first for first, last, _ in cracks)
    assert np.abs(body.positions).max() < max(half) + 7


def test_a_row_holds_to_the_length_of_a_broken_bond():
    law = row_law()
    assert law.traction[0] == 0
    assert 1.14 < law.separation[-1] < 1.2  # a bond of 1.46 Å that becomes 2.6 long
    assert law.traction.max() == pytest.approx(0.0955, rel=0.02)  # the sheet's own strength
    assert bond_length() == pytest.approx(1.4605, abs=1e-3)


@pytest.mark.slow
def test_cracks_near_rims_and_above_each_other_follow_from_one_in_a_large_sheet(tmp_path, capsys):
    assert main(["--cases", "4", "14", "17", "--json", "--out", str(tmp_path)]) == 0
    table = json.loads(capsys.readouterr().out)["cracks"]
    assert len(table) == 4
    for case, row in table.items():
        assert case == FITTED or abs(row["error"]) < 0.018
