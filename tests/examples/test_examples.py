"""The examples and the command line, run as a user runs them, on data made by LAMMPS."""

import io
import json
import re
import runpy
import shutil
import sys
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest

from examples import train_graphene
from warp_peri import load
from warp_peri.cli.main import main as command
from warp_peri.materials.lps import Model
from warp_peri.points.dataset import load_dataset

ROOT = Path(__file__).parent.parent.parent
RESULTS = ("model.json", "metrics.json", "report.md", "influence.png", "loss.png", "disks.png",
           "waves.png")  # fmt: skip


@pytest.fixture(scope="module")
def main_run(graphene, tmp_path_factory):
    """The main job, as it stands in docs/record/graphene.json."""
    out = tmp_path_factory.mktemp("runs") / "graphene_0K"
    with redirect_stdout(io.StringIO()) as printed:
        assert train_graphene.main(["--data", str(graphene), "--out", str(out)]) == 0
    (out / "printed.txt").write_text(printed.getvalue())
    return out


def test_main_job_leaves_its_results(main_run):
    assert all((main_run / name).stat().st_size > 500 for name in RESULTS)
    numbers = json.loads((main_run / "metrics.json").read_text())
    assert set(numbers["E_res"]) == set(numbers["E_u"]) == {"train", "val", "test"}
    assert set(numbers["moduli"]) == {"C11", "C12", "C44"}
    assert set(numbers["truth"]) == {"lambda", "mu", "E", "nu"}
    assert set(numbers["certificate"]) == {
        "symbol_min", "symbol_bound", "gamma_min", "inf_sup_min", "gamma_minus_2phi_min",
    }  # fmt: skip
    assert [stage["name"] for stage in numbers["stages"]] == ["1 Adam", "3 constrained"]
    moduli = [numbers["moduli"][name] for name in ("C12", "C44")]
    assert numbers["held"] == pytest.approx([numbers["lambda"], numbers["mu"]], rel=1e-9)
    assert numbers["held"] == pytest.approx(moduli, rel=1e-6)
    assert numbers["augmented_lagrangian"]["loss_over_optimum"] <= 1.001
    assert np.ptp(list(numbers["starts"].values())) < 1e-6
    assert {"data", "learning", "all"} <= set(numbers["seconds"])
    for form, row in numbers["third_order"].items():
        model = load(main_run / f"third_order_{form}.json")
        assert row["constants"] == {name: getattr(model, name) for name in ("t3", "tq2", "q3")}
        assert (row["bonds"], model.form) == (28, form)
        assert row["E_u"]["test"] < 0.2 * numbers["E_u"]["test"]
    assert numbers["micromodulus"]["bonds"] == 20
    assert numbers["micromodulus"]["E_u"]["test"] < numbers["E_u"]["test"]
    assert (main_run / "micromodulus.json").exists()


def test_main_job_says_what_there_is_how_good_and_what_next(main_run):
    """In the terminal and in the report; details lie below a line, eigenvalues in metrics.json."""
    numbers = json.loads((main_run / "metrics.json").read_text())
    error = f"{100 * numbers['E_u']['test']:.2f} %"
    samples = [100 * sample for sample in numbers["E_u_samples"]["test"]]
    good = f"4 free disks that the fit never saw the displacement has an error of {error}"
    spread = f"({min(samples):.1f} to {max(samples):.1f} %)"
    lines = (main_run / "printed.txt").read_text().splitlines()
    assert len(lines) == 6
    assert lines[0] == f"graphene at 0 K: {main_run}/model.json"
    assert f"{good} {spread}" in lines[1]
    assert lines[2].startswith("Proven: ")
    assert f"Young's modulus {1e3 * numbers['E']:.0f} GPa" in lines[3]
    assert lines[5].startswith("next: ")
    text = (main_run / "report.md").read_text()
    above, below = text.split("\n----\n")
    assert f"{good} {spread}" in above
    assert "## Next" in above
    assert "third-order model, 28 bonds, with energy" in above
    assert "Λmin" not in text
    assert numbers["statement"] in below
    cells = re.search(r"\| linear peridynamic solid \(LPS\) \|(.*)\|", below)[1].split("|")
    order = [("E_res", "train"), ("E_res", "val"), *(("E_u", r) for r in ("train", "val", "test"))]
    assert [float(c) for c in cells] == pytest.approx(
        [100 * numbers[error][role] for error, role in order], abs=0.0051
    )


