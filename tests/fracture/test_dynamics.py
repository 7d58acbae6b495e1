"""Bodies that break in motion: energy, symmetry, flags, and going on with the same bits."""

from dataclasses import replace

import numpy as np
from scipy.interpolate import UnivariateSpline

from tests.support import approx, parametrize, refused
from tests.support.bodies import plate, pulled, solid
from warp_peri.fracture.dynamics import BreakingBody, CrackRun, step

CRACK = [[(-20, 0), (-4, 0)]]
KINDS = {
    "bond-based": {"lam": 1.0, "critical_stretch": 0.012},
    "state-based": {"lam": 0.4, "critical_stretch": 0.012},
    "in space": {"lam": 0.4, "critical_stretch": 0.008, "sides": (8, 12, 4), "horizon": 2.0},
}
SQUARE = [[(-9, 0, -9), (-9, 0, 9), (-1, 0, 9), (-1, 0, -9)]]


def marched(kind, share, **options):
    body = pulled(**KINDS[kind])
    dt = share * body.longest_step
    run = CrackRun(body, step=dt, every=1, **options)
    cracks = CRACK if body.body.dimension == 2 else SQUARE
    return body, run, run.march(body.start(cracks=cracks), steps=round(40 / dt))


@parametrize("kind", KINDS)
def test_the_ledger_closes_and_better_with_shorter_steps(kind):
    body, run, state = marched(kind, 0.4)
    assert 0.05 < body.damage(state).max()
    found = run.motion(state)
    assert found.missing < 3e-3
    _, finer, end = marched(kind, 0.1)
    assert finer.motion(end).missing < found.missing / 4


def test_breaking_follows_the_stretch():
    body = BreakingBody(solid(critical_stretch=0.01), plate())
    u = body.body.x * (0.0, 0.02)
    with refused("in the displacement at rest"):
        body.start(u=u)

    dt = body.longest_step
    moved = lambda size: step(body, body.start(v=size * u / dt), dt)
    state = moved(1)
    beyond = (body.body.xi * (0.0, 0.02) * body.body.xi).sum(1) / body.body.r**2 > 0.01
    assert np.array_equal(body.operator.kept(state.links), (body.body.neighbour >= 0) & ~beyond)
    assert not body.damage(moved(-1)).any()  # pressed, none breaks


def test_held_nodes_move_as_told_and_their_work_counts():
    held = np.abs(plate().x[:, 1]) > 5
    grip = np.where(held[:, None], np.sign(plate().x) * (0.0, 1e-3), 0.0)
    how = {"held": held, "grip": grip, "ramp": lambda t: min(1.0, t / 5.0)}
    body = BreakingBody(solid(0.5, critical_stretch=1.0), plate(), **how)
    run = CrackRun(body, step=0.3 * body.longest_step, every=1)
    state = run.march(body.start(), steps=200)
    assert run.motion(state).missing < 2e-3
    assert state.v.numpy()[held] == approx(grip[held], rel=1e-7, abs=0)
    assert run.history["dissipated"][-1] == 0


def test_a_checkpoint_says_what_differs_and_goes_on_under_the_same_history_of_loads(tmp_path):
    options = {"checkpoint": tmp_path / "run.h5", "every": 1, "checkpoint_every": 1}
    body = pulled(**KINDS["bond-based"])
    dt = 0.4 * body.longest_step
    whole = {"load": body.load.numpy()[: len(body.body.x)], "no_fail": body.no_fail}

    def march(ramp=None, law=body.solid, step=dt, steps=4, watch=np.max, begin=None, **more):
        other = BreakingBody(law, body.body, ramp=ramp, **whole | more)
        run = CrackRun(other, step=step, **options | {"watch": {"phi": watch}})
        return run.march(other.start(cracks=CRACK, **begin or {}), steps=steps)

    slow, later = lambda t: min(1.0, t / (6 * dt)), lambda t: 1.0 if t < 3.5 * dt else 0.5
    march(slow, steps=3)
    shift, law = np.full((len(body.body.x), 2), 1e-4), solid(1.0, critical_stretch=0.011)
    for words, how in {
        "load history, step": {"step": dt / 2}, "start": {"begin": {"u": shift}},
        "load history": {"ramp": lambda t: slow(t) if t else 0.5}, "load": {"load": None},
        "solid": {"law": law}, "records": {"watch": np.mean},
    }.items():  # fmt: skip
        with refused(f"what differs: {words}$"):
            march(**{"ramp": slow} | how)
    changed = lambda t: slow(t) * later(t)  # later than the checkpoint
    same = replace(body.solid, model=replace(body.solid.model, certified_on=(9.0,)))
    resumed, path = march(changed, same, steps=6), options.pop("checkpoint")
    assert march(changed, steps=6).u.numpy().tobytes() == resumed.u.numpy().tobytes()
    options["checkpoint"] = path.with_name("kept.h5")
    keeps = [lambda phi, seen=[]: seen.append(phi) or [phi.sum(), np.nan] for _ in "12"]
    keeps[1].__defaults__ = ([],)
    for steps, keep in zip((2, 4, 6), (*keeps, keeps[1])):  # what they see
        march(steps=steps, watch=keep)
    keeps[1].__defaults__[0].append(1)
    with refused("what differs: records"):
        march(steps=6, watch=keeps[1])
    options["checkpoint"] = path.with_name("splines.h5")
    splines = [UnivariateSpline(np.arange(9.0), np.arange(9.0) ** n) for n in (1, 2)]
    for steps in (2, 4):  # the same type of a package, whose objects change by use
        march(steps=steps, watch=lambda phi, of=splines[0]: of(phi))
    with refused("watch phi: expected a function of φ alone"):
        march(watch=lambda phi, of=splines[1]: of(phi))
