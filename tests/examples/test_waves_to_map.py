"""Maps from waves: the first steps of the example, as a user runs it."""

import json

import pytest

from examples import waves_to_map


@pytest.mark.slow
def test_maps_come_out_of_waves_at_the_rim(tmp_path, capsys):
    assert waves_to_map.main(["--json", "--iterations", "10", "--out", str(tmp_path)]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert numbers["shear"] < 0.06 < 0.13 < numbers["error at start"]
    assert numbers["error"] < 0.12
    assert numbers["misfit"] < 0.06
    assert numbers["seconds"] > 0
    assert (tmp_path / "waves_to_map.png").stat().st_size > 10_000
