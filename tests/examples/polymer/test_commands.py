"""The commands of the application, at small size."""

import json

from examples.polymer import asking, channel, learn, load, stress_histories


def test_learn_writes_a_law_and_holds_another_to_flows_it_did_not_see(tmp_path, capsys):
    small = ["--dumbbells", "100", "--pairs", "60", "--fene", "100", "--points", "30"]
    learn.main([*small, "--out", str(tmp_path), "--json"])
    rows = json.loads(capsys.readouterr().out)["fene"]
    learned, peterlin = rows["learned spring"], rows["FENE-P"]
    assert max(row["N1"] for row in learned.values()) < max(row["N1"] for row in peterlin.values())
    assert load(tmp_path / "law.json").provenance == {"dumbbells": 100, "seed": 0}
    assert (tmp_path / "table.md").read_text().startswith("| FENE")


def test_channel_holds_a_learned_law_to_the_exact_one(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(channel, "RECORDS", 5)
    monkeypatch.setattr(channel, "UNTIL", 0.003)
    channel.main(
        ["--dumbbells", "300", "--pairs", "60", "--draws", "2", "--out", str(tmp_path), "--json"]
    )
    rows = json.loads(capsys.readouterr().out)["channel"]
    assert rows["exact law"]["against the exact flow"] < 5
    assert rows["learned law"]["against the exact law in the same scheme"] < 5
    assert rows["learned law"]["2 sd of the band at the centre"] > 0
    assert (tmp_path / "channel.png").stat().st_size > 10_000


def test_a_law_of_stress_histories_alone(tmp_path, capsys):
    stress_histories.main(["--out", str(tmp_path), "--most", "60", "--json"])
    errors = json.loads(capsys.readouterr().out)["error %"]
    assert max(errors["learned"]) < 40
    assert (tmp_path / "stress.png").stat().st_size > 10_000


def test_a_flow_asks_for_data_where_it_has_none(tmp_path, capsys):
    asking.main(["--dumbbells", "200", "--reference", "100", "--out", str(tmp_path), "--json"])
    numbers = json.loads(capsys.readouterr().out)
    assert numbers["asked (t, cell, gaps)"]
    errors = numbers["error %"]
    assert errors["the same law again"] < errors["weak flows alone"]
