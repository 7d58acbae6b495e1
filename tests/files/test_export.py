"""Files for other tools, read back."""

import sys
from dataclasses import replace

import meshio
import numpy as np
import pytest

from tests.crystal import crystals
from tests.support.clouds import cloud, plain
from tests.support.cubes import cube, solid
from tests.support.problems import kernel, lattice, manufactured
from warp_peri import InputError, Samples
from warp_peri.export import write_vtk
from warp_peri.materials.certificate import certify
from warp_peri.materials.lps_matrices import node_fields

HORIZON = 2.5


@pytest.fixture
def model():
    return kernel("positive", HORIZON)


@pytest.fixture
def points(model):
    return manufactured(model, lattice(4, HORIZON), 2)


def test_fields_for_paraview(model, points, tmp_path):
    u = 1.01 * points.u
    paths = write_vtk(tmp_path, model, points, u)
    assert [path.name for path in paths] == ["sample_0000.vtu", "sample_0001.vtu"]
    fields = node_fields(model, points, u)
    inside = points.interior
    for s, path in enumerate(paths):
        mesh = meshio.read(path)
        side = round(np.sqrt(len(points.x)))
        assert len(mesh.cells_dict["quad"]) == (side - 1) ** 2
        corners = mesh.points[mesh.cells_dict["quad"]][:, :, :2]
        edge = np.diff(corners, axis=1)
        np.testing.assert_allclose(np.abs(edge).sum(axis=2), 1.0)  # around, not across
        data = mesh.point_data
        np.testing.assert_array_equal(data["displacement"][:, :2], u[s])
        np.testing.assert_allclose(data["error"][:, :2], 0.01 * points.u[s], atol=1e-12)
        for name, tensor in (("stress", fields.stress[s]), ("strain", fields.strain[s])):
            np.testing.assert_array_equal(symmetric(data[name][inside])[:, :2, :2], tensor)
            assert not symmetric(data[name][inside])[:, 2].any()
            assert np.isnan(data[name][~inside]).all()
        np.testing.assert_array_equal(data["energy"][inside], fields.energy[s])


def symmetric(six):
    """VTK's order of a symmetric tensor: XX, YY, ZZ, XY, YZ, XZ."""
    return six[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2]]]


def test_refused_folders(model, points, tmp_path):
    write_vtk(tmp_path, model, points, points.u)
    single = replace(points, u=points.u[:1], b=points.b[:1])
    with pytest.raises(InputError, match=r"without samples .* got sample_0001\.vtu"):
        write_vtk(tmp_path, model, single, single.u)
    write_vtk(tmp_path, model, points, points.u)  # as many as before: they are replaced


@pytest.mark.parametrize("law", ["linear solid", "crystal"])
def test_fields_in_space(law, tmp_path):
    """Bricks of eight nodes, and the stress of an affine field in all six components."""
    known = crystals.learned(3)
    material, reach = (solid(2.0), 2.0) if law == "linear solid" else (known, 1.0)
    points = cube(2, reach * known.spacing, known.spacing) if law == "crystal" else cube(2, reach)
    H = np.array([[1.0, 0.3, -0.2], [0.1, -0.4, 0.5], [0.7, 0.2, 0.6]])
    u = 1e-3 * points.x[None] @ H.T
    points = Samples(points, u, 0 * u)
    paths = write_vtk(tmp_path, material, points, u)
    mesh = meshio.read(paths[0])
    side = round(len(points.x) ** (1 / 3))
    corners = mesh.points[mesh.cells_dict["hexahedron"]]
    assert len(corners) == (side - 1) ** 3
    edges = corners[:, [1, 3, 4]] - corners[:, :1]  # of VTK's hexahedron, right-handed
    np.testing.assert_allclose(edges, np.tile(points.spacing * np.eye(3), (len(edges), 1, 1)))
    np.testing.assert_allclose(corners[:, 6] - corners[:, 0], edges.sum(axis=1))
    inside, strain = points.interior, 0.5e-3 * (H + H.T)
    np.testing.assert_allclose(symmetric(mesh.point_data["strain"][inside])[0], strain)
    np.testing.assert_allclose(mesh.point_data["dilatation"][inside], np.trace(strain))
    expected = (
        node_fields(material, points, u).stress[0, 0]
        if law == "linear solid"
        else np.einsum("ijkl,kl->ij", known.tensor(), strain)
    )
    np.testing.assert_allclose(symmetric(mesh.point_data["stress"][inside])[0], expected)
    assert np.abs(expected[[1, 0], [2, 2]]).min() > 0  # YZ and XZ


def test_scattered_points_stand_alone(tmp_path):
    points = cloud(3, 3.0)
    u = np.zeros((1, len(points.x), 2))
    points = Samples(points, u)
    (path,) = write_vtk(tmp_path, plain(3.0), points, u)
    assert list(meshio.read(path).cells_dict) == ["vertex"]


@pytest.mark.filterwarnings("ignore:transferred:UserWarning")
def test_on_another_lattice_stress_is_by_the_kernel_that_is_solved_with(tmp_path):
    home = kernel("positive", HORIZON)
    home = replace(home, certificate={"1": certify(home, spacing=1.0).figures()})
    points = lattice(6, HORIZON, spacing=0.8)
    there = home.on(points)
    u = 1e-3 * np.stack([points.x[:, 0] ** 2, points.x[:, 0] * points.x[:, 1]], axis=-1)[None]
    samples = Samples(points, u, 0 * u)
    (path,) = write_vtk(tmp_path, home, samples, u)
    found = meshio.read(path).point_data
    wanted = node_fields(there.model, points, u)
    stress = symmetric(found["stress"][points.interior])[:, :2, :2]
    np.testing.assert_allclose(stress, wanted.stress[0], rtol=1e-12, atol=1e-16)
    np.testing.assert_allclose(found["energy"][points.interior], wanted.energy[0], rtol=1e-12)


def test_a_missing_extra_is_named(model, points, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "meshio", None)
    with pytest.raises(InputError, match=r"warp_peri\[export\]"):
        write_vtk(tmp_path, model, points, points.u)
