"""A sheet's material chosen by frames left out; what fails is passed over; tension with a band."""

import json
from pathlib import Path

import numpy as np
import pytest

import warp_peri as wp
from tests.support.sheets import NEAREST, square, waves
from tools import make_frames
from warp_peri.cli.main import main
from warp_peri.sources.dic import frames_of_folder
from warp_peri.tissue import Dictionary, HyperelasticSolid, Term, sheet_choice, uniaxial
from warp_peri.tissue.kept_fits import KeptFits

C1, C2 = 0.35, 0.15
TERMS = (Term("plane_stress"), Term("mooney"))
SHEET = HyperelasticSolid(Dictionary(3.0, (), NEAREST, TERMS), np.array([0.1] * 4 + [C1, C2]), 0.1)


def tension(stretch):
    """Nominal stress of Mooney and Rivlin's sheet in uniaxial tension."""
    return 2 * (stretch - stretch**-2) * (C1 + C2 / stretch)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Frames of a sheet of Mooney and Rivlin in mm, as tables."""
    out = tmp_path_factory.mktemp("frames")
    points = square(5)
    bent = points.x @ np.array([[0.3, 0.05], [0.0, 0.1]])
    for number in range(6):
        edge = bent * (number + 3) / 8 + 0.6 * waves(points, 0.25, number)
        u = wp.solve(SHEET, wp.Dirichlet(points, None, edge)).u
        rows = "\n".join(",".join(map(str, row)) for row in np.hstack([points.x, u]))
        (out / f"frame{number}.csv").write_text("x [mm],y [mm],u [mm],v [mm]\n" + rows + "\n")
    return out


def test_uniaxial_tension_is_that_of_the_formula():
    for angle in (0.0, 0.7):
        found = uniaxial(SHEET, [1.1, 1.4], angle)
        np.testing.assert_allclose(found, [tension(1.1), tension(1.4)], rtol=1e-8)


def test_the_command_keeps_every_fit_and_passes_over_what_fails(folder, tmp_path, monkeypatch):
    fit = sheet_choice.fit_displacement

    def broken(train, dictionary, **options):
        if len(dictionary.terms) == 1:
            raise RuntimeError("Factor is exactly singular")
        return fit(train, dictionary, **options)

    monkeypatch.setattr(sheet_choice, "fit_displacement", broken)
    line = ["dic", str(folder), "--even", "--out", str(tmp_path / "out"), "--json"]
    assert main([*line, "--stress", "0.3", "--pixel", "0.012"]) == 2  # in which unit?
    assert main([*line, "--stress", "0.3"]) == 0
    found = json.loads((tmp_path / "out" / "dic.json").read_text())
    assert found["material"] == "Mooney-Rivlin"
    assert "exactly singular" in found["passed_over"][0]
    assert found["lengths"] == "mm"
    assert found["stresses"].startswith("are in MPa")
    assert any(words.startswith("deviations") for words in found["words"])
    assert (tmp_path / "out" / "Mooney-Rivlin.json").exists()
    assert "Mooney-Rivlin" in (tmp_path / "out" / "material.feb").read_text()
    material = wp.load(tmp_path / "out" / "material.json")
    frames = frames_of_folder(folder, 7, radius=0.0)
    stress = material.on(frames.points).stress(frames.u[-1])
    assert stress[:, 0, 0].mean() == pytest.approx(0.3)
    shape = uniaxial(material, [1.4])[0] / uniaxial(material, [1.05])[0]
    assert shape == pytest.approx(tension(1.4) / tension(1.05), rel=0.01)
    middle, low, high = found["tension_with_90_percent_band"]["along 0 deg"]["stretch 1.1"]
    assert low <= middle <= high
    table = np.loadtxt(tmp_path / "out" / "curves.csv", delimiter=",", skiprows=1)
    assert (table[:, 2] <= table[:, 1]).all()


def test_a_second_start_goes_on_from_the_fits_that_are_kept(folder, tmp_path, monkeypatch, capsys):
    fit, names = sheet_choice.fit_displacement, []

    def counted(train, dictionary, **options):
        names.append(options["progress"])
        if len(names) == 3:
            raise KeyboardInterrupt
        return fit(train, dictionary, **options)

    monkeypatch.setattr(sheet_choice, "fit_displacement", counted)
    line = ["dic", str(folder), "--even", "--count", "4", "--out", str(tmp_path / "out")]
    assert main(line) == 130
    assert names[:2] == ["neo-Hookean", "Mooney-Rivlin"]  # bars have the candidates' names
    capsys.readouterr()
    assert main(line) == 0
    assert "2 fits are there and are taken as they are" in capsys.readouterr().err
    assert names[2:] == ["Mooney-Rivlin, band 1 of 2"] * 2 + ["Mooney-Rivlin, band 2 of 2"]
    for broken in (tmp_path / "out" / "fits").glob("neo*.fit.json"):
        broken.write_text("{")
    assert main(line) == 0
    assert names[5:] == ["neo-Hookean"]  # a record that cannot be read is made again
    frames = frames_of_folder(folder, 4, radius=0.0)
    for settings, count in ((sheet_choice.SETTINGS, (4, 0)), ("others", (0, 4))):
        assert KeptFits(tmp_path / "out" / "fits", frames, settings).count() == count
    other = wp.Samples(frames.points, frames.u + 1e-9)
    assert KeptFits(tmp_path / "out" / "fits", other, sheet_choice.SETTINGS).count() == (0, 4)


def test_fewer_frames_than_four_are_refused():
    points = square(3)
    with pytest.raises(wp.InputError, match="frames: expected at least 4, got 3"):
        wp.tissue.choose_sheet(wp.Samples(points, np.zeros((3, *points.x.shape))))
    with pytest.raises(wp.InputError, match="fibres: expected a number of directions"):
        wp.tissue.choose_sheet(wp.Samples(points, np.zeros((4, *points.x.shape))), fibres=-1)


@pytest.mark.slow
def test_a_rubber_sheet_of_elements_pulls_as_it_should(tmp_path):
    """The shipped frames of elements, noise of 0.02 pixels: tension at stretch 1.4 within 1 %."""
    shipped = Path(__file__).parents[2] / "examples" / "frames"
    make_frames.write_frames(tmp_path / "frames")
    for path in (tmp_path / "frames").iterdir():
        again, there = (
            np.loadtxt(p / path.name, delimiter=",", skiprows=1) for p in (path.parent, shipped)
        )
        np.testing.assert_allclose(again, there, atol=2e-3)  # written to 1e-3 pixels
    line = ["dic", str(shipped), "--pixel", "0.012mm", "--fibres", "0"]
    assert main([*line, "--out", str(tmp_path / "out")]) == 0
    found = json.loads((tmp_path / "out" / "dic.json").read_text())
    assert found["material"].startswith("Mooney-Rivlin")
    assert "no force is known" in found["stresses"]
    pull = uniaxial(wp.load(tmp_path / "out" / "material.json"), [1.01, 1.4])
    true = [(s - s**-2) * (make_frames.C1 + make_frames.C2 / s) for s in (1.01, 1.4)]
    assert pull[1] / pull[0] == pytest.approx(true[1] / true[0], rel=0.01)
