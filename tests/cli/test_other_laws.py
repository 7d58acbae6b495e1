"""Commands on laws other than the LPS: what a crystal or a sheet is, proves, answers and misses."""

import dataclasses
import json

import meshio
import numpy as np
import pytest

import warp_peri as wp
from tests.conformance.test_breaking import SOLIDS
from tests.conformance.test_laws import LAWS, solved_samples
from tests.support.problems import lattice, smooth
from tests.support.sheets import NEAREST, square, waves
from warp_peri.cli.main import main
from warp_peri.materials.crystal_fit import fit_symbol
from warp_peri.points.dataset import load_dataset

MODULI = wp.micromodulus.from_voigt([[1.0, 0.3, 0.0], [0.3, 1.0, 0.0], [0.0, 0.0, 0.5]])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A crystal and a sheet as files, each with data on its nodes."""
    folder = tmp_path_factory.mktemp("laws")

    def symbol(k):
        return np.einsum("ijkl,nj,nl->nik", MODULI, k, k)

    crystal = fit_symbol(symbol, 1.0, 2.0, symmetry="4mm", tensor=MODULI)
    points = dataclasses.replace(lattice(8, 2.0, 1.0), axis=0.0)
    u = 0.01 * smooth(points.x, 2, wave_number=0.4)
    b = np.zeros_like(u)
    b[:, points.interior] = crystal.on(points)(u)
    term = wp.tissue.Term("plane_stress")
    numbers = np.array([0.1] * 4 + [0.4])
    sheet = wp.tissue.HyperelasticSolid(
        wp.tissue.Dictionary(3.0, (), NEAREST, (term,)), numbers, 0.1
    )
    bent = 0.1 * waves(square(5), 0.25, 1)[None]
    for name, law, samples in (
        ("crystal", crystal, wp.Samples(points, u, b)),
        ("sheet", sheet, wp.Samples(square(5), bent)),
    ):
        wp.save(folder / f"{name}.json", law)
        data = wp.Dataset({"test": samples}, thickness=1.0, density=1.0)
        wp.save(folder / f"{name}.h5", data)
    return folder


@pytest.mark.parametrize("name", ["crystal", "sheet"])
def test_what_it_is_and_how_far_off(folder, capsys, name):
    assert main(["info", f"{folder / name}.json"]) == 0
    text = capsys.readouterr().out
    assert "GPa" in text
    assert "TPa" not in text
    assert main(["info", f"{folder / name}.json", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    if name == "crystal":  # numbers of the file, in its units
        assert found["units"] == ["angstrom", "TPa"]
        law = wp.load(folder / "crystal.json")
        assert found["moduli"] == pytest.approx(law.moduli())
    else:
        assert any("GPa" in str(value) for value in found.values())
    assert main(["evaluate", f"{folder / name}.json", f"{folder / name}.h5"]) == 0
    (line,) = [each for each in capsys.readouterr().out.splitlines() if each.startswith("test")]
    assert ("–" in line) == (name == "sheet")  # without loads there is no residual


EACH = {name: law.material for name, law in LAWS.items()}
EACH["brittle"] = lambda: SOLIDS["brittle"](2)


LONG = ("third order, filtered", "third order, energy", "LPS, bond-based")


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", [name for name in EACH if name not in LONG])
def test_every_command_answers_or_refuses_whatever_the_law(name, tmp_path, capsys):
    wp.save(tmp_path / "m.json", EACH[name]())
    if name in LAWS:
        points = LAWS[name].points(4)
        samples = solved_samples(LAWS[name], EACH[name]().on(points), points)
    else:
        samples = wp.Samples(lattice(4, 2.0), np.zeros((1, 144, 2)), np.zeros((1, 144, 2)))
    wp.save(tmp_path / "d.h5", wp.Dataset({"test": samples}, 3.35, 2200.0))
    model, data = str(tmp_path / "m.json"), str(tmp_path / "d.h5")
    for words in (
        ["evaluate", model, data],
        ["evaluate", model, data, "--json"],
        ["certify", model],
        ["export", model, data],
    ):
        out = ["--out", str(tmp_path / "out")] if words[0] == "export" else []
        status, said = main([*words, *out]), capsys.readouterr()
        assert status in (0, 2), words
        assert bool(said.out) == (status == 0)
        if words[-1] == "--json" and status == 0:
            assert json.loads(said.out)["test"]["samples"] == len(samples)


def test_a_crystal_is_certified_and_solved_by_its_commands(folder, tmp_path, capsys):
    assert main(["certify", f"{folder}/crystal.json", "--json"]) == 0
    (proven,) = json.loads(capsys.readouterr().out).values()
    assert proven["holds"]
    assert "exactly one solution" in proven["statement"]
    assert main(["certify", f"{folder}/crystal.json", "--spacing", "2"]) == 2
    assert "nodes 1 apart alone" in capsys.readouterr().err
    line = ["solve", f"{folder}/crystal.json", f"{folder}/crystal.h5", "--out"]
    assert main([*line, str(tmp_path / "solved.h5")]) == 0
    found, true = (
        load_dataset(p)["test"].u for p in (tmp_path / "solved.h5", f"{folder}/crystal.h5")
    )
    np.testing.assert_allclose(found, true, atol=1e-8 * np.abs(true).max())


def test_what_is_placed_on_no_nodes_is_refused_in_words(folder, tmp_path, capsys):
    linear = wp.Model(0.8, 0.8, 1.0, [1.0], horizon=2.0)
    wp.save(tmp_path / "brittle.json", wp.damage.BrittleSolid(linear, 2.0, toughness=0.01))
    square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    triangles = [("triangle", np.array([[0, 1, 2], [0, 2, 3]]))]
    meshio.write(tmp_path / "plate.vtu", meshio.Mesh(np.array(square, float), triangles))
    data = str(folder / "crystal.h5")
    for name, kind in (("brittle.json", "BrittleSolid"), ("plate.vtu", "Mesh")):
        given, out = str(tmp_path / name), str(tmp_path / "out")
        for words in (
            ["evaluate", given, data],
            ["export", given, data, "--out", out],
            ["solve", given, data, "--out", out + ".h5"],
        ):
            assert main(words) != 0
            err = capsys.readouterr().err
            assert f"expected a material that is placed on nodes, got {kind}" in err
    wp.save(tmp_path / "heat.json", wp.diffusion.Conductor(2.0))
    main(["evaluate", str(tmp_path / "heat.json"), data, "--json"])
    printed = capsys.readouterr()
    assert "b: expected shape" in printed.out + printed.err
