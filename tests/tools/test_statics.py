"""Atoms at rest: LAMMPS forces, their Hessian, equilibria and elastic constants."""

import numpy as np
import pytest

from tools.elastic import STRAIN, elastic_constants
from tools.graphene import THICKNESS, area_per_atom, bond_length, disk, sheet
from tools.lammps_session import CARBON_MASS, LammpsSession
from tools.loads import EV_PER_CUBIC_ANGSTROM, WaveLoad, atom_force
from tools.statics import TOLERANCE, ColouredHessian, ConvergenceError, Statics, find_bonds
from warp_peri.atoms.calculators import LammpsError, potential_file


@pytest.fixture(scope="module")
def bond():
    return bond_length()


@pytest.fixture(scope="module")
def small_sheet(bond):
    positions, box = sheet(bond, cells=(8, 5))
    with LammpsSession(positions, box=box) as session:
        yield Statics(positions, box=box, session=session), session, box


@pytest.fixture(scope="module")
def small_disk(bond):
    positions = disk(bond, radius=15.0)
    with LammpsSession(positions, box=None) as session:
        yield Statics(positions, box=None, session=session), session, positions


def test_bond_length_minimises_energy(bond):
    """SiC_1989 gives the paper's 1.46 Å; energy per atom rises on both sides."""
    assert bond == pytest.approx(1.460511, abs=2e-6)
    energy = []
    for trial in (bond - 1e-3, bond, bond + 1e-3):
        positions, box = sheet(trial, cells=(3, 2))
        with LammpsSession(positions, box=box) as session:
            session.forces(positions)
            energy.append(session.energy())
    assert energy[1] < min(energy[0], energy[2])


def test_forces_are_minus_the_gradient_of_energy(small_sheet):
    statics, session, _ = small_sheet
    rng = np.random.default_rng(0)
    positions = statics.reference + 0.02 * rng.standard_normal(statics.reference.shape)
    way, step = rng.standard_normal(positions.shape), 1e-5
    forces = session.forces(positions)
    energies = []
    for sign in (1, -1):
        session.forces(positions + sign * step * way)
        energies.append(session.energy())
    slope = (energies[0] - energies[1]) / (2 * step)
    assert slope == pytest.approx(-np.vdot(forces, way), rel=1e-6)


@pytest.mark.parametrize("body", ["small_sheet", "small_disk"])
def test_hessian_times_vector_is_a_difference_of_forces(body, request):
    statics, session, _ = request.getfixturevalue(body)
    rng = np.random.default_rng(1)
    positions = statics.reference + 0.01 * rng.standard_normal(statics.reference.shape)
    hessian = ColouredHessian(statics.bonds, len(positions))(session.forces, positions)
    for _ in range(3):
        way, step = rng.standard_normal(positions.shape), 1e-5
        change = session.forces(positions - step * way) - session.forces(positions + step * way)
        expected = change.ravel() / (2 * step)
        error = np.abs(hessian @ way.ravel() - expected).max() / np.abs(expected).max()
        assert error < 1e-5  # a coupling left out would show at 1e-2


def test_sheet_equilibrium(small_sheet, bond):
    """Internal forces, evaluated afresh, cancel the load; the response is odd in the load."""
    statics, session, box = small_sheet
    shape = WaveLoad(0, (1, 1)).shape(statics.reference, box)
    force = atom_force(0.01 * shape, area_per_atom(bond), THICKNESS)
    rest = statics.equilibrium(force, name="wave")
    left = session.forces(statics.reference + rest.displacement) + rest.force
    assert np.abs(left).max() <= TOLERANCE
    assert np.abs(rest.displacement.mean(axis=0)).max() < 1e-12
    linear = statics.linear_response(force)
    assert np.linalg.norm(rest.displacement - linear) < 0.05 * np.linalg.norm(linear)
    assert np.linalg.norm(rest.displacement - linear) > 1e-6 * np.linalg.norm(linear)


def test_free_disk_is_relaxed_and_does_not_move_as_a_whole(small_disk):
    statics, session, built = small_disk
    assert np.abs(session.forces(built)).max() > 1.0
    assert np.abs(session.forces(statics.reference)).max() <= TOLERANCE
    # A stretch with a push and a turn on top: both must be taken out.
    x, y = statics.reference.T
    force = 1e-3 * np.stack([x + 0.5 - 0.3 * y, 0.2 + 0.3 * x], axis=1)
    rest = statics.equilibrium(force, name="stretch")
    now = statics.reference + rest.displacement
    assert np.abs(session.forces(now) + rest.force).max() <= TOLERANCE
    assert np.abs(rest.force.sum(axis=0)).max() < 1e-12
    torque = now[:, 0] * rest.force[:, 1] - now[:, 1] * rest.force[:, 0]
    assert abs(torque.sum()) < 1e-9 * np.abs(torque).sum()
    turn = x * rest.displacement[:, 1] - y * rest.displacement[:, 0]
    assert abs(turn.sum()) < 1e-9 * np.abs(turn).sum()


