"""The example of a crack that branches, coarse and short."""

import json

import pytest

from examples.branching import main


def test_a_short_run_prints_and_draws(tmp_path, capsys):
    command = ["--spacing", "1e-3", "--ratio", "3", "--time", "4e-6"]
    assert main([*command, "--out", str(tmp_path), "--series"]) == 0
    assert json.loads(capsys.readouterr().out)["nodes"] == 4000
    assert (tmp_path / "damage.png").stat().st_size > 5000
    assert (tmp_path / "series" / "motion.xdmf").exists()


@pytest.mark.slow
def test_the_glass_plate_branches_and_its_ledger_closes_better_with_shorter_steps(tmp_path, capsys):
    runs = []
    for share in ("0.4", "0.2"):
        assert main(["--share", share, "--out", str(tmp_path)]) == 0
        runs.append(json.loads(capsys.readouterr().out))
    assert 0.013 < runs[0]["branch"] < 0.022  # 63 to 72 mm from the left
    assert 0.5 < runs[0]["speed_over_rayleigh"] < 0.62
    assert runs[0]["ledger"] < 6.5e-4
    assert runs[1]["ledger"] < runs[0]["ledger"] / 3
