"""Bodies that break in motion: energy, symmetry, flags, and going on with the same bits."""

import numpy as np
import pytest
import torch

import warp_peri as wp
from tests.support.bodies import plate, pulled, solid
from warp_peri import InputError
from warp_peri.fracture.dynamics import BreakingBody, step
from warp_peri.fracture.run import CrackRun

CRACK = [[(-20, 0), (-4, 0)]]
KINDS = {
    "bond-based": {"lam": 1.0, "critical_stretch": 0.012},
    "state-based": {"lam": 0.4, "critical_stretch": 0.012},
    "by energy": {"lam": 1.0, "critical_energy": 2e-5},
    "in space": {"lam": 0.4, "critical_stretch": 0.008, "sides": (8, 12, 4), "horizon": 2.0},
}
SQUARE = [[(-9, 0, -9), (-9, 0, 9), (-1, 0, 9), (-1, 0, -9)]]


def marched(kind, share, **options):
    body = pulled(**KINDS[kind])
    dt = share * body.longest_step
    run = CrackRun(body, step=dt, every=1, **options)
    cracks = CRACK if body.body.dimension == 2 else SQUARE
    return body, run, run.march(body.start(cracks=cracks), steps=round(40 / dt))


@pytest.mark.parametrize("kind", KINDS)
def test_the_ledger_closes_and_better_with_shorter_steps(kind):
    body, run, state = marched(kind, 0.4)
    assert 0.05 < body.damage(state).max()
    found = run.motion(state)
    assert found["dissipated"][-1] > 0
    assert found.missing < 3e-3
    _, finer, end = marched(kind, 0.1)
    assert finer.motion(end).missing < found.missing / 4


def test_a_symmetric_body_breaks_symmetrically():
    body, _, state = marched("state-based", 0.5)
    phi = body.damage(state).reshape(24, 16)
    np.testing.assert_array_equal(phi, phi[:, ::-1])
    assert phi[:, :3].max() == 0  # no-fail


def test_breaking_follows_the_stretch():
    body = BreakingBody(solid(critical_stretch=0.01), plate())
    u = body.body.x * (0.0, 0.02)
    with pytest.raises(InputError, match="in the displacement at rest"):
        body.start(u=u)
    state = body.start(v=body.body.x * (0.0, 0.02 / body.longest_step))
    step(body, state, body.longest_step)
    d = body.body.xi * (0.0, 0.02) * body.body.xi
    beyond = d.sum(axis=1) / body.body.r**2 > 0.01
    there = body.body.neighbour >= 0
    np.testing.assert_array_equal(body.operator.kept(state.links), there & ~beyond)


def test_compression_breaks_only_where_asked():
    for tension_only in (True, False):
        law = solid(critical_stretch=0.01)
        object.__setattr__(law, "tension_only", tension_only)
        body = BreakingBody(law, plate())
        state = body.start(v=-body.body.x * (0.0, 0.02 / body.longest_step))
        step(body, state, body.longest_step)
        assert (body.damage(state).max() > 0.3) != tension_only


def test_cracks_count_as_damage_or_not():
    body = pulled()
    assert body.damage(body.start(cracks=CRACK)).max() == 0
    assert body.damage(body.start(cracks=CRACK, count_cracks=True)).max() > 0.3


def test_held_nodes_move_as_told_and_their_work_counts():
    held = np.abs(plate().x[:, 1]) > 5
    grip = np.where(held[:, None], np.sign(plate().x) * (0.0, 1e-3), 0.0)
    body = BreakingBody(
        solid(0.5, critical_stretch=1.0),
        plate(),
        held=held,
        grip=grip,
        ramp=lambda t: min(1.0, t / 5.0),
    )
    run = CrackRun(
        body, step=0.3 * body.longest_step, every=1, sections={"middle": [(-9, 0), (9, 0)]}
    )
    state = run.march(body.start(), steps=200)
    assert run.motion(state).missing < 2e-3
    np.testing.assert_allclose(state.v.numpy()[held], grip[held])
    upper = state.force.numpy()[: len(held)][body.body.x[:, 1] > 0].sum(axis=0)
    np.testing.assert_allclose(run.history["force middle"][-1], upper, atol=1e-12)
    assert abs(upper[1]) > 1e-4
    assert run.history["dissipated"][-1] == 0


