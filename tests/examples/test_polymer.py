"""Polymer flow: dumbbells, laws, plates and a channel against what is exact."""

import numpy as np
import pytest
from numpy import array, cos, eye, sin, sqrt, zeros
from numpy.linalg import norm
from numpy.random import default_rng
from scipy.linalg import expm
from scipy.optimize import check_grad

from examples import polymer
from examples.exact import couette, oscillation, poiseuille, relative_error
from examples.polymer import Closure, CoupledDumbbells, Dumbbells, PlaneFlow, homogeneous, simulate
from examples.polymer.closure import exact_pairs, reached
from examples.polymer.dumbbells import propagator
from examples.polymer.gaussian_process import fit_process, unlikelihood
from examples.polymer.particles import ChannelFlow, Particles
from tests.support import approx, near, parametrize, refused, sup
from tests.support.problems import fitted_order

MAXWELL = polymer.UpperConvectedMaxwell()


def test_a_step_of_dumbbells_is_exact_in_its_moments():
    K, dt = array([0.3, 2.0, 0.5, -0.3]), 0.7
    A = [[0.3, 2.0], [0.5, -0.3]] - eye(2) / 2
    E = expm(np.block([[-A, eye(2)], [zeros((2, 2)), A.T]]) * dt)
    P, L = propagator(K[None], dt)
    lower = array([[L[0, 0], 0], [L[0, 1], L[0, 2]]])
    assert sup(P[0, :4].reshape(2, 2) - E[2:, 2:].T) < 1e-14
    assert sup(lower @ lower.T - E[2:, 2:].T @ E[:2, 2:]) < 1e-11
    assert P[0, 4] ** 2 + L[0, 3] ** 2 == approx(1, abs=1e-14)


def test_ensembles_follow_the_exact_law_and_any_threads_give_the_same_bits(threads):
    count, K = 40_000, polymer.mixed(8, 12, 1.0, hold=3, seed=2)
    record = simulate(Dumbbells(8, count, seed=1), K, 0.25)
    exact = homogeneous(MAXWELL, K, 0.25, parts=200)
    xx, xy, yy, zz = np.moveaxis(exact, -1, 0)
    deviation = sqrt(np.stack([2 * xx**2, xx * yy + xy**2, 2 * yy**2, 2 * zz**2], -1) / count)
    error = (record.C - exact) / deviation
    assert sup(error) < 4.5  # of 416 normal numbers
    assert 0.8 < sqrt(np.mean(error**2)) < 1.2
    threads(3)
    near(simulate(Dumbbells(8, count, seed=1), K[:2], 0.25).C, record.C[:3], 0)


@parametrize("kernel", ["product", "additive"])
def test_a_process_finds_its_function_and_its_likelihood_has_the_right_slope(kernel):
    random = default_rng(0)
    X = random.normal(size=(60, 2))
    y = sin(X[:, 0]) + X[:, 1] ** 2 / 4 + 1e-3 * random.normal(size=60)
    process = fit_process(X, y, kernel=kernel)
    new = random.uniform(-1, 1, (50, 2))
    assert sup(process(new) - sin(new[:, 0]) - new[:, 1] ** 2 / 4) < 0.05
    given = X[:20], y[:20], kernel, None
    value, slope = (lambda t, n=n: unlikelihood(t, *given)[n] for n in (0, 1))
    theta = array([0.1, 0.3, -0.2, -2.0])
    assert check_grad(value, slope, theta, epsilon=1e-6) < 1e-4 * norm(slope(theta))


