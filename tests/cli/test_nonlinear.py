"""The command on a nonlinear model."""

import json

import numpy as np
import pytest

from tests.support.nonlinear import solid
from tests.support.problems import lattice
from tests.support.solving import solve_nonlinear
from tests.third_order.test_equilibria import problem
from warp_peri import Dataset, Samples
from warp_peri.cli.main import main
from warp_peri.points.dataset import load_dataset, save_dataset


@pytest.fixture
def files(tmp_path):
    """A model and a set that it answers exactly."""
    model = solid("energy")
    points, u, b = problem(model, 0.004)
    model.save(tmp_path / "m.json")
    save_dataset(
        tmp_path / "d.h5", Dataset({"test": Samples(points, u[None], b[None])}, 3.35, 2200.0)
    )
    return tmp_path, model, points, u


def printed(capsys, *words):
    assert main([*map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_evaluate_certify_info_and_solve(files, capsys):
    folder, model, _, u = files
    table = printed(capsys, "evaluate", folder / "m.json", folder / "d.h5")["test"]
    assert table["E_u"] < 1e-6
    assert table["unique"] is True
    assert table["linear_solves"] < 12
    proof = printed(capsys, "certify", folder / "m.json")["1 Å"]["nonlinear"]
    assert proof["strain"] == pytest.approx(model.proven_strain(1.0))
    about = printed(capsys, "info", folder / "m.json")
    assert (about["t3"], about["form"]) == (model.t3, "energy")
    words = ("--set", "test", "--out", folder / "solved.h5")
    printed(capsys, "solve", folder / "m.json", folder / "d.h5", *words)
    solved = load_dataset(folder / "solved.h5")["test"].u[0]
    assert np.abs(solved - u).max() <= 1e-6 * np.abs(u).max()


def test_export_has_the_stress_of_the_energy(files, capsys):
    meshio = pytest.importorskip("meshio")
    folder, model, points, u = files
    out = folder / "fields"
    words = (folder / "d.h5", "--set", "test", "--out", out)
    assert printed(capsys, "export", folder / "m.json", *words)["files"]
    stress = meshio.read(out / "sample_0000.vtu").point_data["stress"]
    expected = model.on(points).stress(u)
    inside = stress[points.interior]
    np.testing.assert_allclose(inside[:, :2], expected[:, [0, 1], [0, 1]], rtol=1e-5)


@pytest.mark.filterwarnings("ignore:transferred")
def test_a_finer_lattice_exports_what_it_solves(files, capsys):
    meshio = pytest.importorskip("meshio")
    folder, model, *_ = files
    points = lattice(4, model.horizon, spacing=0.7)
    u = 0.02 * np.stack([np.sin(points.x[:, 1]), np.cos(2 * points.x[:, 0])], axis=1)
    fine = Dataset({"fine": Samples(points, u[None], 0 * u[None])}, 3.35, 2200.0)
    save_dataset(folder / "fine.h5", fine)
    words = (folder / "m.json", folder / "fine.h5", "--set", "fine")
    printed(capsys, "export", *words, "--out", folder / "fields")
    exported = meshio.read(folder / "fields" / "sample_0000.vtu").point_data["displacement"][:, :2]
    solved = solve_nonlinear(model, points, 0 * u, u)
    assert np.abs(exported - solved).max() < 1e-9


@pytest.mark.filterwarnings("ignore:transferred")
def test_a_transferred_model_is_certified_on_its_own_lattice(files, capsys):
    folder, model, *_ = files
    fine = model.at(lattice(4, model.horizon, spacing=0.75))
    fine.save(folder / "fine.json")
    proof = printed(capsys, "certify", folder / "fine.json")["0.75 Å"]["nonlinear"]
    assert proof["strain"] == pytest.approx(fine.proven_strain(0.75))
