"""Meshes of Abaqus: what is read, what is refused by name, and files that are cut anywhere."""

import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest

from warp_peri import InputError, load
from warp_peri.points.mesh import REST, load_mesh

ROOT = Path(__file__).parent.parent.parent
NODES = "*NODE\n" + "".join(
    f"{10 * n + 1}, {x}., {y}.\n"
    for n, (x, y) in enumerate([(0, 0), (3, 0), (6, 0), (0, 2), (3, 2), (6, 2)])
)
CELLS = "*ELEMENT, TYPE=CPS4R, ELSET=plate\n7, 1, 11, 41,\n31\n9, 11, 21, 51, 41\n"
PLATE = f"*HEADING\nA plate, 12 of area\n{NODES}{CELLS}"


def mesh_of(tmp_path, text):
    (tmp_path / "a.inp").write_text(text)
    return load(tmp_path / "a.inp")


def area(mesh):
    x = mesh.x[mesh.triangles]
    return np.abs(np.linalg.det(x[:, 1:] - x[:, :1])).sum() / 2


def middles(mesh, name):
    return mesh.x[mesh.edges[mesh.parts[name]]].mean(axis=1)


def test_sets_of_nodes_and_of_lines_are_parts(tmp_path):
    """Whatever blocks they lie in: each is where its corners are."""
    text = PLATE + (
        "*ELEMENT, TYPE=T2D2, ELSET=low\n21, 1, 11\n22, 11, 21\n"
        "*ELEMENT, TYPE=T2D2\n23, 21, 51\n*ELEMENT, TYPE=B21\n24, 51, 41\n"
        "*ELSET, ELSET=right\n23\n*ELSET, ELSET=two\nright, 24\n"
        "*NSET, NSET=left\n1, 31\n*NSET, NSET=top, GENERATE\n31, 51, 10\n"
        "*NSET, NSET=corner\n1\n"
    )
    with pytest.warns(UserWarning, match="corner: no side of the outline is between its nodes"):
        mesh = mesh_of(tmp_path, text)
    assert area(mesh) == pytest.approx(12)
    assert {name: len(part) for name, part in mesh.parts.items()} == {
        "low": 2, "right": 1, "two": 2, "left": 1, "top": 2,
    } | ({REST: 0} if REST in mesh.parts else {})  # fmt: skip
    for name, where in {
        "low": (None, 0),
        "left": (0, None),
        "right": (6, None),
        "top": (None, 2),
    }.items():
        for axis, value in enumerate(where):
            if value is not None:
                np.testing.assert_allclose(middles(mesh, name)[:, axis], value)


def test_one_part_that_is_placed_where_it_is(tmp_path):
    """As CAE writes it, with sets in the assembly, a material, a second block of nodes, a step."""
    first, second = NODES.splitlines(keepends=True)[:4], NODES.splitlines(keepends=True)[4:]
    text = (
        "*Heading\n*Part, name=P\n" + "".join(first) + "*Node\n" + "".join(second) + CELLS
        + "*Nset, nset=inner, internal\n1, 31\n"
        "*Solid Section, elset=plate, material=m\n1.,\n*End Part\n*Assembly, name=A\n"
        "*Instance, name=I, part=P\n*End Instance\n"
        "*Nset, nset=left, instance=I\n1, 31\n*End Assembly\n*Material, name=m\n*Elastic\n1., .3\n"
        "*Step\n*Boundary\nleft, 1, 2\n*End Step\n"
    )  # fmt: skip
    with pytest.warns(
        UserWarning, match=r"not read: \*SOLID SECTION, \*MATERIAL, \*ELASTIC, \*STEP"
    ):
        mesh = mesh_of(tmp_path, text)
    assert area(mesh) == pytest.approx(12)
    np.testing.assert_allclose(middles(mesh, "left"), [[0, 1]])


@pytest.mark.parametrize(
    ("kind", "cell"),
    [
        ("C3D8R", "hexahedron"),
        ("C3D20", "hexahedron20"),
        ("C3D4", "tetra"),
        ("C3D10M", "tetra10"),
        ("C3D6", "wedge"),
    ],
)
def test_solids_have_the_volume_and_the_faces_of_what_meshio_writes(kind, cell, tmp_path):
    count = {"hexahedron": 8, "hexahedron20": 20, "tetra": 4, "tetra10": 10, "wedge": 6}[cell]
    corners = {
        8: [[0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 3, 0], [0, 0, 1], [2, 0, 1], [2, 3, 1], [0, 3, 1]],
        4: [[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 1]],
        6: [[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 1], [2, 0, 1], [0, 3, 1]],
    }[{20: 8, 10: 4}.get(count, count)]
    x = np.array(corners + [[0.5, 0.5, 0.5]] * (count - len(corners)), float)
    rows = "".join(f"{n + 1}, {a}, {b}, {c}\n" for n, (a, b, c) in enumerate(x))
    low = ", ".join(str(n + 1) for n, place in enumerate(x) if place[2] == 0)
    text = f"*NODE\n{rows}*ELEMENT, TYPE={kind}\n1, "
    text += ", ".join(str(n + 1) for n in range(count)) + f"\n*NSET, NSET=low\n{low}\n"
    mesh = mesh_of(tmp_path, text)
    x = mesh.x[mesh.cells]
    volume = np.abs(np.linalg.det(x[:, 1:] - x[:, :1])).sum() / 6
    assert volume == pytest.approx({8: 6, 4: 1, 6: 3}[len(corners)])
    low = mesh.x[mesh.faces[mesh.parts["low"]]]
    np.testing.assert_array_equal(low[..., 2], 0)
    assert len(low) == {8: 2, 4: 1, 6: 1}[len(corners)]