def of_the_readme(name):
    """What the README prints on the sheet and the disk, in %."""
    row = re.search(rf"\| {re.escape(name)} \|(.*)\|", (ROOT / "README.md").read_text("utf-8"))[1]
    return [float(cell.strip(" *%")) for cell in row.split("|")]


def test_defaults_reach_the_figures_of_the_pages(main_run):
    numbers = json.loads((main_run / "metrics.json").read_text())
    percent = {key: {role: 100 * e for role, e in numbers[key].items()} for key in ("E_res", "E_u")}
    assert percent["E_res"]["train"] <= 2.9
    assert percent["E_res"]["val"] <= 2.0
    assert percent["E_u"]["train"] <= 1.8
    assert percent["E_u"]["val"] <= 0.8
    assert percent["E_u"]["test"] <= 1.2
    assert numbers["mu"] == pytest.approx(numbers["truth"]["mu"], rel=0.01)
    assert numbers["E"] == pytest.approx(numbers["truth"]["E"], rel=0.025)
    assert numbers["certificate"]["symbol_bound"] >= 0.36
    assert min(numbers["conditions"].values()) > 0  # (i) to (iii) of (4.6), by dense eigenvalues
    for local in numbers["local"].values():  # never worse than a solid without a horizon
        assert all(numbers["E_u"][role] <= local[role] for role in local)
    record = json.loads((ROOT / "docs" / "record" / "graphene.json").read_text(encoding="utf-8"))
    rows_of = {name: cells for name, *cells in record["rows"]}
    columns = [("E_res", r) for r in ("train", "val")]
    columns += [("E_u", r) for r in ("train", "val", "test")]
    recorded = {"this library": numbers, "crystal model, 20 bonds": numbers["micromodulus"]}
    third = {"with energy": ("energy", 0.055), "deconvolved": ("filtered", 0.035)}
    for said, (form, strain) in third.items():
        beside = numbers["third_order"][form]
        assert 100 * beside["E_u"]["test"] <= 0.1
        assert 100 * beside["E_u"]["val"] <= 0.13
        assert beside["proven_strain"] >= strain
        recorded[f"third-order model, 28 bonds, {said}"] = beside
    for name, found in recorded.items():
        measured = [100 * found[error][role] for error, role in columns]
        assert rows_of[name] == pytest.approx(measured, abs=0.02), name
    for name, errors in (
        ("linear peridynamic solid (LPS)", numbers["E_u"]),
        ("crystal model, a stiffness matrix for each bond", numbers["micromodulus"]["E_u"]),
        ("third order on a crystal, with energy", numbers["third_order"]["energy"]["E_u"]),
        ("third order on a crystal, deconvolved", numbers["third_order"]["filtered"]["E_u"]),
        ("local elasticity, constants exact or learned", numbers["local"]["true"]),
        ("local elasticity, constants exact or learned", numbers["local"]["learned"]),
    ):
        measured = [100 * errors[r] for r in ("val", "test")]
        assert of_the_readme(name) == pytest.approx(measured, abs=0.02), name
    for name, local in (("true moduli", "true"), ("moduli as learned", "learned")):
        measured = [100 * numbers["local"][local][r] for r in ("train", "val", "test")]
        assert rows_of[f"local elasticity, {name}"][2:] == pytest.approx(measured, abs=0.02), name
    table = json.loads((ROOT / "docs" / "record" / "speed_accuracy.json").read_text())
    (shipped,) = (row for row in table["rows"] if "local elasticity, true" in row["label"])
    measured = [numbers["local"]["true"][r] for r in ("val", "test")]
    assert [shipped["smooth_error"], shipped["disks_error"]] == pytest.approx(measured, rel=1e-6)


