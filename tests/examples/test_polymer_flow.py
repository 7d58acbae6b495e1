"""The polymer example, as a user runs it."""

import json

import numpy as np
import pytest

from examples import polymer_flow, stress_histories


@pytest.mark.slow
def test_the_default_reaches_its_figures(monkeypatch, tmp_path):
    monkeypatch.setattr(polymer_flow, "ROOT", tmp_path)
    polymer_flow.main([])
    numbers = json.loads((tmp_path / "runs" / "polymer_flow" / "numbers.json").read_text())
    errors = {
        name: row["against the exact law in the same scheme"]
        for name, row in numbers["channel"].items()
    }
    assert errors["learned law"] < 1.8
    assert errors["coupled, 1000 dumbbells"] < 4.6
    assert numbers["channel"]["exact law"]["against the exact flow"] < 2.75
    learned, peterlin = numbers["fene"]["learned spring, second memory"], numbers["fene"]["FENE-P"]
    for name, row in learned.items():
        assert row["N1"] < 6.1
        assert row["s_xy"] is None or row["s_xy"] < 6.1
        assert row["N1"] < 0.5 * peterlin[name]["N1"]
    files = {path.name for path in (tmp_path / "runs" / "polymer_flow").iterdir()}
    assert {"channel.png", "law.json", "numbers.json", "table.md"} <= files


@pytest.mark.slow
def test_a_law_of_stress_histories_alone(tmp_path, capsys):
    stress_histories.main(["--out", str(tmp_path), "--json"])
    errors = json.loads(capsys.readouterr().out)["error %"]
    assert max(errors["learned"]) < 12
    assert np.mean(errors["learned"]) < 0.8 * np.mean(errors["FENE-P"])
    assert (tmp_path / "stress.png").stat().st_size > 10_000
