"""Files for other tools, read back."""

import sys

import meshio
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.crystal import crystals
from tests.support.clouds import cloud, cube, plain
from tests.support.problems import kernel, lattice, manufactured
from tests.support.told import assert_refused, refused
from warp_peri import Samples
from warp_peri.export import write_vtk
from warp_peri.materials.lps_operator import node_fields

HORIZON = 2.5
symmetric = lambda six: six[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2]]]
"""VTK's order of a symmetric tensor: XX, YY, ZZ, XY, YZ, XZ."""


@pytest.fixture
def points():
    return manufactured(kernel("positive", HORIZON), lattice(4, HORIZON), 2)


def test_fields_for_paraview(points, tmp_path, monkeypatch):
    """Into one folder as many as before are replaced; fewer, and others' files, are refused."""
    u, model = 1.01 * points.u, kernel("positive", HORIZON)
    write_vtk(tmp_path, model, points, points.u)
    paths = write_vtk(tmp_path, model, points, u)
    assert [path.name for path in paths] == ["sample_0000.vtu", "sample_0001.vtu"]
    fields, inside = node_fields(model, points, u), points.interior
    for s, path in enumerate(paths):
        mesh = meshio.read(path)
        corners = mesh.points[mesh.cells_dict["quad"]][:, :, :2]
        assert len(corners) == (round(np.sqrt(len(points.x))) - 1) ** 2
        assert_allclose(np.abs(np.diff(corners, axis=1)).sum(2), 1.0)
        data = mesh.point_data
        assert_array_equal(data["displacement"][:, :2], u[s])
        assert_allclose(data["error"][:, :2], 0.01 * points.u[s], atol=1e-12)
        assert_array_equal(data["energy"][inside], fields.energy[s])
        stress = symmetric(data["stress"][inside])
        assert_array_equal(stress[:, :2, :2], fields.stress[s])
        assert not stress[:, 2].any()
        assert np.isnan(data["stress"][~inside]).all()
    assert_refused({
        r"without samples .* got sample_0001\.vtu":
            lambda: write_vtk(tmp_path, model, points[:1], u[:1]),
        "u: expected values everywhere, got 1 of":
            lambda: write_vtk(tmp_path, model, points, np.ma.array(u, mask=np.arange(u.size) == 7)),
    })  # fmt: skip
    paths[1].write_text("another program's")
    with refused(r"without samples .* got sample_0001\.vtu"):
        write_vtk(tmp_path, model, points, u)
    assert paths[1].read_text() == "another program's"
    monkeypatch.setitem(sys.modules, "meshio", None)
    with refused(r"warp_peri\[export\]"):
        write_vtk(tmp_path, model, points, u)


def test_fields_in_space(tmp_path):
    """Bricks of eight nodes, and the stress of an affine field in all six components."""
    known = crystals.learned(3)
    points = cube(2, known.spacing, known.spacing)
    H = np.array([[1.0, 0.3, -0.2], [0.1, -0.4, 0.5], [0.7, 0.2, 0.6]])
    u = 1e-3 * points.x[None] @ H.T
    mesh = meshio.read(write_vtk(tmp_path, known, Samples(points, u, 0 * u), u)[0])
    corners = mesh.points[mesh.cells_dict["hexahedron"]]
    assert len(corners) == (round(len(points.x) ** (1 / 3)) - 1) ** 3
    edges = corners[:, [1, 3, 4]] - corners[:, :1]  # of VTK's hexahedron, right-handed
    assert_allclose(edges, np.tile(points.spacing * np.eye(3), (len(edges), 1, 1)))
    assert_allclose(corners[:, 6] - corners[:, 0], edges.sum(1))
    inside, strain = points.interior, 0.5e-3 * (H + H.T)
    assert_allclose(symmetric(mesh.point_data["strain"][inside])[0], strain)
    assert_allclose(mesh.point_data["dilatation"][inside], np.trace(strain))
    expected = np.einsum("ijkl,kl->ij", known.tensor(), strain)
    assert_allclose(symmetric(mesh.point_data["stress"][inside])[0], expected)


def test_scattered_points_stand_alone(tmp_path):
    points = Samples(cloud(3, 3.0), 0 * cloud(3, 3.0).x[None])
    (path,) = write_vtk(tmp_path, plain(3.0), points, points.u)
    assert list(meshio.read(path).cells_dict) == ["vertex"]
