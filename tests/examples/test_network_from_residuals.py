"""A network trained with residuals: a short run of the example, as a user runs it."""

import json

import pytest

from examples import network_from_residuals


@pytest.mark.slow
def test_residuals_teach_a_law_that_is_solved_with(tmp_path, capsys):
    asked = ["--json", "--steps", "100", "--last", "3", "--out", str(tmp_path)]
    assert network_from_residuals.main(asked) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert numbers["E_res"] < 0.06 < 1 < numbers["E_res at start"]
    assert numbers["E_u"] < 0.04
    assert (tmp_path / "network_from_residuals.png").stat().st_size > 10_000
