"""The longer examples: what they find, asserted. Run with -m slow."""

import functools
import json

import matplotlib.pyplot as plt
import numpy as np
import pytest

from examples import train_graphene
from examples.studies import influence_shapes, manufactured, speed_chart
from warp_peri.learning.sweep import sweep
from warp_peri.points.dataset import load_dataset


@pytest.mark.filterwarnings("ignore:λ . μ ended on the lower bound")  # these kernels are poor
@pytest.mark.slow
def test_sweep_from_the_command_line(graphene, tmp_path, monkeypatch, capsys):
    few = functools.partial(sweep, horizons=(10.0, 12.5), degrees=(0, 5))
    monkeypatch.setattr(train_graphene, "sweep", few)
    arguments = ["--sweep", "--data", str(graphene), "--out", str(tmp_path), "--jobs", "1"]
    assert train_graphene.main(arguments) == 0
    assert "Table 3" in capsys.readouterr().out
    sweep_record = json.loads((tmp_path / "sweep.json").read_text())
    assert len(sweep_record["trials"]) == 4
    assert sweep_record["printed_choice"]["horizon"] == 12.5
    assert sweep_record["printed_choice"]["E_u_test"] < 0.03
    for name in ("sweep.md", "sweep_errors.png", "sweep_kernels.png"):
        assert (tmp_path / name).stat().st_size > 500


def test_continuum_symbol_has_the_long_waves_of_elasticity():
    k = 1e-3 * np.array([0.6, 0.8])
    D = manufactured.continuum_symbol(k) / (k @ k)
    n = np.array([0.6, 0.8])
    expected = manufactured.MU * np.eye(2) + (manufactured.LAM + manufactured.MU) * np.outer(n, n)
    np.testing.assert_allclose(D, expected, rtol=0, atol=1e-5)


@pytest.mark.slow
def test_manufactured_loss_falls_with_degree_and_spacing(tmp_path):
    assert manufactured.main(["--out", str(tmp_path)]) == 0
    record = json.loads((tmp_path / "manufactured.json").read_text())
    residual = np.array(record["fixed_alpha"]["residual"])  # by spacing, by degree
    assert (residual[:, -1] < residual[:, 0]).all()
    assert (np.diff(residual, axis=0) < 0).all()  # finer is better at every degree
    assert record["fixed_alpha"]["kernel_order"] > 2
    assert np.all(np.diff(record["fixed_alpha"]["kernel_error"]) < 0)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:λ . μ ended on the lower bound")  # these kernels are poor
def test_three_numbers_of_a_wave_do_what_no_positive_shape_does(graphene, tmp_path):
    data = load_dataset(graphene)
    shapes = influence_shapes.fits(data["train"])
    rows = [influence_shapes.row(name, *fitted, data) for name, fitted in shapes.items()]
    disks = {fitted["shape"]: fitted["E_u test"] for fitted in rows}
    assert disks["damped wave"] < 1.2
    assert disks["table, 9 knots"] < 1.3
    assert min(disks[name] for name in ("gaussian", "exponential", "conical")) > 10
    assert {row["shape"]: round(row["E"], 2) for row in rows}["gaussian"] == 0.04
    influence_shapes.picture(shapes, rows, tmp_path / "shapes.png")
    assert (tmp_path / "shapes.png").stat().st_size > 10_000


def test_the_chart_of_speed_and_accuracy_reads_at_the_size_of_a_page(tmp_path, monkeypatch):
    kept = []
    monkeypatch.setattr(plt, "close", kept.append)
    rows = [
        {"kind": kind, "label": f"{kind}, {n}"}
        | {f"{name}_error": 10.0 ** -(n + k) for name in ("disks", "waves")}
        | {f"{name}_solve": 10.0 ** (n - k) for name in ("disks", "waves")}
        | {"disks_setup": 10.0, "hundred": 10.0 ** (2 + n - k)}
        for k, kind in enumerate(("learned", "FEM Q1"))
        for n in range(5)
    ]
    speed_chart.chart(rows, tmp_path / "chart.png")
    (figure,) = kept
    figure.canvas.draw()
    page = figure.bbox
    assert figure.get_figwidth() <= 8  # inches: the page scales nothing down
    texts = [text for ax in figure.axes for text in (*ax.texts, ax.title, ax.xaxis.label)]
    assert len(texts) > 15
    for text in texts:
        box = text.get_window_extent()
        assert text.get_size() >= 8
        assert page.x0 <= box.x0 <= box.x1 <= page.x1, text.get_text()
