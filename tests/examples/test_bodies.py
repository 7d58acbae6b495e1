"""A plate with a hole: the example against the exact plate."""

import json

from examples import plate_with_hole
from warp_peri import Model


def test_the_plate_with_a_hole(tmp_path, capsys):
    D = [0.4, 0.6, -0.3, 0.6, -0.2]
    model = Model(lam=0.3, mu=0.8, alpha=1.0, D=D, horizon=3.0, certified_on=(1.0,))
    model.save(tmp_path / "model.json")
    given = ["--model", tmp_path / "model.json", "--out", tmp_path, "--spacing", 1, "--horizon", 3]
    given += ["--radius", 8, "--half", 32, "--size", 0.6]
    assert plate_with_hole.main([*map(str, given)]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert numbers["u_error"] < 5e-4
    assert numbers["hoop_stress_error"] < 0.01
    assert (tmp_path / "stress.png").stat().st_size > 10_000
