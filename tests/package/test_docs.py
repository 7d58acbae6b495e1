"""The snippets of the pages run as they are printed."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.support.problems import lattice, manufactured
from warp_peri.cli.main import main
from warp_peri.models.lps import load_model
from warp_peri.models.shapes import InfluenceFunction, exponential
from warp_peri.points.dataset_file import load_dataset

DOCS = Path(__file__).parent.parent.parent / "docs"
HORIZON = 12.5


def snippets(page):
    return re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), re.DOTALL)


@pytest.fixture(scope="module")
def points():
    """Fields in equilibrium with a known solid on a lattice of 5 Å."""
    shape = InfluenceFunction(exponential, {"length": 9.0})
    model = shape.model(lam=0.2, mu=0.3, horizon=20.0, spacings=[5.0])
    with pytest.warns(UserWarning, match="certified on no spacing"):
        return manufactured(
            model, lattice(13, 20.0, 5.0), 4, wave_number=0.2, allow_uncertified=True
        )


def test_csv_files_of_fields_become_a_data_set_that_trains(points, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fields").mkdir()
    for s in range(len(points)):
        rows = np.hstack([points.x, points.u[s], points.b[s]])
        name = tmp_path / "fields" / f"load{s}.csv"
        np.savetxt(name, rows, delimiter=",", header="x,y,u_x,u_y,b_x,b_y", comments="")
    (snippet,) = snippets("own_data.md")
    exec(compile(snippet, "own_data.md", "exec"), {})
    loaded = load_dataset("mine.h5")["train"]
    assert loaded.interior.sum() == 13**2
    np.testing.assert_allclose(loaded.u, points.u, rtol=1e-12)
    line = "train mine.h5 --horizon 20 --influence exponential --out runs/mine --json"
    assert main(line.split()) == 0
    model = load_model("runs/mine/model.json")
    assert (model.lam, model.mu) == pytest.approx((0.2, 0.3), rel=1e-5)
    assert model.provenance["influence"]["parameters"]["length"] == pytest.approx(9.0, rel=1e-5)


def test_the_page_on_influence_functions(points, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = {"train": points}
    for snippet in snippets("influence.md"):
        exec(compile(snippet, "influence.md", "exec"), names)
    assert "Every static problem" in capsys.readouterr().out
    assert load_model("model.json").certified_on == (5.0,)
    assert names["certificate"].holds
