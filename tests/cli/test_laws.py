"""Commands on laws other than the LPS and on bodies: what they are, prove, answer and refuse."""

import dataclasses
import json
from typing import get_args

import meshio
import numpy as np
import pytest

import warp_peri as wp
from tests.conformance.test_breaking import SOLIDS
from tests.support.materials import LAWS, hyperelastic, solved_samples
from tests.support.nonlinear import solid
from tests.support.plates import plate
from tests.support.problems import kernel, lattice
from warp_peri.cli.commands import solver_of
from warp_peri.cli.main import main, parser_of
from warp_peri.solvers.solution import Preconditioner

EACH = {name: law.material for name, law in LAWS.items()}
EACH["brittle"] = lambda: SOLIDS["brittle"](2)
LONG = ("third order, filtered", "third order, energy", "LPS, bond-based")


def answer(capsys, *words):
    assert main([*map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


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
        ["info", model],
        ["evaluate", model, data],
        ["evaluate", model, data, "--json"],
        ["certify", model],
        ["export", model, data, "--out", str(tmp_path / "out")],
        ["solve", model, data, "--out", str(tmp_path / "out.h5")],
    ):
        status, said = main(words), capsys.readouterr()
        assert status in (0, 2), words
        assert bool(said.out) == (status == 0)
        if name == "brittle" and words[0] not in ("info", "certify"):
            assert "expected a material that is placed on nodes, got BrittleMaterial" in said.err
        if words[-1] == "--json" and status == 0:
            assert json.loads(said.out)["test"]["samples"] == len(samples)


def test_third_order_and_crystals_are_certified_on_their_lattices(tmp_path, capsys):
    model, file = solid("energy"), tmp_path / "m.json"
    model.save(file)
    proof = answer(capsys, "certify", file)["1 Å"]["nonlinear"]
    assert proof["strain"] == pytest.approx(model.proven_strain(1.0))
    about = answer(capsys, "info", file)
    assert about["form"] == "energy"
    assert about["t3, tq2, q3"].startswith(f"{1e3 * model.t3:.4g}, ")
    law = LAWS["crystal"].material()
    wp.save(file, law)
    (proven,) = answer(capsys, "certify", file).values()
    assert proven["holds"]
    assert "exactly one solution" in proven["statement"]
    assert main(["certify", str(file), "--spacing", str(3 * law.spacing)]) == 2
    assert f"spacing: the model is for {law.spacing:g}, got" in capsys.readouterr().err


def test_a_method_is_of_linear_solids():
    with pytest.raises(wp.InputError, match="expected auto for a ThirdOrderMaterial"):
        solver_of("lu", solid("energy"))
    (method,) = (one for one in parser_of("solve")._actions if one.dest == "method")
    assert set(method.choices) == {"auto", "lu", "gmres", *get_args(Preconditioner)}


@pytest.fixture
def files(tmp_path):
    """A model file, and a plate of 40 Å with a hole in Gmsh's format."""
    dataclasses.replace(kernel("positive", 2.5), certified_on=(1.0,)).save(tmp_path / "model.json")
    mesh = plate(7.0, 20.0, 10, 48)
    sides = {"hole": mesh.parts["hole"]}
    for name, place in (("left", -20.0), ("right", 20.0)):
        sides[name] = [e for e in mesh.parts["sides"] if np.allclose(mesh.middle[e, 0], place)]
    lines = np.concatenate([mesh.faces[side] for side in sides.values()])
    tags = [np.repeat([1, 2, 3], [*map(len, sides.values())]), np.full(len(mesh.cells), 9)]
    meshio.Mesh(
        np.column_stack([mesh.x, np.zeros(len(mesh.x))]),
        [("line", lines), ("triangle", mesh.cells)],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={name: np.array([n, 1]) for n, name in enumerate(sides, 1)},
    ).write(tmp_path / "plate.msh", file_format="gmsh22", binary=False)
    return tmp_path


def test_a_plate_is_pulled_in_other_units_too(files, capsys):
    told = answer(capsys, "info", files / "plate.msh")
    assert (told["format"], told["box"]) == ("mesh", [[-20.0, 20.0], [-20.0, 20.0]])
    assert {*told["parts"]} >= {"hole", "left", "right"}
    out = files / "pulled.vtu"
    words = ["solve", files / "model.json", "--body", files / "plate.msh", "--hold", "left=0,0"]
    numbers = answer(capsys, *words, "--pull", "right=0.005,0", "--out", out)
    assert numbers["mismatch"] <= 1e-8
    assert numbers["lattice_nodes"] > 100
    read = meshio.read(out)
    right = np.isclose(read.points[:, 0], 20.0)
    assert read.point_data["displacement"][right, 0].min() > 0
    assert read.point_data["stress"][right, 0].mean() == pytest.approx(0.005, rel=0.1)
    again = files / "again.vtu"
    assert main(["solve", "--config", str(files / "pulled.solve.toml"), "--out", str(again)]) == 0
    capsys.readouterr()
    u = meshio.read(again).point_data["displacement"]
    np.testing.assert_array_equal(u, read.point_data["displacement"])
    words += ["--hold", "right=0.1,-", "--units", "angstrom", "GPa", "--out", again]
    found = answer(capsys, *words)  # a second option adds to the first
    assert found["units"] == ["angstrom", "GPa"]
    assert found["largest_displacement"] >= 0.1
    assert found["largest_principal_stress"] > 0.5  # of some TPa · 0.1/40


NO_BODY = {
    "--hold up=0,0": "part 'up': the outline has",
    "--hold left": "hold: expected PART=number,number",
    "--hold left=0,0 --out x.h5": "expected a .vtu file",
    "--hold left=0,0 --hold left=1,0": "hold: expected each part once",
    "--hold left=0,0 --method lu --axis 0": "method, axis: expected with loads of a data",
    "--hold left=0,0 --no-transfer": "no-transfer: expected with loads",
    "--hold left=0,0 --units mm stone": "stress_unit: expected one of",
    "--hold left=1,0": "error: solve: expected a linear material for a Body",
}


def test_bodies_that_make_no_sense_write_nothing(files, capsys):
    hyperelastic().save(files / "other.json")
    before = {*files.iterdir()}
    for words, message in NO_BODY.items():
        model = files / ("other.json" if "linear material" in message else "model.json")
        line = f"solve {model} --body {files}/plate.msh --out {files}/new.vtu {words}"
        assert main(line.split()) == 2
        assert message in capsys.readouterr().err
        assert {path for path in files.iterdir() if path.suffix != ".lock"} == before
