"""The channel of particles against the exact flow, symmetric, stable, resumable."""

import numpy as np
import pytest

from examples.exact import poiseuille
from examples.polymer.closure import Closure, CoupledDumbbells
from examples.polymer.dumbbells import Dumbbells
from examples.polymer.laws import FENEP, LogConformation, UpperConvectedMaxwell
from examples.polymer.particles import ChannelFlow, Particles, run_channel
from tests.support.problems import fitted_order
from warp_peri import InputError


def run(flow, until, fraction=0.9, every=10, **more):
    dt = until / np.ceil(until / (fraction * flow.longest_step))
    fluid = Closure(UpperConvectedMaxwell(), flow.De, Particles(flow).fluid)
    return run_channel(flow, fluid, until=until, dt=dt, every=every, **more)


def error(flow, record):
    """Relative ℓ2 of u at the particles' own heights."""
    y = np.linspace(0, 1, 401)
    exact = poiseuille(y, record.t, flow.De, flow.Re, flow.force, modes=400)
    u = np.array([np.interp(x[:, 1], y, row) for x, row in zip(record.x, exact)])
    return np.linalg.norm(record.v[..., 0] - u) / np.linalg.norm(u)


def test_the_channel_against_the_exact_flow():
    flow = ChannelFlow(1e-3)
    record = run(flow, 0.03)
    assert error(flow, record) < 0.0033
    assert np.abs(record.rho - 1).max() < 1e-4
    assert np.abs(record.v[..., 1]).max() < 7e-4


def test_it_converges_where_elastic_waves_run():
    errors, sizes = [], (20, 28, 40)
    for across in sizes:
        flow = ChannelFlow(1e-2, across=across, smoothing=1.2, length=0.4)
        errors.append(error(flow, run(flow, 0.02)))
    assert errors[1] < 0.0213
    assert fitted_order(1 / np.array(sizes), errors) > 0.9  # fronts are kinks: first order in ℓ2


def test_a_linear_velocity_and_a_quiet_fluid_are_exact():
    flow = ChannelFlow(1e-2, force=0.0)
    particles = Particles(flow)
    fluid = Closure(UpperConvectedMaxwell(), flow.De, particles.fluid)
    for _ in range(5):
        particles.step(fluid, 1e-4)
    assert np.abs(particles.v).max() < 1e-12
    x = particles._x.numpy()
    particles._v.assign(np.column_stack([2 * x[:, 1] + 1, -0.5 * x[:, 1]]))
    particles._sweeps["gather"]()
    assert np.allclose(particles.kappa, [0, 2, 0, -0.5], atol=1e-10)


def test_runs_resume_with_the_same_bits_and_go_to_paraview(tmp_path):
    flow, file = ChannelFlow(1e-2, across=20, length=0.6, smoothing=1.2), tmp_path / "run.npz"
    fluid = lambda: Closure(UpperConvectedMaxwell(), 1e-2, Particles(flow).fluid)
    whole = run_channel(flow, fluid(), until=0.02, dt=1e-4, every=2)
    run_channel(flow, fluid(), until=0.01, dt=1e-4, every=2, checkpoint=file)
    resumed = run_channel(flow, fluid(), until=0.02, dt=1e-4, every=2, checkpoint=file)
    assert np.array_equal(whole.v, resumed.v)
    assert len(whole.save_vtu(tmp_path / "fields")) == len(whole.t)
    with pytest.raises(InputError, match="another channel"):
        run_channel(flow, fluid(), until=0.02, dt=5e-5, checkpoint=file)
    n = Particles(flow).fluid
    for other in (
        Closure(FENEP(20.0), 1e-2, n),
        Closure(UpperConvectedMaxwell(), 2e-2, n),
        Closure(LogConformation(UpperConvectedMaxwell()), 1e-2, n),
        CoupledDumbbells(Dumbbells(n, 20, common=True), 1e-2),
    ):
        with pytest.raises(InputError, match="another channel, fluid"):
            run_channel(flow, other, until=0.02, dt=1e-4, every=2, checkpoint=file)
    shorter = run_channel(flow, fluid(), until=0.01, dt=1e-4, every=2, checkpoint=file)
    assert np.array_equal(shorter.t, whole.t[:50])
    _, u = whole.profile(33)
    filled = np.zeros(33, bool)
    filled[(whole.x[-1, :, 1] * 33).astype(int)] = True
    assert np.array_equal(np.isfinite(u[-1]), filled)
    assert not filled.all()


