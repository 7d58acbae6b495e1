"""The main job and the README's lines, run as a user runs them, on data made by LAMMPS."""

import io
import re
import shutil
from contextlib import redirect_stdout
from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose

from examples import train_graphene
from examples.graphene_report import COLUMNS, RECORD
from tests.support import ROOT, approx, near, of_json, shared
from warp_peri import load, save

README = (ROOT / "README.md").read_text("utf-8")
IN_README = {
    "linear peridynamic solid (LPS)": "linear peridynamic solid (LPS)",
    "crystal model, a stiffness matrix for each bond": "crystal model, 20 bonds",
    "third order on a crystal, with energy": "third-order model, 28 bonds, with energy",
    "third order on a crystal, deconvolved": "third-order model, 28 bonds, deconvolved",
    "local elasticity, constants exact or learned": "local elasticity, exact constants",
}


@shared
def job(graphene, tmp_path_factory):
    """Folder, what is printed, and numbers of the main job."""
    out = tmp_path_factory.mktemp("runs") / "graphene_0K"
    save(data := out.with_name("nm.h5"), load(graphene, units=("nm", "GPa")))
    with redirect_stdout(io.StringIO()) as printed:
        assert train_graphene.main(["--data", str(data), "--out", str(out)]) == 0
    return out, printed.getvalue(), of_json(out / "metrics.json")


def test_it_leaves_its_results_and_says_how_good_they_are(job, graphene, capsys):
    out, printed, numbers = job
    pictures = [f"{name}.png" for name in ("influence", "loss", "disks", "waves")]
    assert all((out / name).stat().st_size > 500 for name in ("model.json", "report.md", *pictures))
    assert numbers["held"] == approx([numbers["lambda"], numbers["mu"]], rel=1e-9)
    assert numbers["augmented_lagrangian"]["loss_over_optimum"] <= 1.001
    assert numbers["degree"] == max(map(int, numbers["degrees"])) == 8  # of nine bond lengths
    assert numbers["degrees"]["7"] > 1.1 * numbers["degrees"]["8"]
    assert np.ptp(list(numbers["starts"].values())) < 1e-6
    error = f"displacement has an error of {100 * numbers['E_u']['test']:.2f} %"
    above, below = (out / "report.md").read_text().split("\n----\n")
    assert all(error in text for text in (printed, above))
    assert numbers["statement"] in below
    near(numbers["mu"], numbers["truth"]["mu"], 0.01)
    near(numbers["E"], numbers["truth"]["E"], 0.025)
    assert numbers["certificate"]["symbol_bound"] >= 0.36
    _, _, *conditions = numbers["certificate"].values()
    assert min(conditions) > 0  # (i) to (iii) of (4.6), by dense eigenvalues
    for form, strain in (("energy", 0.055), ("filtered", 0.035)):
        assert load(out / f"third_order_{form}.json").proven_strain(5.0) >= strain
    assert train_graphene.main(["--data", str(graphene), "--out", str(out), "--linear"]) == 2
    assert "not by these settings" in capsys.readouterr().err
    data, other = load(graphene), out / "other.h5"
    for said, words in ("bond_length", "expected graphene"), ("smoothing", "names the radius"):
        save(other, replace(data, provenance=data.provenance | {said: 0}))
        assert train_graphene.main(["--data", str(other), "--out", str(out / "new")]) == 2
        assert words in capsys.readouterr().err


def test_models_have_the_errors_of_the_record_and_of_the_readme(job):
    models, rows = job[-1]["models"], of_json(RECORD)["rows"]
    for name, *cells in rows[: len(models)]:
        found = [100 * models[name].get(key, {}).get(role, np.nan) for key, role in COLUMNS]
        told = np.array(cells, float)  # null where there is none
        assert_allclose(found, told, atol=0.02, err_msg=name)
    for row, name in IN_README.items():
        cells = re.search(rf"\| {re.escape(row)} \|(.*)\|", README)[1].split("|")
        found = [100 * models[name]["E_u"][role] for role in ("val", "test")]
        assert [float(cell.strip(" *%")) for cell in cells] == approx(found, abs=0.02)


def test_the_lines_of_the_readme_run(graphene, here, capsys):
    (here / "data").mkdir()
    shutil.copy(graphene, here / "data" / "graphene_0K.h5")
    exec(re.search(r"```python\n(.*?)```", README, re.DOTALL)[1], {})
    error, statement = capsys.readouterr().out.split(maxsplit=1)
    assert f"{100 * float(error):.2f}" == re.search(r"This fit errs by (\S+) %", README)[1]
    assert statement.startswith("Every static problem on any finite set of nodes")
    assert load("model.json").certified_on == (5.0,)
