"""Meshes of bodies: outlines, files, and what is refused."""

import meshio
import numpy as np
import pytest

from tests.support.plates import plate
from warp_peri import load
from warp_peri.errors import InputError
from warp_peri.points.mesh import REST, load_mesh, make_mesh
from warp_peri.points.outlines import Circle, Polygon, box, mesh_outline

SQUARE = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])


def area(mesh):
    return np.linalg.det(mesh.x[mesh.triangles[:, 1:]] - mesh.x[mesh.triangles[:, :1]]).sum() / 2


def test_an_outline_has_its_parts_curves_and_distances():
    mesh = mesh_outline(box(40, 30), [Circle(5, (3, 1), size=1)], size=4)
    assert set(mesh.parts) == {"bottom", "right", "top", "left", "hole"}
    assert np.ptp(mesh.loops) == 1
    np.testing.assert_allclose(sorted(mesh.loop_sizes), [10, 30], rtol=1e-2)
    hole = mesh.parts["hole"]
    away = mesh.along(np.array([0.0, 0.25, 0.5]), hole) - (3, 1)
    np.testing.assert_allclose(np.hypot(*away.T), 5, rtol=1e-4)
    assert area(mesh) == pytest.approx(40 * 30 - np.pi * 25, rel=1e-2)
    inside = np.array([[0.0, 14.0], [9.0, 1.0]])
    np.testing.assert_allclose(mesh.distance(inside, 0.01), [1, 1], atol=1e-3)
    assert (mesh.holding(np.array([[3.0, 1], [21, 0]])) == -1).all()


def test_a_polygon_of_either_sense_and_a_disk():
    corners = ((0, 0), (10, 0), (10, 4), (4, 4), (4, 10), (0, 10))
    for turned in (corners, corners[::-1]):
        assert area(mesh_outline(Polygon(turned), size=2)) == pytest.approx(64)
    disk = mesh_outline(
        Circle(10, name="edge"), [Polygon(((0, 0), (3, 0), (0, 3)), ("cut",))], size=1
    )
    assert set(disk.parts) == {"edge", "cut"}


@pytest.mark.parametrize("suffix", ["msh", "vtu"])
def test_a_file_of_second_order_keeps_the_curve(tmp_path, suffix):
    mesh = plate(4.0, 10.0, 3, 16)
    number = {}
    x = list(mesh.x)
    middle = {tuple(sorted(e)): m for e, m in zip(mesh.edges.tolist(), mesh.middle)}
    cells = []
    for t in mesh.triangles.tolist():
        halves = []
        for pair in ((t[0], t[1]), (t[1], t[2]), (t[2], t[0])):
            key = tuple(sorted(pair))
            if key not in number:
                number[key] = len(x)
                x.append(middle.get(key, mesh.x[list(key)].mean(axis=0)))
            halves.append(number[key])
        cells.append(t + halves)
    points = np.column_stack([x, np.zeros(len(x))])
    lines = mesh.edges[mesh.parts["hole"]]
    kinds = [("triangle6", np.array(cells))]
    written = meshio.Mesh(points, kinds)
    if suffix == "msh":
        tags = [np.full(len(lines), 7), np.full(len(cells), 8)]
        written = meshio.Mesh(
            points,
            [("line", lines), *kinds],
            cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
            field_data={"hole": np.array([7, 1])},
        )
    file = tmp_path / f"plate.{suffix}"
    written.write(file, **({"file_format": "gmsh22", "binary": False} if suffix == "msh" else {}))
    reread = load_mesh(file)
    assert len(reread.x) == len(mesh.x)
    assert set(reread.parts) == ({"hole", REST} if suffix == "msh" else {REST})
    radius = np.hypot(*reread.middle.T)
    assert np.count_nonzero(np.abs(radius - 4) < 1e-6) == 16


@pytest.mark.parametrize(
    ("triangles", "message"),
    [
        ([[0, 1, 2], [0, 2, 1]], "triangles: 0 and 1 lie on one side of their edge"),
        ([[0, 1, 1]], "number 0 has no area"),
        ([[0, 1, 9]], "expected corners 0 to 3"),
        ([[0, 1, 2], [0, 1, 3], [0, 1, 2]], "some edge has more"),
        ([[0.0, 1, 2]], "triangles: expected int values"),
        ([[0, 1, 2, 3]], r"triangles: expected shape \[T, 3\]"),
    ],
)
def test_bad_triangles_are_named(triangles, message):
    with pytest.raises(InputError, match=message):
        make_mesh(SQUARE, np.array(triangles))


def test_bad_files_and_outlines_are_named(tmp_path):
    with pytest.raises(InputError, match="no such mesh file"):
        load_mesh(tmp_path / "none.msh")
    (tmp_path / "text.msh").write_text("no mesh")
    with pytest.raises(InputError, match="not a mesh of gmsh"):
        load_mesh(tmp_path / "text.msh")
    meshio.Mesh(SQUARE, [("line", [[0, 1]])]).write(tmp_path / "line.vtu")
    with pytest.raises(InputError, match="pyramids, and no other cells, got line"):
        load_mesh(tmp_path / "line.vtu")
    with pytest.raises(
        InputError, match="part 'across': expected edges of the outline, 1 of 1 are not"
    ):
        make_mesh(SQUARE, np.array([[0, 1, 2], [0, 2, 3]]), {"across": np.array([[0, 2]])})
    with pytest.raises(InputError, match="sizes > 0"):
        mesh_outline(box(10, 10), size=-1)
    with pytest.raises(InputError, match="a name for each of 4 sides"):
        mesh_outline(Polygon(((0, 0), (1, 0), (1, 1), (0, 1)), ("a", "b")), size=1)


CELLS = [("line", [[0, 1], [1, 2]]), ("triangle", [[0, 1, 2], [0, 2, 3]])]


@pytest.mark.parametrize("suffix", ["vtu", "xdmf"])
def test_sets_that_a_format_lost_are_missed(tmp_path, suffix):
    points = np.column_stack([SQUARE, np.zeros(4)])
    meshio.Mesh(points, CELLS).write(tmp_path / f"square.{suffix}")
    with pytest.warns(UserWarning, match="none of the 2 lines in the file is in a group"):
        mesh = load(tmp_path / f"square.{suffix}")
    assert set(mesh.parts) == {REST}
