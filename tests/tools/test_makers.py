"""What makes data: atoms at rest and in a bath, elements, and caches that an interruption keeps."""

import sys
from dataclasses import replace
from shutil import copy
from subprocess import run

import numpy as np
import pytest
from numpy import array, cos, pi, sin
from numpy.random import default_rng

import tools.make_graphene as tool
import warp_peri as wp
from tests.support import ROOT, approx, near, refused, sup, warned
from tests.support.nonlinear import strain
from tests.support.problems import difference, fitted_order, normal, slope
from tools import samples
from tools.elastic import elastic_constants
from tools.elements import errors_of_local, piola
from tools.graphene import bond_length, disk
from tools.hyperelastic_elements import Elements, square_mesh
from tools.hyperelastic_energies import Family, hgo
from tools.lammps_session import POTENTIAL, LammpsSession
from tools.loads import TEST, TRAINING, VALIDATION, PatchLoad, RimLoad, WaveLoad
from tools.make_hgo import Material, make_hgo, sample
from tools.make_thermal import make_thermal, settings
from tools.samples import Piece
from tools.statics import TOLERANCE, ColouredHessian, ConvergenceError, Statics
from tools.thermal import Bath, Task, graphene_plans, run_file
from warp_peri.atoms.calculators import potential_file
from warp_peri.core.elastic import plane_isotropic, voigt, voigt_to_tensor
from warp_peri.points.dataset import load_dataset
from warp_peri.points.points import grid_places


def test_graphene_is_made_once_and_a_load_that_fails_keeps_the_rest(tmp_path, monkeypatch, capsys):
    small = {"SHEET_CELLS": (8, 5), "DISK_RADIUS": 65.0, "REACH": 60.0, "TEST": [RimLoad(3)]}
    small |= {"TRAINING": [WaveLoad(0, (0, 1))], "VALIDATION": [PatchLoad(1, 0, 0, 8.0)]}
    for name, value in small.items():
        monkeypatch.setattr(tool, name, value)
    real, path = samples.solve, tmp_path / "g.h5"

    def fail(body, statics, load):
        if load.load_id == "table1-1":
            raise ConvergenceError("residual 1 eV/Å")
        return real(body, statics, load)

    monkeypatch.setattr(samples, "solve", fail)
    line = ["--out", str(path), "--jobs", "1", "--quiet"]
    assert tool.main(line) == 1
    assert capsys.readouterr().err.strip() == "make_graphene: error: residual 1 eV/Å"
    assert not path.exists()
    assert len(list((tmp_path / "g.cache").iterdir())) == 2
    solved = []
    monkeypatch.setattr(samples, "solve", lambda *one: solved.append(one[2]) or real(*one))
    assert tool.main(line) == 0
    assert solved == tool.VALIDATION
    data = load_dataset(path)
    assert sorted(data) == ["test", "test_fine", "train", "train_fine", "val", "val_fine"]
    assert max(one.arrays["residual"].max() for one in data.sets.values()) <= TOLERANCE
    assert data["train"].arrays["max_bond_strain"] == approx(samples.TRAINING_STRAIN, 1e-4)
    near(data.density, 2147, 2e-3)
    assert tool.main([*line, "--smoothing-radius", "9"]) == 2
    assert "g.h5: is there already, not by these settings" in capsys.readouterr().err
    truth = elastic_constants(bond_length())  # measured independently at 0 K
    assert [*truth.values()] == approx([-0.1972, 0.7223, 1.2163, -0.158], abs=1e-4)


def test_loads_push_and_turn_no_body_and_a_disk_at_rest_bears_them():
    x, bond = disk(1.460511, radius=10.0), 1.460511
    with LammpsSession(x, box=None) as session:
        statics = Statics(x, box=None, session=session)
        rest = statics.equilibrium(1e-3 * statics.reference @ [[1, 0.3], [-0.3, 0]], name="pull")
        assert sup(session.forces(statics.reference + rest.displacement) + rest.force) <= TOLERANCE
        assert sup(rest.force.sum(0)) < 1e-12
        at, way = statics.reference + 0.01 * sin(7 * x), cos(5 * x[:, ::-1])
        hessian = ColouredHessian(statics.bonds, len(x))(session.forces, at)
        change = session.forces(at - 1e-5 * way) - session.forces(at + 1e-5 * way)
        assert hessian @ way.ravel() == approx(change.ravel() / 2e-5, abs=1e-3)
        with pytest.raises(ConvergenceError, match="'too much'.*residual"):
            statics.equilibrium(50 * sin(statics.reference), name="too much")
    sheet = Piece(bond, str(potential_file(POTENTIAL)), cells=(39, 23))
    x, far = sheet.positions(), disk(bond)
    for load in (*TRAINING[::7], *VALIDATION[::3], *TEST):
        shape = load.shape(far if isinstance(load, RimLoad) else x, sheet.box)
        assert sup(shape.sum(0)) < 1e-12 * np.abs(shape).sum()
    assert (len(TRAINING), len(VALIDATION), len(TEST)) == (70, 10, 4)


