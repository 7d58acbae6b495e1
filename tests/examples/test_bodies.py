"""Plates with holes: the example against the exact plate, and against atoms."""

import json

import pytest

from examples import crystal_body, hole_against_atoms, plate_with_hole
from warp_peri import Bernstein, Model
from warp_peri.learning.fit import learn as fit
from warp_peri.points.dataset_file import load_dataset


def test_the_plate_with_a_hole(tmp_path, capsys):
    model = Model(
        lam=0.3, mu=0.8, alpha=1.0, D=[0.4, 0.6, -0.3, 0.6, -0.2], horizon=3.0, certified_on=(1.0,)
    )
    model.save(tmp_path / "model.json")
    given = ["--model", tmp_path / "model.json", "--out", tmp_path, "--spacing", 1, "--horizon", 3]
    given += ["--radius", 8, "--half", 32, "--size", 0.6, "--json"]
    assert plate_with_hole.main([*map(str, given)]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert numbers["u_error"] < 5e-4
    assert numbers["hoop_stress_error"] < 0.01
    assert numbers["exchanges"] <= 12
    assert (tmp_path / "stress.png").stat().st_size > 10_000


@pytest.mark.slow
def test_holes_and_strips_of_atoms(graphene, tmp_path, capsys):
    data = load_dataset(graphene)
    fit(data["train"], 20.0, Bernstein(10)).material.save(tmp_path / "model.json")
    given = ["--model", tmp_path / "model.json", "--cache", tmp_path / "atoms", "--out", tmp_path]
    assert hole_against_atoms.main([*map(str, given), "--json"]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert numbers["largest_error"] <= 0.0168
    holes = [row for name, row in numbers["cases"].items() if "hole" in name]
    assert all(row["error_with_edge"] < row["error"] for row in holes)
    assert (tmp_path / "errors.png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_block_of_copper_with_a_void(tmp_path, capsys):
    assert crystal_body.main(["--out", str(tmp_path / "stress.png"), "--json"]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert numbers["exchanges"] <= 9
    assert numbers["mismatch"] <= 1e-8
    assert numbers["peak_over_tension"] == pytest.approx(1.98, rel=0.02)
    assert (tmp_path / "stress.png").stat().st_size > 10_000