def test_killed_and_resumed_gives_the_same_bits(tmp_path):
    straight = marched("state-based", 0.5, regions={"left": plate(24, 16).x[:, 0] < 0})
    body = pulled(**KINDS["state-based"])
    options = {
        "every": 1,
        "checkpoint": tmp_path / "run.h5",
        "checkpoint_every": 7,
        "series": tmp_path / "series",
        "regions": {"left": body.body.x[:, 0] < 0},
    }
    dt = straight[1].dt
    steps = straight[2].steps
    first = CrackRun(body, step=dt, **options)
    assert 0 < body.damage(first.march(body.start(cracks=CRACK), steps=steps // 2)).max()
    again = CrackRun(body, step=dt, **options)
    state = again.march(body.start(cracks=CRACK), steps=steps)
    for name in ("u", "v", "links", "work"):
        want, got = getattr(straight[2], name).numpy(), getattr(state, name).numpy()
        assert want.tobytes() == got.tobytes()
    assert again.history == straight[1].history
    records = sorted((tmp_path / "series").glob("record_*.h5"))
    assert len(records) == steps
    assert (tmp_path / "series" / "motion.xdmf").read_text().count("<Time ") == steps


def test_a_checkpoint_of_another_watch_is_not_joined(tmp_path):
    """The same name, another function: the records would be of two things in one column."""
    body = pulled(**KINDS["bond-based"])
    dt = 0.4 * body.longest_step
    options = {"checkpoint": tmp_path / "run.npz", "every": 1, "checkpoint_every": 1}

    def march(function, steps):
        run = CrackRun(body, step=dt, watch={"damage": function}, **options)
        run.march(body.start(cracks=CRACK), steps=steps)
        return run.history["damage"]

    march(lambda phi: phi.max(), 3)
    assert len(march(lambda phi: phi.max(), 5)) == 5
    with pytest.raises(InputError, match="what differs: records"):
        march(lambda phi: phi.mean(), 7)


def ramped(ramp):
    """A body pulled by a load that follows a ramp, and a step."""
    body = pulled(**KINDS["bond-based"])
    load = body.load.numpy()[: len(body.body.x)]
    ramped = BreakingBody(body.solid, body.body, load=load, no_fail=body.no_fail, ramp=ramp)
    return ramped, 0.4 * ramped.longest_step


def test_a_checkpoint_of_another_history_of_loads_is_refused_wherever_it_differs(tmp_path):
    path = tmp_path / "run.h5"
    options = {"checkpoint": path, "every": 5, "checkpoint_every": 1}
    _, dt = ramped(None)
    slow, jump = lambda t: min(1.0, t / (60 * dt)), lambda t: 0.5 if t > 36.5 * dt else 0.0

    def march(ramp, steps, **more):
        body, dt = ramped(ramp)
        run = CrackRun(body, step=dt, **(options | more))
        return run, run.march(body.start(cracks=CRACK), steps=steps)

    march(slow, 40)
    for ramp in (lambda t: slow(t) + jump(t), None, lambda t: min(1.0, t / (59.999999 * dt))):
        with pytest.raises(InputError, match="what differs: load history$"):
            march(ramp, 60)
    again, resumed = march(slow, 60)
    straight, state = march(slow, 60, checkpoint=None)
    assert state.u.numpy().tobytes() == resumed.u.numpy().tobytes()
    assert again.history == straight.history


def test_a_load_that_changes_only_later_goes_on_as_if_never_stopped(tmp_path):
    _, dt = ramped(None)
    ramps = lambda t: 1.0, lambda t: 1.0 if t < 30.5 * dt else 0.2
    options = {"checkpoint": tmp_path / "run.h5", "every": 5, "checkpoint_every": 1}
    body, _ = ramped(ramps[0])
    CrackRun(body, step=dt, **options).march(body.start(cracks=CRACK), steps=20)
    body, _ = ramped(ramps[1])
    resumed = CrackRun(body, step=dt, **options).march(body.start(cracks=CRACK), steps=50)
    straight = CrackRun(body, step=dt, every=5).march(body.start(cracks=CRACK), steps=50)
    assert resumed.u.numpy().tobytes() == straight.u.numpy().tobytes()


def test_fewer_steps_than_are_behind_are_refused(tmp_path):
    body = pulled(**KINDS["bond-based"])
    dt, path = 0.4 * body.longest_step, tmp_path / "run.h5"
    options = {"checkpoint": path, "every": 10, "checkpoint_every": 1}
    state = CrackRun(body, step=dt, **options).march(body.start(cracks=CRACK), steps=100)
    start = body.start(cracks=CRACK)
    with pytest.raises(InputError, match="at least the 100 steps of the checkpoint, got 50"):
        CrackRun(body, step=dt, **options).march(start, steps=50)
    assert start.steps == 0
    assert CrackRun(body, step=dt, every=10).march(start, steps=50).steps == 50
    with pytest.raises(InputError, match="at least the 100 that the state has taken, got 50"):
        CrackRun(body, step=dt).march(state, steps=50)


def test_a_checkpoint_says_what_differs(tmp_path):
    options = {"checkpoint": tmp_path / "run.h5", "every": 1, "checkpoint_every": 1}
    body = pulled(**KINDS["bond-based"])
    dt, start = 0.4 * body.longest_step, body.start(cracks=CRACK)
    run = CrackRun(body, step=dt, **options)
    run.march(start, steps=2)
    shift = np.full((len(body.body.x), 2), 1e-4)
    free = BreakingBody(body.solid, body.body, no_fail=body.no_fail)
    brittler = pulled(lam=1.0, critical_stretch=0.011)
    for other, step_, begin, words in (
        (body, dt / 2, body.start(cracks=CRACK), "step"),
        (body, dt, body.start(cracks=CRACK, u=shift), "start"),
        (free, dt, free.start(cracks=CRACK), "load"),
        (brittler, dt, brittler.start(cracks=CRACK), "solid"),
    ):
        with pytest.raises(InputError, match=f"what differs: {words}$"):
            CrackRun(other, step=step_, **options).march(begin, steps=4)
    with pytest.raises(InputError, match="what differs: records$"):
        CrackRun(body, step=dt, **options, regions={"all": shift[:, 0] > 0}).march(
            body.start(cracks=CRACK), steps=4
        )
    middle = {"middle": [(-9, 0), (9, 0)]}
    with pytest.raises(InputError, match="what differs: records$"):
        CrackRun(body, step=dt, **options, sections=middle).march(body.start(cracks=CRACK), steps=4)
    with pytest.raises(InputError, match="what differs: start$"):  # by the same run, too
        run.march(body.start(), steps=4)


def test_a_body_thrown_without_a_load_keeps_the_energy_it_started_with():
    law, body = solid(0.4, critical_stretch=0.01), plate(12, 12)
    free = BreakingBody(law, body)
    run = CrackRun(free, step=0.2 * free.longest_step, every=1)
    found = run.motion(run.march(free.start(v=0.05 * body.x * (1, -0.5)), steps=60))
    assert found["dissipated"][-1] > 0
    assert found.missing < 2e-3


def test_runs_that_would_record_nothing_are_refused():
    body = pulled()
    dt = 0.4 * body.longest_step
    for options, words in (
        ({"every": 0}, "every: expected a whole number ≥ 1"),
        ({"checkpoint_every": -1}, "checkpoint_every: expected"),
        ({"regions": {"far": body.body.x[:, 0] > 1e3}}, "region far: expected one node"),
        ({"regions": {"few": np.ones(3, bool)}}, "region few: expected shape"),
        ({"sections": {"far": [(-9, 99), (9, 99)]}}, "section far: expected a line"),
        ({"sections": {"bent": [(-9, 0), (0, 0), (9, 8)]}}, "section: expected two ends"),
    ):
        with pytest.raises(InputError, match=words):
            CrackRun(body, step=dt, **options)
    with pytest.raises(InputError, match="nothing has been recorded"):
        print(CrackRun(body, step=dt).motion(body.start()).missing)
    with pytest.raises(InputError, match="grip: expected held components"):
        BreakingBody(solid(toughness=1.0), plate(6, 6), grip=np.ones((36, 2)))


def test_steps_beyond_the_bound_are_refused():
    body = pulled()
    for step_, words in ((1.01 * body.longest_step, "whatever breaks"), (0.0, "a number > 0")):
        with pytest.raises(InputError, match=f"step: expected .*{words}"):
            CrackRun(body, step=step_)


def test_one_criterion_is_asked_for():
    with pytest.raises(InputError, match="criterion: expected one of"):
        solid(toughness=1.0, critical_stretch=0.1)


def test_a_motion_that_breaks_has_no_gradient_and_says_so():
    body = pulled(**KINDS["bond-based"])
    points = wp.Points(body.body.x, np.ones(len(body.body.x), bool), 1.0, units=body.solid.units)
    leaf = torch.zeros(body.body.x.shape, dtype=torch.float64, requires_grad=True)
    sizes = {"step": 0.1, "steps": 2}
    for load, more in (
        (leaf, {}), (None, {"parameters": {"mu": 1.0}}), (None, {"grip": leaf}), (None, {"v": leaf})
    ):  # fmt: skip
        with pytest.raises(InputError, match="move: expected tensors without a gradient, which on"):
            wp.move(body.solid, wp.damage.Cracked(points, load), **sizes | more)
