"""The examples on sheets: whole runs print their numbers; the printed rivals' parts."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("skfem")


from examples.leaflet import arguments, blank, draw, measured
from examples.studies.leaflet_rivals import RIVALS, Window, fit, interpolated_errors
from tests.support.sheets import hgo_dictionary, square
from tools.hyperelastic_energies import plane_stress_hgo
from warp_peri.materials.hyperelastic.energies import HyperelasticSolid
from warp_peri.points.samples import Samples

ROOT = Path(__file__).parent.parent.parent


def run(script, *arguments):
    command = [sys.executable, str(ROOT / "examples" / script), "--json", *map(str, arguments)]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


@pytest.mark.slow
def test_a_sheet_is_learned_and_read(tmp_path):
    report = run(
        "hgo_square.py", "--element", "quadratic", "--data", tmp_path / "data", "--out", tmp_path
    )["quadratic"]
    for name, limit in (("free signs", 0.0105), ("guaranteed", 0.015), ("read out", 0.016)):
        assert max(report[name][key]["E_res"] for key in ("train", "val", "test")) < limit
    assert report["guaranteed"]["disks"]["not_solved"] == 0
    assert report["guaranteed"]["disks"]["left_branch"] == 0
    assert report["guaranteed"]["disks"]["E_u"] < 0.0009
    (fibre,) = (word for word in report["read out"]["material"] if word.startswith("fibre"))
    assert fibre.startswith("fibre_exponential at 90.0°")
    assert report["read out"]["material"]["neo_hookean"] == pytest.approx(0.0713, rel=0.02)


@pytest.mark.slow
def test_a_leaflet_is_learned_from_displacement(tmp_path):
    report = run("leaflet.py", "--data", tmp_path / "data", "--out", tmp_path)
    assert report["families"]["held out"] < 0.00156
    assert report["families"]["held out"] < report["rivals"]["Fung"]["held out"] / 20
    assert (tmp_path / "rose.png").exists()


@pytest.mark.slow
def test_an_uneven_leaflet_is_told_from_its_material(tmp_path):
    report = run(
        "leaflet.py", "--uneven", "0.3", "--rivals", "neo-Hookean", "--data", tmp_path / "data",
        "--out", tmp_path,
    )  # fmt: skip
    assert report["families, uneven"]["held out"] < report["families"]["held out"] / 5.3
    assert report["families, uneven"]["held out"] < 0.0034
    fibres = [word for word in report["families, uneven"]["material"] if word.startswith("fibre")]
    angles = sorted(float(word.split(" at ")[1].split("°")[0]) for word in fibres)
    np.testing.assert_allclose(angles, [115, 155], atol=1)


def test_frames_of_a_folder_are_learned_from_and_held_out(tmp_path):
    class Given:
        pixel, count, smooth = 0.1, 4, 0.0

    x = np.argwhere(np.ones((14, 14), bool)) * 10.0
    for n in range(8):
        u = 0.01 * (n + 1) * x + 1e-4 * x[:, ::-1] ** 2
        rows = "\n".join(",".join(map(str, (*a, *b))) for a, b in zip(x, u))
        (tmp_path / f"{n}.csv").write_text("x,y,u,v\n" + rows)
    (tmp_path / "forces.csv").write_text("time,force\n0,1\n")
    with pytest.warns(
        UserWarning, match=r"passed over: .*forces\.csv: expected columns x, y, u and v"
    ):
        train, test = measured(tmp_path, Given)
    assert (len(train), len(test)) == (2, 2)
    last = 0.08 * train.x[:, 0].max()
    assert train.u[-1, :, 0].max() == pytest.approx(last + 1e-4 * 0.1 * 130**2, rel=1e-6)
    assert train.spacing == pytest.approx(1.0)


def test_frames_that_were_not_solved_are_blank():
    assert blank({"a": [0.5, float("nan")], "b": {"c": float("nan"), "d": "word"}}) == {
        "a": [0.5, None],
        "b": {"c": None, "d": "word"},
    }


def test_a_rival_recovers_its_own_numbers():
    points = square(3)
    window = Window(Samples(points, np.zeros((1, len(points.x), 2))))
    make, starts = RIVALS["HGO, one fibre direction"]
    truth = np.array([2.0, 1.0, -0.5])
    u = points.x @ np.array([[0.2, 0.05], [0.1, 0.15]]) + 0.03 * np.sin(3 * points.x)
    u[window.nodes[window.free]] = window.solve(make(truth), u)
    numbers, left = fit(window, make, np.array(starts[0]), Samples(points, u[None]))
    assert left < 1e-4
    assert numbers[2] == pytest.approx(-0.5, abs=0.02)
    assert window.solve(plane_stress_hgo(1.0), u) is not None


def test_interpolation_is_exact_for_cubics_and_not_beyond():
    points = square(3)
    x, y = (points.x - points.x.mean(axis=0)).T
    cubic = np.stack([x**3 - x * y**2, 1 + y**3 + x**2 * y], axis=1)
    samples = Samples(points, np.stack([cubic, cubic + x[:, None] ** 4]))
    exact, beyond = interpolated_errors(samples, samples.u)["frames"]
    assert exact < 1e-12
    assert beyond > 1e-6


def test_an_uneven_sheet_is_seen_as_one():
    points = square(3)
    window = Window(Samples(points, np.zeros((1, len(points.x), 2))))
    make, starts = RIVALS["neo-Hookean, uneven"]
    truth = np.array([0.3, -0.2, 0.1, 0.2])
    u = points.x @ np.array([[0.2, 0.05], [0.1, 0.15]])
    even = u.copy()
    u[window.nodes[window.free]] = window.solve(make(truth), u)
    numbers, left = fit(window, make, np.array(starts[0]), Samples(points, u[None]))
    assert left < 1e-5
    np.testing.assert_allclose(numbers, truth, atol=0.02)
    still = window.solve(make(0 * truth), even)
    np.testing.assert_allclose(still, even[window.nodes[window.free]], atol=1e-8)


def test_pictures_are_drawn(tmp_path):
    points = square(3)
    u = np.stack([0.05 * n * points.x for n in (1, 2)])
    frames = Samples(points, u, arrays={"protocol": np.array([0, 0])})
    solid = HyperelasticSolid(hgo_dictionary(), np.array([0.2] * 4 + [0.07, 0.08, 0.2]), 0.1)
    report = {"families": {"frames": [0.01, 0.02]}, "rivals": {"Fung": {"frames": [0.03, 0.04]}}}
    draw(solid, frames, u, report, tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {
        "maps.png", "curves.png", "rose.png", "errors.png",
    }  # fmt: skip


@pytest.mark.parametrize(
    "words", [["--noise", "-1"], ["--noise", "nan"], ["--pixel", "0"], ["--count", "3"]]
)
def test_noise_below_zero_and_too_few_frames_are_refused(words, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["leaflet.py", *words])
    with pytest.raises(SystemExit):
        arguments()
    assert "expected --noise ≥ 0, --pixel > 0 and --count ≥ 4" in capsys.readouterr().err
