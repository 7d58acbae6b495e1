"""Runs at a finite temperature: dynamics, reductions, constants, and what a killed tool keeps."""

import dataclasses

import numpy as np
import pytest

import tools.make_graphene as graphene
import tools.make_thermal as tool
from tests.support.thermal import BATH, small_plans, small_sheet
from tools.graphene import THICKNESS, area_per_atom
from tools.lammps_session import CARBON_MASS, LammpsSession
from tools.loads import PatchLoad, WaveLoad, atom_force
from tools.make_thermal import long_wave_constants
from tools.thermal import Task, run_file, settled

BOLTZMANN = 8.617333262e-5  # eV/K
EV_PER_AMU_SQUARE_ANGSTROM_PER_PS = 1.0364269656e-4


@pytest.fixture(scope="module")
def sheet():
    return small_sheet()


@pytest.fixture
def plans(sheet, monkeypatch):
    monkeypatch.setattr(graphene, "REACH", 60.0)
    return small_plans(sheet)


def make(folder, plans, **options):
    return tool.make_thermal(
        folder, bath=BATH, plans=plans, jobs=1, progress=False, **{"factors": [0.5], **options}
    )


def trajectory(body, seed, force=0.0, steps=200):
    positions = body.positions()
    with LammpsSession(positions, box=body.box, potential=body.potential) as session:
        steps = session.trajectory(
            positions,
            np.zeros_like(positions) + force,
            temperature=300.0,
            seed=seed,
            steps=steps,
            timestep=0.0005,
            damping=0.1,
        )
        return np.array([np.stack(step) for step in steps])


def test_the_bath_has_its_temperature_and_does_not_push_the_sheet(sheet):
    x = trajectory(sheet, 1, steps=600)[:, 0]
    box = np.array(sheet.box)
    move = np.diff(x, axis=0)
    move -= box * np.rint(move / box)
    kinetic = CARBON_MASS * EV_PER_AMU_SQUARE_ANGSTROM_PER_PS * (move / 0.0005) ** 2
    temperature = kinetic[200:].mean() / BOLTZMANN
    assert temperature == pytest.approx(300, rel=0.1)
    assert np.abs(move.sum(axis=1)).max() < 1e-9


def test_a_seed_decides_every_bit_and_noise_is_shared(sheet):
    once, again, other = (trajectory(sheet, seed) for seed in (5, 5, 6))
    assert np.array_equal(once, again)
    wave = WaveLoad(0, (1, 0)).shape(sheet.positions(), sheet.box)
    pushed = trajectory(sheet, 5, 1e-3 * wave)
    apart = np.abs(once[-1, 0] - other[-1, 0])
    together = np.abs(once[-1, 0] - pushed[-1, 0])
    assert together.max() < 0.2 * apart.max()


def test_a_run_is_known_by_all_that_decides_it(sheet, tmp_path):
    task = Task(sheet, WaveLoad(0, (1, 0)), 1.0, 1)
    names = {
        run_file(tmp_path, other, bath).name
        for other in (
            task,
            dataclasses.replace(task, seed=2),
            dataclasses.replace(task, factor=0.5),
            dataclasses.replace(task, load=None),
        )
        for bath in (BATH, dataclasses.replace(BATH, temperature=200.0))
    }
    assert len(names) == 8


def test_rigid_motion_is_removed_and_nothing_else(sheet):
    disk = dataclasses.replace(sheet, cells=None, radius=30.0)
    x = disk.positions()
    rigid = np.array([0.3, -0.1]) + 0.01 * np.stack([-x[:, 1], x[:, 0]], axis=1)
    assert np.abs(settled(disk, x, rigid)).max() < 1e-14
    stretch = settled(disk, x, 0.01 * x)
    assert np.allclose(settled(disk, x, stretch + rigid), stretch, atol=1e-14)
    # A sheet cannot turn.
    x = sheet.positions()
    turned = settled(sheet, x, 0.01 * np.stack([-x[:, 1], x[:, 0]], axis=1))
    assert np.abs(turned).max() > 0.1


def test_constants_of_a_solid_that_is_known(sheet):
    lame, mu = -0.2, 0.7
    x, box = sheet.positions(), np.array(sheet.box)
    loads = [WaveLoad(axis, waves) for axis in (0, 1) for waves in ((1, 0), (0, 1), (1, 1))]
    u, force = [], []
    for load in loads:
        k = 2 * np.pi * np.array(load.waves) / box
        own, other = k[load.axis] ** 2, k[1 - load.axis] ** 2
        matrix = [
            [(lame + 2 * mu) * own + mu * other, -(lame + mu) * k.prod()],
            [-(lame + mu) * k.prod(), mu * own + (lame + 2 * mu) * other],
        ]
        U, V = np.linalg.solve(matrix, [0.001, 0])
        field = np.empty_like(x)
        field[:, load.axis] = U * np.cos(k * x).prod(axis=1)
        field[:, 1 - load.axis] = V * np.sin(k * x).prod(axis=1)
        u.append(field)
        density = 0.001 * load.shape(x, sheet.box)
        force.append(atom_force(density, area_per_atom(sheet.bond), THICKNESS))
    constants = long_wave_constants(sheet, x, loads, np.stack(u), np.stack(force))
    assert constants["lambda"] == pytest.approx(lame, abs=1e-9)
    assert constants["mu"] == pytest.approx(mu, abs=1e-9)
    with pytest.raises(ValueError, match="WaveLoad"):
        long_wave_constants(sheet, x, [PatchLoad(1, 0, 0, 8.0)], np.stack(u[:1]), force[0][None])


@pytest.mark.parametrize(
    "words", [["--factors", "0"], ["--steps", "1000"], ["--iota", "2"], ["--temperature", "-3"]]
)
def test_values_without_sense_are_refused(words, tmp_path, capsys):
    assert tool.main(["--out", str(tmp_path), *words]) == 2
    assert "expected" in capsys.readouterr().err
