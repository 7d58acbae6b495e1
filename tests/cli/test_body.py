"""`warp-peri solve --body`: a mesh of Gmsh to displacement and stress for ParaView."""

import dataclasses
import json
from argparse import ArgumentParser

import meshio
import numpy as np
import pytest

import warp_peri as wp
from tests.conformance.test_laws import hyperelastic, third_order
from tests.support.plates import plate
from tests.support.problems import kernel
from warp_peri.cli.arguments import add_options
from warp_peri.cli.commands import _solver
from warp_peri.cli.main import main
from warp_peri.solvers.solution import PRECONDITIONERS


@pytest.fixture
def files(tmp_path):
    """A model file, and a plate of 40 Å with a hole in Gmsh's format."""
    dataclasses.replace(kernel("positive", 2.5), certified_on=(1.0,)).save(tmp_path / "model.json")
    mesh = plate(7.0, 20.0, 10, 48)
    numbers = {"hole": 1, "left": 2, "right": 3}
    sides = {
        "hole": mesh.parts["hole"],
        **{
            name: [e for e in mesh.parts["sides"] if np.allclose(mesh.middle[e, 0], place)]
            for name, place in (("left", -20.0), ("right", 20.0))
        },
    }
    lines = np.concatenate([mesh.edges[sides[name]] for name in numbers])
    tags = [np.repeat(list(numbers.values()), [len(sides[name]) for name in numbers])]
    tags.append(np.full(len(mesh.triangles), 9))
    meshio.Mesh(
        np.column_stack([mesh.x, np.zeros(len(mesh.x))]),
        [("line", lines), ("triangle", mesh.triangles)],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={name: np.array([n, 1]) for name, n in numbers.items()},
    ).write(tmp_path / "plate.msh", file_format="gmsh22", binary=False)
    return tmp_path


def test_a_plate_is_pulled(files, capsys):
    out = files / "pulled.vtu"
    words = ["solve", files / "model.json", "--body", files / "plate.msh", "--hold", "left=0,0"]
    words += ["--pull", "right=0.005,0", "--out", out, "--json"]
    assert main([str(word) for word in words]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert numbers["mismatch"] <= 1e-8
    assert numbers["lattice_nodes"] > 100
    read = meshio.read(out)
    right = np.isclose(read.points[:, 0], 20.0)
    assert read.point_data["displacement"][right, 0].min() > 0
    assert read.point_data["stress"][right, 0].mean() == pytest.approx(0.005, rel=0.1)
    again = files / "again.vtu"
    assert main(["solve", "--config", str(files / "pulled.solve.toml"), "--out", str(again)]) == 0
    np.testing.assert_array_equal(
        meshio.read(again).point_data["displacement"], read.point_data["displacement"]
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--hold", "up=0,0"], "part 'up': the outline has"),
        (["--hold", "left"], "hold: expected PART=number,number"),
        (["--hold", "left=0,0", "--out", "x.h5"], "expected a .vtu file"),
        (["--hold", "left=0,0", "--hold", "left=1,0"], "hold: expected each part once"),
        (["--hold", "left=0,0", "--method", "lu"], "method: expected with loads of a data file"),
        (["--hold", "left=0,0", "--axis", "0"], "axis: expected with loads of a data file"),
        (["--hold", "left=0,0", "--set", "val"], "set: expected with loads of a data file"),
        (["--hold", "left=0,0", "--no-transfer"], "no-transfer: expected with loads"),
        (["--hold", "left=0,0", "--units", "mm", "stone"], "stress_unit: expected one of"),
    ],
)
def test_bad_input_writes_nothing(files, capsys, words, message):
    base = ["solve", files / "model.json", "--body", files / "plate.msh"]
    out = [] if "--out" in words else ["--out", files / "new.vtu"]
    before = set(files.iterdir())
    assert main([str(word) for word in [*base, *out, *words]]) == 2
    assert message in capsys.readouterr().err
    assert {path for path in files.iterdir() if path.suffix != ".lock"} == before


def test_a_second_option_adds_to_the_first_and_units_are_told(files, capsys):
    base = ["solve", files / "model.json", "--body", files / "plate.msh", "--json"]
    held = ["--hold", "left=0,0", "--hold", "right=0.1,-"]
    found = []
    for n, units in enumerate([[], ["--units", "angstrom", "GPa"]]):
        words = [*base, *held, *units, "--out", files / f"{n}.vtu"]
        assert main([str(word) for word in words]) == 0
        found.append(json.loads(capsys.readouterr().out))
    assert [one["units"] for one in found] == [["angstrom", "TPa"], ["angstrom", "GPa"]]
    assert found[0]["largest_displacement"] >= 0.1
    stress = "largest_principal_stress"
    assert found[1][stress] == pytest.approx(1e3 * found[0][stress], rel=1e-6)
    assert found[1]["largest_displacement"] == pytest.approx(found[0]["largest_displacement"])


def test_a_material_that_bodies_are_not_of_is_refused(files, capsys):
    for material in (hyperelastic(),):
        material.save(files / "other.json")
        words = ["solve", files / "other.json", "--body", files / "plate.msh", "--hold", "left=0,0"]
        assert main([str(word) for word in [*words, "--out", files / "new.vtu"]]) == 2
        assert "error: solve: expected a linear material for a Body" in capsys.readouterr().err


def test_a_method_is_of_linear_solids_and_body_options_are_of_bodies(files, capsys):
    third_order("energy")().save(files / "bent.json")
    data = ["solve", files / "bent.json", files / "data.h5", "--out", files / "new.h5"]
    with pytest.raises(SystemExit):
        main([str(word) for word in [*data, "--method", "nonsense"]])
    assert "invalid choice: 'nonsense'" in capsys.readouterr().err
    assert main([str(word) for word in [*data, "--pull", "right=1,0"]]) == 2
    assert "pull: expected with --body MESH" in capsys.readouterr().err
    with pytest.raises(wp.InputError, match="expected auto for a ThirdOrderCrystal"):
        _solver("lu", third_order("energy")())
    parser = ArgumentParser()
    add_options(parser, "solve")
    (method,) = (action for action in parser._actions if action.dest == "method")
    assert set(method.choices) == {"auto", "lu", "gmres", *PRECONDITIONERS}