def test_evaluate_prints_one_object_with_every_set(main_run, graphene, capsys):
    model = str(main_run / "model.json")
    assert command(["evaluate", model, str(graphene), "--json"]) == 0
    tables = json.loads(capsys.readouterr().out)
    assert set(tables) == set(load_dataset(graphene))
    assert tables["test_fine"]["transferred_from"] == 5.0
    assert "transferred_from" not in tables["test"]
    # the same atoms under the same loads, on nodes that the model was not trained on
    for name in ("test", "val", "train"):
        assert tables[f"{name}_fine"]["E_u"] <= tables[name]["E_u"] + 0.001
    table = tables["test"]
    assert table["E_u"] == pytest.approx(np.mean(table["E_u_samples"]))
    main_job = json.loads((main_run / "metrics.json").read_text())
    assert table["E_u"] == pytest.approx(main_job["E_u"]["test"])
    assert table["E_res_abs"] == pytest.approx(np.mean(table["E_res_abs_samples"]))


def test_evaluate_names_a_set_that_is_not_there(main_run, graphene, capsys):
    assert command(["evaluate", str(main_run / "model.json"), str(graphene), "--set", "no"]) == 2
    assert "no set 'no'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--horizon", "30"], "twice the horizon: 152 of 441 have not at horizon 30 Å"),
        (["--horizon", "4"], "horizon: expected at least one spacing (5.0), got 4.0"),
        (["--degree", "-1"], "degree: expected a whole number ≥ 0, got -1"),
        (["--spacing", "3"], "no training set on nodes 3 Å apart"),
        (["--data", "nowhere.h5"], "nowhere.h5: no such file"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(arguments, words, graphene, tmp_path, capsys):
    out = tmp_path / "out"
    given = ["--data", str(graphene), "--out", str(out), *arguments]
    assert train_graphene.main(given) == 2
    err = capsys.readouterr().err
    assert words in err
    assert len([line for line in err.splitlines() if line.startswith("error")]) == 1
    assert not out.exists()


def test_interrupt_while_learning_leaves_no_file(graphene, tmp_path, monkeypatch, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(train_graphene, "train", interrupted)
    out = tmp_path / "out"
    assert train_graphene.main(["--data", str(graphene), "--out", str(out)]) == 130
    assert "interrupted" in capsys.readouterr().err
    assert not out.exists()


def test_failed_data_is_one_line(tmp_path, monkeypatch, capsys):
    from tools import make_graphene

    def fails(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(train_graphene, "DATA", tmp_path / "data.h5")
    monkeypatch.setattr(make_graphene, "solve_all", fails)
    assert train_graphene.main(["--out", str(tmp_path / "out")]) == 1
    assert "No space left" in capsys.readouterr().err
    assert not (tmp_path / "data.h5").exists()
    assert not (tmp_path / "out").exists()


def test_readme_snippet_runs(graphene, tmp_path, monkeypatch, capsys):
    snippet = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)[1]
    (tmp_path / "data").mkdir()
    shutil.copy(graphene, tmp_path / "data" / "graphene_0K.h5")
    monkeypatch.chdir(tmp_path)
    exec(snippet, {})
    error, statement = capsys.readouterr().out.split(maxsplit=1)
    printed = re.search(r"This fit errs by (\S+) %", (ROOT / "README.md").read_text())[1]
    assert f"{100 * float(error):.2f}" == printed
    assert statement.startswith("Every static problem on any finite set of nodes")
    assert Model.load("model.json").certified_on == (5.0,)


def test_bad_input_of_an_example_is_one_line_and_status_2(tmp_path, monkeypatch, capsys):
    script = str(ROOT / "examples" / "plate_with_hole.py")
    missing = ["--model", str(tmp_path / "model.json"), "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", [script, *missing])
    with pytest.raises(SystemExit, match="2"):
        runpy.run_path(script, run_name="__main__")
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert said.count("\n") == 1