def test_every_atom_of_the_disk_has_two_neighbours(bond):
    positions = disk(bond, radius=15.0)
    neighbours = np.bincount(find_bonds(positions, None).ravel(), minlength=len(positions))
    assert set(neighbours) == {2, 3}


def test_impossible_load_is_named(small_sheet):
    statics, _, box = small_sheet
    force = 50 * WaveLoad(0, (1, 0)).shape(statics.reference, box)
    with pytest.raises(ConvergenceError, match="'too much'.*residual"):
        statics.equilibrium(force, name="too much")


def test_elastic_constants(bond):
    """λ = −0.1972, μ = 0.7223, E = 1.2163 TPa, ν = −0.158, measured independently at 0 K."""
    truth = elastic_constants(bond)
    assert truth["lambda"] == pytest.approx(-0.1972, abs=1e-4)
    assert truth["mu"] == pytest.approx(0.7223, abs=1e-4)
    assert truth["E"] == pytest.approx(1.2163, abs=1e-4)
    assert truth["nu"] == pytest.approx(-0.158, abs=1e-3)


def test_long_wave_feels_the_elastic_constants(bond):
    """(λ + 2μ) k² is the load over the displacement of a long compression wave."""
    positions, box = sheet(bond, cells=(60, 2))
    load = WaveLoad(0, (1, 0))
    shape, k = load.shape(positions, box), np.linalg.norm(load.wave_vector(box))
    with LammpsSession(positions, box=box) as session:
        statics = Statics(positions, box=box, session=session)
        u = statics.linear_response(atom_force(shape, area_per_atom(bond), THICKNESS))
    truth = elastic_constants(bond)
    modulus = np.vdot(shape, shape) / np.vdot(shape, u) / k**2
    assert modulus == pytest.approx(truth["lambda"] + 2 * truth["mu"], rel=1e-3)


def test_stress_is_the_derivative_of_energy(bond):
    """σ · thickness · area · ε = dE for a stretch along x that LAMMPS does not relax."""
    energies, stresses = [], []
    for sign in (1, -1):
        positions, box = sheet(bond, cells=(3, 2))
        stretch = np.array([1.01 + sign * STRAIN, 1.0])
        sides = (box[0] * stretch[0], box[1])
        with LammpsSession(positions * stretch, box=sides) as session:
            session.forces(positions * stretch)
            energies.append(session.energy())
            stresses.append(session.membrane_stress()[0, 0])
    slope = (energies[0] - energies[1]) / (2 * STRAIN)
    assert np.mean(stresses) * box[0] * box[1] == pytest.approx(slope, rel=1e-5)


def test_units_of_an_atom_force():
    """1 TPa/Å on 2 Å² × 3.35 Å is 6.7 TPa Å², and 1 eV/Å³ is 0.16 TPa."""
    force = atom_force(np.array([1.0]), area=2.0, thickness=3.35)
    assert force == pytest.approx(6.7e12 * 1e-20 / 1.602176634e-19 * 1e-10)
    assert EV_PER_CUBIC_ANGSTROM == 0.1602176634
    assert pytest.approx(12.011, abs=0.01) == CARBON_MASS


def test_missing_potential_is_named(tmp_path):
    positions, box = sheet(1.46, cells=(3, 2))
    with pytest.raises(FileNotFoundError, match="nowhere.tersoff"):
        LammpsSession(positions, box=box, potential=tmp_path / "nowhere.tersoff")
    with pytest.raises(FileNotFoundError, match="no_such.tersoff"):
        potential_file("no_such.tersoff")


def test_lammps_errors_keep_their_words(tmp_path):
    positions, box = sheet(1.46, cells=(3, 2))
    broken = tmp_path / "broken.tersoff"
    broken.write_text("C C C 1 2 3\n")
    with pytest.raises(LammpsError, match="LAMMPS failed: ERROR"):
        LammpsSession(positions, box=box, potential=broken)


@pytest.mark.parametrize(
    ("positions", "box"),
    [([[0.0, np.nan]], None), ([[0.0, 0.0, 0.0]], None), ([[0.0, 0.0]], (np.inf, 1.0))],
)
def test_only_finite_numbers_reach_lammps(positions, box):
    with pytest.raises(ValueError, match="expected"):
        LammpsSession(np.array(positions), box=box)
