"""The example of a crack that branches, coarse and short."""

import json

from examples.branching import main


def test_a_short_run_prints_and_draws(tmp_path, capsys):
    command = ["--spacing", "1e-3", "--ratio", "3", "--time", "4e-6"]
    assert main([*command, "--out", str(tmp_path), "--series"]) == 0
    assert json.loads(capsys.readouterr().out)["nodes"] == 4000
    assert (tmp_path / "damage.png").stat().st_size > 5000
    assert (tmp_path / "series" / "motion.xdmf").exists()
