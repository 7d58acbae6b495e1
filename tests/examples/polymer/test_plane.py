"""Named laws and plane flows: exact series, order, objectivity, steady states, bad input."""

import numpy as np
import pytest

from examples.exact import couette, oscillation, poiseuille
from examples.polymer import ChannelFlow
from examples.polymer.closure import Closure, CoupledDumbbells, homogeneous
from examples.polymer.dumbbells import Dumbbells, held
from examples.polymer.laws import (
    FENEP,
    IDENTITY,
    Giesekus,
    UpperConvectedMaxwell,
    elongation,
    shear,
)
from examples.polymer.particles import Particles
from examples.polymer.plane import PlaneFlow, run_plane
from tests.support.problems import fitted_order
from warp_peri import InputError, move

LAWS = [UpperConvectedMaxwell(), Giesekus(0.3), FENEP(20.0)]


def channel(De, cells, until, force, every=1):
    flow = PlaneFlow(De, 1e-2, cells, force=force)
    closure = Closure(UpperConvectedMaxwell(), De, cells)
    return flow, run_plane(flow, closure, until=until, dt=flow.longest_step / 2, every=every)


def test_start_up_of_a_channel_against_the_exact_series():
    flow, profiles = channel(1e-3, 128, 0.05, lambda t: 12.0, every=16)
    exact = poiseuille(flow.faces, profiles.t, 1e-3, 1e-2, 12.0)
    assert np.linalg.norm(profiles.u - exact) < 5e-4 * np.linalg.norm(exact)