def test_a_run_that_fails_leaves_its_last_record(tmp_path):
    class Breaking(Closure):
        def advance(self, kappa, dt):
            if self.steps == 25:
                raise InputError("broken")
            return super().advance(kappa, dt)

    flow, file = ChannelFlow(1e-2, across=20, smoothing=1.2), tmp_path / "run.npz"
    n = Particles(flow).fluid
    fluid = Breaking(UpperConvectedMaxwell(), 1e-2, n)
    with pytest.raises(InputError, match="broken"):
        run_channel(flow, fluid, until=5e-3, dt=1e-4, every=2, checkpoint=file)
    kept = np.load(file)
    assert kept["done"] == 24
    fluid = Closure(UpperConvectedMaxwell(), 1e-2, n)
    resumed = run_channel(flow, fluid, until=5e-3, dt=1e-4, every=2, checkpoint=file)
    fluid = Closure(UpperConvectedMaxwell(), 1e-2, n)
    assert np.array_equal(resumed.v, run_channel(flow, fluid, until=5e-3, dt=1e-4, every=2).v)
    resumed.save_csv(tmp_path / "u.csv", bins=20)
    table = np.loadtxt(tmp_path / "u.csv", delimiter=",")
    assert np.allclose(table[-1, 1:], resumed.v[-1, :, 0].reshape(20, -1).mean(axis=1))


def test_a_solvent_adds_its_viscosity():
    flow = ChannelFlow(1e-3, across=20, smoothing=1.2, solvent=1.0)
    record = run(flow, 0.006)
    y = record.x[-1, :, 1]
    steady = flow.force / 4 * y * (1 - y)  # half of that without it
    assert np.linalg.norm(record.v[-1, :, 0] - steady) < 0.03 * np.linalg.norm(steady)


def test_dumbbells_in_every_particle():
    flow = ChannelFlow(1e-2, across=16, smoothing=1.2, length=0.6)
    n = Particles(flow).fluid
    exact = run(flow, 5e-3)
    dt = 5e-3 / np.ceil(5e-3 / (0.9 * flow.longest_step))
    coupled = CoupledDumbbells(Dumbbells(n, 2000, seed=1, common=True), 1e-2)
    record = run_channel(flow, coupled, until=5e-3, dt=dt)
    difference = np.linalg.norm(record.v - exact.v) / np.linalg.norm(exact.v)
    assert difference < 4 * np.sqrt(2 / 2000)


def test_bad_input_is_refused():
    flow = ChannelFlow(1e-2)
    fluid = Closure(UpperConvectedMaxwell(), 1e-2, Particles(flow).fluid)
    with pytest.raises(InputError, match="time step: expected up to 0.00019"):
        run_channel(flow, fluid, until=1.0, dt=1e-3)
    with pytest.raises(InputError, match="period above 0.63"):
        ChannelFlow(1e-2, across=15)
    for wrong in ({"De": -1.0}, {"force": np.nan}, {"solvent": np.inf}, {"across": 30.5}):
        with pytest.raises(InputError, match="above 0"):
            ChannelFlow(**{"De": 1e-2} | wrong)
    for until, every in ((1e-3, 0), (np.nan, 1), (-1.0, 1), (1e-4, 5)):
        with pytest.raises(InputError, match="run: expected every"):
            run_channel(flow, fluid, until=until, dt=1e-4, every=every)
    with pytest.raises(InputError, match="velocity gradient: expected shape"):
        fluid.advance(np.zeros((3, 4)), 1e-4)
    with pytest.raises(InputError, match="check_every: expected a whole number ≥ 1"):
        Closure(UpperConvectedMaxwell(), 1e-2, 3, check_every=0)
    particles = Particles(flow)
    x = particles._x.numpy()
    x[3, 1] = -0.01
    particles._x.assign(x)
    with pytest.raises(InputError, match="1 particles left"):
        particles._find()
    particles = Particles(flow)
    with pytest.raises(InputError, match="not finite or too large"):
        _ = [particles.step(fluid, 0.02) for _ in range(50)]