def test_a_plane_flow_is_of_second_order_and_a_wall_moves_it():
    omega, errors, sizes = 60.0, [], [16, 32, 64]
    for cells in sizes:
        flow = PlaneFlow(1e-3, 1e-2, cells, force=lambda t: 12 * (1 - cos(omega * t)))
        times = {"until": 0.05, "dt": flow.longest_step / 2, "every": cells // 8}
        run = polymer.run_plane(flow, MAXWELL, **times)
        exact = poiseuille(flow.faces, run.t, 1e-3, 1e-2, 12.0)
        exact -= oscillation(flow.faces, run.t, 1e-3, 1e-2, 12.0, omega)
        errors.append(relative_error(run.u, exact))
    assert 1.85 < fitted_order(1 / array(sizes), errors) < 2.15
    flow = PlaneFlow(1.0, 10.0, 64, top=lambda t: 1.0)
    run = polymer.run_plane(flow, MAXWELL, until=20.0, dt=0.02, every=50)
    off = run.u - couette(flow.faces, run.t, 1.0, 10.0)
    assert np.abs(off)[run.t > 8].max() < 0.01  # the front has faded
    with refused("time step: expected up to"):
        polymer.run_plane(flow, MAXWELL, until=1.0, dt=1.0)


def test_a_learned_shear_law_moves_plates_as_dumbbells_do():
    K = polymer.held(polymer.shear(np.linspace(-4, 4, 9)), 200)
    law = polymer.learn_shear(simulate(Dumbbells(9, 10_000), K, 0.025), window=2, outside="allow")
    flow = PlaneFlow(1.0, 10.0, 32, top=sin)
    run = lambda fluid: polymer.run_plane(flow, fluid, until=8.0, dt=0.02, every=20).u
    assert relative_error(run(law), run(MAXWELL)) < 0.02


def test_a_rate_is_learned_from_exact_pairs_kept_in_a_file_and_marched_by_tables(tmp_path):
    K, C = reached(MAXWELL, 80, 1.0)
    law = polymer.learn_rate(exact_pairs(MAXWELL, K, C), outside="refuse")
    new = reached(MAXWELL, 50, 0.7, seed=1)
    truth = MAXWELL.rate(*new)
    near(law.rate(*new), truth, 5e-3)
    law.save(path := tmp_path / "law.h5")
    with pytest.raises(TypeError):  # half-way, which leaves what was there
        polymer.RateLaw((None,), True).save(path)
    again = polymer.read_law(path)
    assert isinstance(again, polymer.RateLaw)
    near(again.rate(*new), law.rate(*new), 0)
    tables = law.tabulated()
    near(tables.rate(*new), truth, 5e-3)
    cells = [Closure(one, 0.1, 50) for one in (tables, MAXWELL)]
    marched, exact = (cell.advance(10 * new[0], 1e-2) for cell in cells)
    near(marched, exact, 5e-3)
    with refused("are outside the training data"):
        law.check(50 * new[0], new[1])


def test_histories_of_stress_teach_a_law(tmp_path):
    files = []
    for seed in range(3):
        K = polymer.mixed(1, 80, 1.0, hold=10, seed=seed)
        record = simulate(Dumbbells(1, 20_000, seed=seed), K, 0.1)
        rows = [np.r_[0.2 * t, K[min(t, 79), 0] / 2, 3 * record.stress[t, 0]] for t in range(81)]
        np.savetxt(tmp_path / f"{seed}.csv", rows, delimiter=",")
        files.append(tmp_path / f"{seed}.csv")
    records = [polymer.read_trajectory(file, 2.0, 3.0, 20_000) for file in files]
    law = polymer.learn_rate(records, window=2, outside="allow")
    K = polymer.mixed(1, 40, 0.8, seed=9)
    found, exact = (homogeneous(one, K, 0.1) for one in (law, MAXWELL))
    assert norm(found - exact) < 0.1 * norm(exact - exact[0])
    assert len(polymer.start_pairs(records[0], 2)) == 40


def test_the_channel_against_the_exact_flow():
    flow = ChannelFlow(1e-3)
    dt = 0.03 / np.ceil(0.03 / (0.9 * flow.longest_step))
    run = polymer.run_channel(flow, MAXWELL, until=0.03, dt=dt)
    y = np.linspace(0, 1, 401)
    profile = poiseuille(y, run.t, flow.De, flow.Re, flow.force, modes=400)
    exact = array([np.interp(x[:, 1], y, row) for x, row in zip(run.x, profile)])
    assert relative_error(run.v[..., 0], exact) < 0.0033
    assert sup(run.rho - 1) < 1e-4
    heights, u = run.profile(30)
    assert np.nanmax(np.abs(u[-1] - np.interp(heights, y, profile[-1]))) < 0.02


def test_dumbbells_under_every_particle_flow_as_the_law_does():
    flow = ChannelFlow(1e-2, across=20, smoothing=1.2)
    fluids = MAXWELL, CoupledDumbbells(Dumbbells(Particles(flow).fluid, 2000, common=True), flow.De)
    exact, coupled = (polymer.run_channel(flow, one, until=0.01, dt=1e-4).v for one in fluids)
    assert relative_error(coupled, exact) < 0.08
    with refused("expected 4 ensembles"):
        polymer.run_plane(PlaneFlow(1.0, 1.0, 4), Dumbbells(3, 10), until=0.1, dt=0.01)