PART = f"*PART, NAME=P\n{NODES}{CELLS}*END PART\n*ASSEMBLY, NAME=A\n"
INSTANCE = "*INSTANCE, NAME={}, PART=P\n{}*END INSTANCE\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (PART + INSTANCE.format("I", "") + INSTANCE.format("J", ""), r"\*INSTANCE: expected one"),
        (
            PART + INSTANCE.format("I", "10., 0., 0.\n"),
            r"\*INSTANCE: expected one that is not moved",
        ),
        (PART + INSTANCE.format("I", "0,0,0\n0,0,0,0,0,1,90\n"), r"\*INSTANCE: expected one"),
        (PART + PART, r"\*PART: expected one"),
        (PLATE.replace("*NODE", "*NODE, SYSTEM=C"), r"\*NODE, SYSTEM: it is not read"),
        (PLATE.replace("*NODE", "*Node, Input=n.txt"), r"\*NODE, INPUT: it is not read"),
        (PLATE.replace("*NODE", "*SYSTEM\n0,0,0,0,1,0\n*NODE"), r"\*SYSTEM is not read"),
        (PLATE + "*ELGEN\n7, 2, 1, 1\n", r"\*ELGEN is not read"),
        (PLATE + "*NGEN\n1, 31, 10\n", r"\*NGEN is not read"),
        (PLATE + "*NCOPY, CHANGE NUMBER=100, OLD SET=a, SHIFT\n1,0,0\n", r"\*NCOPY is not read"),
        (PLATE + "*NMAP\n", r"\*NMAP is not read"),
        (PLATE + "*NFILL\n", r"\*NFILL is not read"),
        (PLATE + "*ELCOPY\n", r"\*ELCOPY is not read"),
        (PLATE + "*INCLUDE, INPUT=other.inp\n", r"\*INCLUDE is not read"),
        (PLATE + "*SURFACE, NAME=s\nplate, S1\n", r"\*SURFACE is not read"),
        (PLATE + "*TIE, NAME=t\na, b\n", r"\*TIE is not read"),
        (PLATE + "*NSET, NSET=a, ELSET=plate\n", r"\*NSET, ELSET: it is not read"),
        (PLATE + "*NSET, NSET=a\n77\n", r"\*NSET, a: 77 is not there"),
        (PLATE + "*ELSET, ELSET=a\nother\n", r"\*ELSET, a: other is not there"),
        (PLATE + "*NODE\n1, 5., 5.\n", r"\*NODE: expected each number once"),
        (PLATE + CELLS, r"\*ELEMENT: expected each number once"),
        (PLATE.replace("CPS4R", "CAX4"), "TYPE=CAX4: it is not read"),
        (PLATE.replace("CPS4R", "CPS6"), "TYPE=CPS6: expected 6 nodes of each"),
        (PLATE.replace("51, 41", "52, 41"), r"\*ELEMENT: expected nodes that are there, got 52"),
        (NODES, "got nothing"),
        ("1, 2\n", "expected a keyword"),
        (PLATE + "*NSET, NSET=a, GENERATE\n1, 99999999999, 0\n", "not a mesh of abaqus"),
    ],
)
def test_what_is_not_read_is_refused_by_name(text, said, tmp_path):
    with pytest.raises(InputError, match=said):
        mesh_of(tmp_path, text)


@pytest.mark.parametrize(
    "name", ["a.mesh", "a.med", "a.ele", "a.bdf", "a.su2", "a.vol", "a.avs", "a", "a.dat"]
)
def test_other_formats_are_converted_by_their_owner(name, tmp_path):
    (tmp_path / name).write_text("")
    with pytest.raises(InputError, match="convert it with meshio, then check the groups"):
        load_mesh(tmp_path / name)


CUT = """
import sys, warnings
from pathlib import Path
from warp_peri import InputError, load
warnings.simplefilter("ignore")
path = Path(sys.argv[1])
whole = path.read_bytes()
for size in range(0, len(whole), max(1, len(whole) // 60)):
    cut = path.with_name("cut" + path.suffix)
    cut.write_bytes(whole[:size])
    try:
        load(cut)
    except InputError:
        pass
print("ended")
"""


@pytest.mark.parametrize("form", ["gmsh22", "gmsh", "vtk", "vtu", "xdmf", "abaqus"])
@pytest.mark.parametrize("binary", [True, False])
def test_cut_files_are_read_or_refused_and_none_waits_for_ever(form, binary, tmp_path):
    suffix = {"gmsh22": ".msh", "gmsh": ".msh", "abaqus": ".inp"}.get(form, f".{form}")
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    file = meshio.Mesh(square, [("triangle", np.array([[0, 1, 2], [0, 2, 3]]))])
    how = {} if form in ("abaqus", "xdmf") else {"binary": binary}
    if form == "xdmf":
        how = {"data_format": "HDF" if binary else "XML"}
    file.write(tmp_path / f"a{suffix}", file_format=form, **how)
    words = [sys.executable, "-c", CUT, str(tmp_path / f"a{suffix}")]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.stdout.endswith("ended\n"), done.stderr
