"""Files for other tools, read back."""

import sys

import meshio
import numpy as np
import pytest
import scipy.sparse as sp

from tests.clouds import cloud, plain
from tests.problems import kernel, lattice, manufactured
from warp_peri import Dataset, InputError, LPSOperator, save_dataset, solve
from warp_peri.__main__ import main
from warp_peri.export import write_fields, write_influence, write_operator
from warp_peri.families import bond_classes
from warp_peri.stress import node_fields
from warp_peri.symbol import stiffnesses

HORIZON = 2.5


@pytest.fixture
def model():
    return kernel("two functions", HORIZON)


@pytest.fixture
def points(model):
    return manufactured(model, lattice(4, HORIZON), 2)


def test_fields_for_paraview(model, points, tmp_path):
    u = 1.01 * points.u
    paths = write_fields(tmp_path, model, points, u)
    assert [path.name for path in paths] == ["sample_0000.vtu", "sample_0001.vtu"]
    found = node_fields(model, points, u)
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
        np.testing.assert_array_equal(data["stress_xy"][inside], found.stress[s, :, 0, 1])
        np.testing.assert_array_equal(data["energy"][inside], found.energy[s])
        assert np.isnan(data["strain_xx"][~inside]).all()


def test_scattered_points_stand_alone(tmp_path):
    points = cloud(3, 3.0)
    u = np.zeros((1, len(points.x), 2))
    points = type(points)(points.x, points.interior, 0.0, u=u)
    (path,) = write_fields(tmp_path, plain(3.0), points, u)
    assert list(meshio.read(path).cells_dict) == ["vertex"]


def test_the_table_holds_what_enters_the_model(model, tmp_path):
    path = write_influence(tmp_path / "K.csv", model, 1.0)
    r, bonds, K, over_m, over_m_dilatation, W = np.loadtxt(path, delimiter=",", skiprows=3).T
    classes = bond_classes(1.0, HORIZON)
    v, z, _ = stiffnesses(model, classes)
    np.testing.assert_allclose(model.mu * over_m * W, v, rtol=1e-14)
    np.testing.assert_allclose(model.mu * over_m_dilatation * W, z, rtol=1e-14)
    np.testing.assert_array_equal(r, classes.r)
    np.testing.assert_array_equal(bonds, classes.count)
    np.testing.assert_allclose(K, model.influence(r), rtol=1e-14)


def test_the_matrix_is_the_operator(model, points, tmp_path):
    L = sp.load_npz(write_operator(tmp_path / "L.npz", model, points))
    force = LPSOperator(model, points)(points.u)
    found = (L @ points.u.reshape(2, -1).T).T.reshape(force.shape)
    np.testing.assert_allclose(found, force, atol=1e-12 * np.abs(force).max())


def test_the_command(model, points, tmp_path, capsys):
    model.save(tmp_path / "m.json")
    save_dataset(tmp_path / "d.h5", Dataset({"test": points}, 3.35, 2200.0))
    m, d = str(tmp_path / "m.json"), str(tmp_path / "d.h5")
    assert main(["export", "fields", m, "--data", d, "--out", str(tmp_path / "vtu")]) == 0
    mesh = meshio.read(tmp_path / "vtu" / "sample_0001.vtu")
    u = solve(model, points, points.b, points.u)
    np.testing.assert_allclose(mesh.point_data["displacement"][:, :2], u[1], atol=1e-12)
    assert main(["export", "influence", m, "--out", str(tmp_path / "K.csv")]) == 0
    assert main(["export", "operator", m, "--data", d, "--out", str(tmp_path / "L.npz")]) == 0
    capsys.readouterr()
    assert main(["export", "operator", m, "--out", str(tmp_path / "L.npz")]) == 2
    assert "needs the nodes of a data file" in capsys.readouterr().err


def test_a_missing_extra_is_named(model, points, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "meshio", None)
    with pytest.raises(InputError, match=r"warp_peri\[export\]"):
        write_fields(tmp_path, model, points, points.u)
