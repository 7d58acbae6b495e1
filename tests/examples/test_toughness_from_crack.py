"""Toughness from a crack: the first steps of the example, as a user runs it."""

import json

import pytest

from examples import toughness_from_crack


@pytest.mark.slow
def test_strength_and_toughness_come_out_of_a_force(tmp_path, capsys):
    told = toughness_from_crack.main(["--json", "--iterations", "5", "--out", str(tmp_path)])
    assert told == 0
    numbers = json.loads(capsys.readouterr().out)
    assert numbers["error of stretch"] < 0.1
    assert abs(numbers["stretch, start"] / numbers["stretch, true"] - 1) > 0.29
    assert numbers["gradients"] <= 20
    assert numbers["seconds"] > 0
    assert (tmp_path / "toughness_from_crack.png").stat().st_size > 10_000
