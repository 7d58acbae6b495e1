"""The noise study and the main job on thermal data, small, as a user runs them."""

import functools
import json

import pytest

import tools.make_graphene as graphene
from examples import train_graphene
from examples.studies import noise_study
from tests.support.thermal import BATH, small_plans, small_sheet
from tools import make_thermal as tool
from warp_peri.learning.sweep import sweep
from warp_peri.points.dataset import load_dataset


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """What makes thermal data of the small bodies, whose runs are made once."""
    folder = tmp_path_factory.mktemp("thermal")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(graphene, "REACH", 70.0)
        make = functools.partial(
            tool.make_thermal, plans=small_plans(small_sheet()), cache=folder / "cache"
        )
        yield functools.partial(make, folder, bath=BATH, jobs=1, progress=False)


@pytest.mark.filterwarnings("ignore:λ . μ ended on the lower bound")  # these kernels are poor
@pytest.mark.filterwarnings("ignore:strain")
@pytest.mark.slow
def test_main_job_at_a_temperature(small, tmp_path, monkeypatch, capsys):
    asked = {}

    def made(out, **options):
        asked.update(options)
        return small(factors=[0.25], reductions=["plain"])

    monkeypatch.setattr(tool, "make_thermal", made)
    words = ["--temperature", "300", "--reduction", "plain", "--factor", "0.25", "--steps", "90000"]
    words += ["--horizon", "10", "--degree", "2", "--method", "optimum", "--out", str(tmp_path)]
    assert train_graphene.main(words) == 0
    assert asked["bath"].steps == 90000
    assert asked["factors"] == [0.25]
    assert asked["reductions"] == ["plain"]
    assert "loss: output (noise is" in capsys.readouterr().out
    numbers = json.loads((tmp_path / "metrics.json").read_text())
    assert numbers["loss"]["name"] == "output"
    assert numbers["temperature"] == 300
    text = (tmp_path / "report.md").read_text()
    assert "# Graphene at 300 K" in text


def test_steps_without_sense_are_refused(tmp_path, capsys):
    words = ["--temperature", "300", "--steps", "10", "--out", str(tmp_path)]
    assert train_graphene.main(words) == 2
    assert "steps: expected more than the transient" in capsys.readouterr().err


@pytest.mark.filterwarnings("ignore:λ . μ ended on the lower bound")  # these kernels are poor
@pytest.mark.filterwarnings("ignore:strain")
@pytest.mark.slow
def test_every_table_and_figure_is_made(small, tmp_path, monkeypatch):
    paths = small(factors=noise_study.FACTORS)
    few = functools.partial(sweep, horizons=(10.0,), degrees=(0, 1))
    monkeypatch.setattr(noise_study, "sweep", few)
    monkeypatch.setattr(noise_study, "HORIZON", 10.0)
    monkeypatch.setattr(noise_study, "DEGREE", 1)
    monkeypatch.setattr(noise_study, "FACTORS", (1.0, 0.1))
    monkeypatch.setattr(noise_study, "LOSSES", ("corrected", "output"))
    monkeypatch.setattr(noise_study, "make_thermal", lambda *_, **__: paths)
    monkeypatch.setattr(noise_study, "make_data", lambda *_: paths["shared", 1.0])
    out = tmp_path / "study"
    assert noise_study.main(["--out", str(out), "--jobs", "1"]) == 0
    content = json.loads((out / "noise.json").read_text())
    assert len(content["fits"]) == 12
    assert sum(row["default"] for row in content["fits"]) == 6
    assert all(row["certified"] and row["c"] > 0 for row in content["fits"])
    noisy = {(row["reduction"], row["factor"]): row for row in content["floors"]}
    assert noisy["plain", 0.1]["floor_val"] > 5 * noisy["plain", 1.0]["floor_val"]
    assert noisy["shared", 1.0]["floor_val"] < noisy["plain", 1.0]["floor_val"]
    text = (out / "noise.md").read_text()
    for heading in ("## Losses", "## Table 5", "## Table 3 at 300 K", "## Table 4 at 300 K"):
        assert heading in text
    for name in ("errors_by_degree.png", "kernels.png"):
        assert (out / name).stat().st_size > 5000


@pytest.mark.slow
def test_noise_fields_hold_no_load(small):
    for path in small(factors=[0.25], reductions=["plain"]).values():
        data = load_dataset(path)
        assert not data["noise"].b.any()
        assert not data["noise_test"].b.any()
