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