@pytest.mark.parametrize("De", [1e-3, 1e-2])
def test_second_order_under_a_force_that_starts_smoothly(De):
    omega, errors, sizes = 60.0, [], [16, 32, 64]
    for cells in sizes:
        force = lambda t: 12 * (1 - np.cos(omega * t))
        flow, profiles = channel(De, cells, 0.05, force, every=cells // 8)
        exact = poiseuille(flow.faces, profiles.t, De, 1e-2, 12.0)
        exact -= oscillation(flow.faces, profiles.t, De, 1e-2, 12.0, omega)
        errors.append(np.linalg.norm(profiles.u - exact) / np.linalg.norm(exact))
    assert 1.85 < fitted_order(1 / np.array(sizes), errors) < 2.15


def test_the_exact_overshoot_of_the_channel():
    t = np.linspace(0, 0.3, 3001)
    u = poiseuille(np.array([0.5]), t, 1e-2, 1e-2, 12.0)
    assert u.max() == pytest.approx(6.0, abs=0.05)  # four times the steady 1.5
    assert u.min() == pytest.approx(-1.20, abs=0.02)


def test_a_moving_wall_against_the_exact_series():
    flow = PlaneFlow(1.0, 10.0, 64, top=lambda t: 1.0)
    profiles = run_plane(
        flow, Closure(UpperConvectedMaxwell(), 1.0, 64), until=20.0, dt=0.02, every=50
    )
    exact = couette(flow.faces, profiles.t, 1.0, 10.0)
    late = profiles.t > 8  # the front has faded
    assert np.abs(profiles.u - exact)[late].max() < 0.01


def test_a_solvent_adds_its_viscosity():
    flow = PlaneFlow(0.1, 1.0, 16, force=lambda t: 1.0, solvent=1.0)
    closure = Closure(UpperConvectedMaxwell(), 0.1, 16)
    profiles = run_plane(flow, closure, until=3.0, dt=flow.longest_step / 2, every=100)
    y = flow.faces
    assert np.abs(profiles.u[-1] - y * (1 - y) / 4).max() < 1e-4


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_laws_are_objective(law):
    random, angle = np.random.default_rng(0), 0.7
    Q = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def turned(A):
        full = Q @ A[..., :3][..., [0, 1, 1, 2]].reshape(-1, 2, 2) @ Q.T
        return np.stack([full[:, 0, 0], full[:, 0, 1], full[:, 1, 1], A[:, 3]], -1)

    K = random.uniform(-1, 1, (20, 4))
    C = homogeneous(law, K[None], 0.5)[-1]
    K_turned = (Q @ K.reshape(-1, 2, 2) @ Q.T).reshape(-1, 4)
    assert np.allclose(law.rate(K_turned, turned(C)), turned(law.rate(K, C)), atol=1e-12)
    assert np.allclose(law.stress(turned(C)), turned(law.stress(C)), atol=1e-12)
    assert np.abs(law.rate(0 * K[:1], law.rest[None])).max() < 1e-12
    assert np.abs(law.stress(law.rest)).max() < 1e-12
    spin = np.array([[0.0, 2.0, -2.0, 0.0]])  # a rigid rotation leaves the fluid at rest alone
    assert np.abs(law.rate(spin, law.rest[None])).max() < 1e-12


def test_steady_shear_of_the_named_laws():
    K = held(shear(np.array([0.5, 2.0])), 300)
    s = UpperConvectedMaxwell().stress(homogeneous(UpperConvectedMaxwell(), K, 0.1)[-1])
    assert np.allclose(s[:, 1], [0.5, 2.0])
    assert np.allclose(s[:, 0] - s[:, 2], [0.5, 8.0])  # N1 = 2 Wi²
    thin = Giesekus(0.3).stress(homogeneous(Giesekus(0.3), K, 0.1)[-1])
    assert thin[1, 1] < 0.7 * s[1, 1]
    assert (thin[:, 2] < 0).all()  # a second normal stress difference
    bounded = FENEP(20.0)
    C = homogeneous(bounded, held(elongation(np.array([5.0])), 300), 0.1)[-1]
    assert 15 < C[0, 0] < 20
    near = homogeneous(Giesekus(1e-9), K, 0.1)[-1]
    assert np.allclose(near, s + IDENTITY, atol=1e-6)


def test_a_coupled_flow_nears_the_exact_law():
    flow = PlaneFlow(1.0, 1.0, 16, force=lambda t: 1.0)
    exact = run_plane(flow, Closure(UpperConvectedMaxwell(), 1.0, 16), until=2.0, dt=0.02, every=10)
    for count in (500, 8000):
        dumbbells = Dumbbells(16, count, seed=3, common=True)
        profiles = run_plane(flow, CoupledDumbbells(dumbbells, 1.0), until=2.0, dt=0.02, every=10)
        error = np.linalg.norm(profiles.u - exact.u) / np.linalg.norm(exact.u)
        assert error < 4 * np.sqrt(2 / count)  # the elastic modulus is ⟨q_y²⟩, noisy by √(2/N)


def test_plane_flows_resume_and_write_tables(tmp_path):
    flow, file = PlaneFlow(1e-2, 1e-2, 16, force=lambda t: 12.0), tmp_path / "flow.npz"
    run = lambda until, **more: run_plane(
        flow, Closure(UpperConvectedMaxwell(), 1e-2, 16), until=until, dt=2e-4, every=5, **more
    )
    whole = run(0.02)
    run(0.01, checkpoint=file)
    resumed = run(0.02, checkpoint=file)
    assert np.array_equal(whole.u, resumed.u)
    whole.save_csv(tmp_path / "u.csv")
    assert np.allclose(np.loadtxt(tmp_path / "u.csv", delimiter=",")[:, 1:], whole.u)
    with pytest.raises(InputError, match="another flow"):
        run_plane(
            flow, Closure(UpperConvectedMaxwell(), 1e-2, 16), until=0.02, dt=1e-4, checkpoint=file
        )
    pushed = PlaneFlow(1e-2, 1e-2, 16, force=lambda t: 13.0)
    for other, law in ((flow, FENEP(20.0)), (pushed, UpperConvectedMaxwell())):
        with pytest.raises(InputError, match="another flow, fluid"):
            run_plane(other, Closure(law, 1e-2, 16), until=0.02, dt=2e-4, every=5, checkpoint=file)
    assert np.array_equal(run(0.01, checkpoint=file).u, whole.u[: len(whole.u) // 2 + 1])


def test_a_checkpoint_of_another_history_is_refused_wherever_it_differs(tmp_path):
    def run(until, force=lambda t: 12.0, top=lambda t: 0.0, **more):
        flow = PlaneFlow(1e-2, 1e-2, 16, force=force, top=top)
        fluid = Closure(UpperConvectedMaxwell(), 1e-2, 16)
        return run_plane(flow, fluid, until=until, dt=2e-4, every=5, **more)

    file = tmp_path / "run.npz"
    run(0.01, checkpoint=file)
    with pytest.raises(InputError, match=r"what differs: force, from t = 0.0052 on \(12 there, 13"):
        run(0.02, lambda t: 12.0 + (t > 0.0051), checkpoint=file)
    with pytest.raises(InputError, match=r"what differs: top, from t = 0.0052 on \(0 there, 1"):
        run(0.02, top=lambda t: float(0.005 < t < 0.0052), checkpoint=file)
    later = lambda t: 12.0 + (t > 0.0101)  # as if it had never stopped
    assert np.array_equal(run(0.02, later, checkpoint=file).u, run(0.02, later).u)


def test_bad_input_is_refused():
    flow = PlaneFlow(1e-2, 1e-2, 16, force=lambda t: 12.0)
    closure = Closure(UpperConvectedMaxwell(), 1e-2, 16)
    with pytest.raises(InputError, match="time step: expected up to 0.000625"):
        run_plane(flow, closure, until=1.0, dt=1e-3)
    with pytest.raises(InputError, match="positive eigenvalues, got -0.5"):
        closure.law.check(np.zeros((1, 4)), np.array([[1.0, 1.5, 1.0, 1.0]]))
    with pytest.raises(InputError, match="trace below 20"):
        FENEP(20.0).check(np.zeros((1, 4)), np.array([[19.0, 0.0, 1.0, 1.0]]))
    with pytest.raises(InputError, match="De > 0"):
        PlaneFlow(0.0, 1.0)
    for wrong in ("50", None, [50.0], np.nan, 1j, True, {}):
        with pytest.raises(InputError, match="b: expected a number above 3, got"):
            FENEP(wrong)
        with pytest.raises(InputError, match="alpha: expected a number from 0 to 1, got"):
            Giesekus(wrong)


@pytest.mark.parametrize("flow", [PlaneFlow(1.0, 1.0, 8, top=lambda t: 1.0), ChannelFlow(1e-2)])
def test_a_flow_is_moved_as_any_other_problem(flow):
    n = 8 if isinstance(flow, PlaneFlow) else Particles(flow).fluid
    how = {"until": 4 * flow.longest_step, "dt": flow.longest_step / 4, "every": 8}
    law = UpperConvectedMaxwell()
    run = move(law, flow, **how)
    again = move(Closure(law, flow.De, n), flow, **how)
    assert np.array_equal(run["u"], again["u"])
    assert np.array_equal(run["stress"], again["stress"])
    assert np.array_equal(run.u, run["u"][-1])
    assert len(run.time) == len(run["stress"])
    dumbbells = move(Dumbbells(n, 20, common=True), flow, **how)
    assert dumbbells["u"].shape == run["u"].shape
    assert np.isfinite(dumbbells["stress"]).all()
    for material, options, words in (
        (
            law,
            how | {"steps": 3},
            "options among until, dt, every, checkpoint, progress, got steps",
        ),
        (law, {"until": 1.0}, "expected dt too"),
        (Dumbbells(3, 20), how, f"dumbbells: expected {n} ensembles, got 3"),
        (None, how, "expected a law, Dumbbells or a Closure for a flow, got NoneType"),
    ):
        with pytest.raises(InputError, match=words):
            move(material, flow, **options)
