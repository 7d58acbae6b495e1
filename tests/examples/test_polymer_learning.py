"""The flow that asks for its own data, as a user runs it."""

import json

import pytest

from examples import polymer_learning


@pytest.mark.slow
def test_asking_makes_a_third_of_the_error(monkeypatch, tmp_path):
    monkeypatch.setattr(polymer_learning, "ROOT", tmp_path)
    polymer_learning.main(["--json"])
    folder = tmp_path / "runs" / "polymer_learning"
    numbers = json.loads((folder / "numbers.json").read_text())
    errors = numbers["error %"]
    assert numbers["asked (t, cell, gaps)"]
    assert errors["the same law again"] < 0.35 * errors["weak flows alone"]
    assert errors["the same law again"] < 0.4 * errors["FENE-P"]
    assert (folder / "velocity.png").stat().st_size > 10_000