def test_runs_of_one_seed_share_their_noise_and_have_their_temperature(tmp_path):
    body = Piece(bond_length(), str(potential_file(POTENTIAL)), cells=(8, 5))
    x, box, bath = body.positions(), array(body.box), Bath()
    wave, moved = WaveLoad(0, (1, 0)), []
    for seed, size in ((5, 0.0), (5, 1e-3), (6, 0.0)):
        with LammpsSession(x, box=body.box, potential=body.potential) as session:
            how = {"temperature": 300.0, "timestep": 0.0005, "damping": 0.1, "steps": 400}
            steps = session.trajectory(x, size * wave.shape(x, body.box), seed=seed, **how)
            moved.append(array([one[0].copy() for one in steps]))
    assert np.abs(moved[1] - moved[0])[-1].max() < 0.2 * np.abs(moved[2] - moved[0])[-1].max()
    step = np.diff(moved[0], axis=0)
    step -= box * np.rint(step / box)
    kelvin = 12.011 * 1.0364269656e-4 * (step[100:] / 0.0005) ** 2 / 8.617333262e-5
    near(kelvin.mean(), 300, 0.15)
    tasks = [Task(body, load, 1.0, seed) for load in (wave, None) for seed in (1, 2)]
    baths = bath, replace(bath, temperature=200.0)
    assert len({run_file(tmp_path, task, one).name for task in tasks for one in baths}) == 8


def test_elements_have_the_slopes_of_their_forces():
    random, mesh = default_rng(1), Elements(square_mesh("MeshQuad", 3))
    energy = hgo(0.33, 0.15, (Family(0.3, 0.1, 1.5), Family(-1.0, 0.2, 0.0)))
    u, v = 0.02 * random.normal(size=2 * mesh.nodes), random.normal(size=2 * mesh.nodes)
    expected = slope(lambda t: mesh.forces(mesh.state(energy, u + t * v)[0], u), 1e-6, order=2)
    assert mesh.stiffness(mesh.state(energy, u)[1]) @ v == approx(expected, rel=1e-5, abs=1e-7)


def test_elements_of_local_elasticity_are_of_fourth_order_in_the_wave_length():
    """And their error is 1e-4 already where a wave has ten nodes."""
    x, C = 5.0 * grid_places((19, 19)), voigt_to_tensor(np.diag([1.3, 0.9, 0.4]) + 0.1)
    points = wp.Points(x, (np.abs(x - 45.0) <= 15.1).all(1), 5.0)
    a, lengths, errors = array([0.02, -0.01]), array([6.0, 10.0, 14.0]), []
    for length in lengths:
        k = 2 * pi / (5.0 * length) * array([cos(0.4), sin(0.4)])
        wave = sin(x @ k + 0.3)[:, None]
        b = np.einsum("ijkl,j,l,k->i", C, k, k, a) * wave
        errors.append(errors_of_local(wp.Samples(points, (wave * a)[None], b[None]), voigt(C))[0])
    assert errors[1] < 1e-4
    assert -fitted_order(lengths, errors) > 3.8


def test_data_of_several_processes_resume_and_replace_no_others(here):
    def made(*words):
        line = [sys.executable, ROOT / "tools/make_hgo.py", "--counts", "2", "1", "0", "0", *words]
        return run([*line, "--jobs", "2", "--out", "a.v1"], capture_output=True, text=True)

    sample(here / "a.v1", Material(), "square", 1001)  # was solved before it stopped
    assert made().returncode == 0
    data, alone = load_dataset(here / "a.v1.h5"), make_hgo(here / "b", counts=(2, 1, 0, 0), jobs=1)
    assert all(np.array_equal(data[name].u, alone[name].u) for name in ("train", "val"))
    copy(*sorted((here / "b").iterdir())[:2])
    with warned("another's, or changed"):
        make_hgo(here / "b", counts=(2, 1, 0, 0), jobs=1)
    assert "a.v1.h5: is there already, not by these" in made("--seed", "7").stderr
    assert "a.v1.h5 is there already" in made().stdout
    wp.save("graphene_300K_plain_f1.h5", replace(data, provenance=settings(Bath(), "plain", 1, 0)))
    for other in ({"bath": Bath(iota=0.1)}, {"plans": graphene_plans()[:1]}):
        with refused("f1.h5: is there already"):
            make_thermal(here, reductions=["plain"], **other)


def test_third_order_elements_have_the_stress_of_their_energy():
    third, isotropic = (-0.5, -6.8, 1.04), voigt_to_tensor(plane_isotropic(0.3, 0.7))
    H = 0.1 * normal((2, 2))

    def energy(flat):
        E, t, q = strain(flat.reshape(2, 2))
        cubic = third[0] * t**3 + third[1] * t * abs(q) ** 2 + third[2] * (q**3).real
        return np.einsum("ij,ijkl,kl", E, isotropic, E) / 2 + cubic

    expected = difference(energy, H.ravel(), 1e-5, order=2)
    assert piola(H, isotropic, third).ravel() == approx(expected, abs=1e-8)
