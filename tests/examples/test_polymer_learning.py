"""The flow that asks for its own data, as a user runs it."""

import pytest

from examples import polymer_learning


@pytest.mark.slow
def test_asking_makes_a_third_of_the_error(monkeypatch, tmp_path):
    monkeypatch.setattr(polymer_learning, "ROOT", tmp_path)
    numbers = polymer_learning.main(["--json"])
    errors = numbers["error %"]
    assert numbers["asked (t, cell, gaps)"]
    assert errors["the same law again"] < 0.35 * errors["weak flows alone"]
    assert errors["the same law again"] < 0.5 * errors["FENE-P"]
    assert (tmp_path / "runs" / "polymer_learning" / "velocity.png").stat().st_size > 10_000
