"""Files are written whole or not at all, and read back by other tools; units are the file's."""

import os
import sys
from json import dumps
from stat import S_IMODE, S_ISCHR

import meshio
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.crystal import crystals
from tests.support import assert_refused, of_json, refused, warned
from tests.support.clouds import cloud, cube, plain
from tests.support.problems import kernel, lattice, manufactured
from warp_peri import Samples, load
from warp_peri.diffusion import DiffusionMaterial
from warp_peri.export import write_vtk
from warp_peri.files.atomic import whole_file, write_json, write_text
from warp_peri.materials.lps_operator import node_fields

symmetric = lambda six: six[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2]]]
"""VTK's order of a symmetric tensor: XX, YY, ZZ, XY, YZ, XZ."""


def test_a_file_appears_whole_under_its_name_with_common_rights(tmp_path):
    path = tmp_path / "new folder" / "a.txt"
    write_text(path, "β\n")
    mask = os.umask(0)
    os.umask(mask)
    assert S_IMODE(path.stat().st_mode) == 0o666 & ~mask
    with whole_file(path) as temporary:
        temporary.write_text("new")
        assert path.read_text(encoding="utf-8") == "β\n"
    assert path.read_text() == "new"
    assert list(path.parent.iterdir()) == [path]


def test_json_takes_numpy_and_refuses_what_is_no_number(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"a": np.arange(3), "b": (np.float64(0.1), {"c": np.bool_(True)})})
    assert of_json(path) == {"a": [0, 1, 2], "b": [0.1, {"c": True}]}
    with pytest.raises(ValueError, match="JSON compliant"):
        write_json(path, {"a": np.array([np.inf])})
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_and_what_is_no_regular_file_is_left_alone(tmp_path):
    link, pipe, device, folder, circle = (tmp_path / name for name in "lpdfc")
    link.symlink_to(tmp_path / "new" / "far.txt")
    write_text(link, "far")
    assert link.is_symlink()
    assert (tmp_path / "new" / "far.txt").read_text() == "far"
    os.mkfifo(pipe)
    device.symlink_to(os.devnull)
    folder.mkdir()
    circle.symlink_to(circle)
    for path in (pipe, device, folder, circle):
        before = os.lstat(path)
        with refused(r": (expected a file or a new name, got|cannot be)"):
            write_text(path, "text")
        assert os.lstat(path) == before
    assert S_ISCHR(os.stat(os.devnull).st_mode)


def test_files_without_units_say_that_they_are_taken_for_granted(tmp_path):
    path = tmp_path / "kept.json"
    DiffusionMaterial(3.0, 2.0, 1.3, [1.0, 0.4], ("mm", "GPa")).save(path)
    content = of_json(path)
    bare = {key: value for key, value in content.items() if not key.endswith(("_unit", "sha256"))}
    path.write_text(dumps(bare))
    with warned(r"kept.json: it names no units: taken as Å and TPa"):
        found = load(path)
    assert found.units == ("angstrom", "TPa")
    path.write_text(dumps({**bare, "length_unit": "mm"}))
    with refused("stress_unit: expected one of"):
        load(path)


def test_fields_for_paraview(tmp_path, monkeypatch):
    """Into one folder as many as before are replaced; fewer, and others' files, are refused."""
    model = kernel("positive", 2.5)
    points = manufactured(model, lattice(4, 2.5), 2)
    u = 1.01 * points.u
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
