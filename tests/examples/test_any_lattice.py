"""The tables of any_lattice.py against what is promised of them."""

import json

import pytest

from examples import any_lattice
from warp_peri import Bernstein
from warp_peri.files.atomic import write_json
from warp_peri.learning.fit import learn as fit
from warp_peri.points.dataset import load_dataset


def test_parts_are_measured_once(tmp_path):
    calls = []
    for _ in range(2):
        measured = any_lattice.kept_part(tmp_path, "a part", lambda: calls.append(1) or {"E": 0.5})
        assert measured == {"E": 0.5}
    assert len(calls) == 1
    write_json(tmp_path / "a_part.json", {"E": 0.25})
    assert any_lattice.kept_part(tmp_path, "a part", None) == {"E": 0.25}


def test_every_kind_of_nodes():
    points = any_lattice.lattice(5.0)
    assert (len(points.x), points.interior.sum()) == (1681, 441)
    turned = any_lattice.lattice(5.0, 30.0)
    assert turned.interior.sum() == pytest.approx(441, rel=0.1)
    for cloud in any_lattice.clouds().values():
        assert len(cloud.x) == 1681
        assert cloud.spacing == 0


@pytest.mark.slow
def test_the_tables(graphene, tmp_path):
    data = load_dataset(graphene)
    fit(data["train"], 20.0, Bernstein(10)).material.save(tmp_path / "model.json")
    given = ["--model", tmp_path / "model.json", "--data", graphene, "--out", tmp_path / "out"]
    assert any_lattice.main([*map(str, given), "--json"]) == 0
    tables = json.loads((tmp_path / "out" / "any_lattice.json").read_text())
    home = tables["home"]
    for row in tables["lattices"]:
        assert row["c"] >= 0.0099
        if row["spacing"] in (4.0, 2.5):
            assert row["disks"] <= home["disks"] + 0.1
    smooth = {row["spacing"]: row["smooth"] for row in tables["lattices"]}
    assert smooth[7.5] <= 0.8
    assert smooth[10.0] <= 2.2
    assert max(row["disks"] for row in tables["turned_4"]) <= home["disks"] + 0.1
    assert tables["reduced"][0]["disks"] <= 0.7
    assert tables["reduced"][0]["smooth"] <= 0.8
    for row in tables["scattered"]:
        assert row["asymmetry"] <= 1e-12
        assert row["smallest_eigenvalue"] > 0
        assert row["smooth_b_on_lattice"] <= 0.65
        assert row["smooth_b_on_nodes"] <= 0.65
        assert row["short_b_on_lattice"] <= 2.1
        assert row["short_b_on_nodes"] <= 3.38
    learned = [row["learned_disks"] for row in tables["scattered"]]
    assert all(error <= most for error, most in zip(learned, (1.3, 1.7, 1.4)))
    for name in ("one_kernel", "one_kernel_rich"):
        assert sum(tables[name]["symbol"]) / 10 <= 4.0
    assert max(tables["one_kernel"]["disks"].values()) <= home["disks"] + 0.1
    assert max(tables["one_kernel_rich"]["disks"].values()) <= 0.88
