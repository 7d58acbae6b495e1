"""Bonds that soften and fail: linear limit, energy's derivative, a peak, another horizon."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.integrate import quad

from tests.support.bodies import solid
from tests.support.problems import difference
from warp_peri import Cracked, InputError, LPSMaterial, Points, simulate
from warp_peri.fracture import BondLaw, SofteningMaterial, adjoint, lattice_body, rectangle_nodes
from warp_peri.fracture.adjoint import SoftBody
from warp_peri.fracture.statics import CutSolid

LAWS = {
    "linear": BondLaw(0.0, 0.06),
    "softening": BondLaw(5.0, 0.06),
    "with a tail": BondLaw(5.0, 0.05, 0.03),
}


def rate(half):
    """Displacement of an end over t."""
    return 0.025 * half / 50


def plate(half, spacing, horizon, crack):
    """A plate |x| < L, |y| < 2 L, its ends displaced by one, and nodes whose bonds do not break."""
    n = round(half / spacing)
    lines = np.arange(-n, n + 1) * spacing, (np.arange(-2 * n, 2 * n) + 0.5) * spacing
    x = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    inner = np.abs(x[:, 1]) <= 2 * half - spacing
    free = np.column_stack([np.abs(x[:, 0]) >= 1e-9 * spacing, inner])
    start = np.column_stack([-x[:, 0] / 3, x[:, 1]]) / (2 * half)
    given = np.column_stack([0 * x[:, 0], np.sign(x[:, 1])])
    points = Points(x, np.asarray(free.any(axis=1)), spacing)
    cracks = [[(-half / 2, 0), (half / 2, 0)]] if crack else []
    problem = Cracked(points, u=np.where(free, start, given), cracks=cracks, free=free)
    return problem, np.abs(x[:, 1]) > 2 * half - 2 * horizon


def pulled(half, times, law, *, spacing=5.0, horizon=15.05, crack=True):
    """Forces in units of the stiffness over loads, rate · t, as far as there is an equilibrium."""
    problem, rim = plate(half, spacing, horizon, crack)
    solid = SofteningMaterial(LPSMaterial(1.0, 1.0, 1.0, [1.0], horizon=horizon), law)
    line = [(-1.5 * half, 0.0), (1.5 * half, 0.0)]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="load .* left out")
        return simulate(solid, problem, loads=rate(half) * times, line=line, no_fail=rim, stop=0.9)


def peak(run, half):
    """t and force at the largest force."""
    highest = int(np.argmax(run["force"]))
    return run.time[highest] / rate(half), run["force"][highest]


def torn_plate(law):
    """The published plate at a small size, and its displacement at unit load."""
    problem, rim = plate(20, 5.0, 10.05, True)
    model = LPSMaterial(1.0, 1.0, 1.0, [1.0], 10.05)
    body = lattice_body(problem.points.x, 5.0, 10.05)
    soft = SoftBody(model, body, law, problem.held, cracks=problem.cracks, no_fail=rim)
    return soft, problem.u


def test_without_softness_it_is_the_linear_body():
    soft, unit = torn_plate(BondLaw(0.0))
    times = np.array([10.0, 20.0])
    run = pulled(20, times, BondLaw(0.0), horizon=10.05)
    assert run["force"][1] == pytest.approx(2 * run["force"][0])
    crack = [[(-10, 0), (10, 0)]]
    linear = CutSolid(LPSMaterial(1.0, 1.0, 1.0, [1.0], 10.05), soft.body, soft.held, cracks=crack)
    np.testing.assert_allclose(
        soft.rest(unit.ravel().astype(float), np.ones(len(soft.stiffness))).reshape(-1, 2),
        linear.solve(None, unit).u,
        atol=1e-7,
    )


def test_softer_bonds_pull_less_failing_ones_make_a_peak_and_a_tail_raises_it():
    times = np.arange(84.0, 112.0, 4.0)
    stiff, soft, broken, tail = (
        pulled(20, times, law, horizon=10.05)
        for law in (BondLaw(0.0), BondLaw(4.0), BondLaw(4.0, 0.05), BondLaw(4.0, 0.05, 0.05))
    )
    assert (soft["force"] < stiff["force"]).all()
    assert peak(broken, 20)[1] < peak(tail, 20)[1] < soft["force"].max()
    assert broken["broken"][-1] > 0
    assert broken["force"][-1] < peak(broken, 20)[1]


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_the_energy_spent_is_the_work_of_pulling_a_bond_apart(law):
    def pull(s):
        worst = np.array([s])
        return float((law.pull(worst) * law.share(worst))[0])

    ends = law.stretch, law.stretch + law.tail
    work = quad(pull, 0, ends[0])[0] + quad(pull, *ends)[0]
    assert law.spent() == pytest.approx(work, rel=1e-8)
    assert pull(ends[1] + 1e-6) == 0
    assert law.share(np.array([0.0, 0.02])).min() == 1


@pytest.mark.parametrize("softness", [1e-300, 1e-6, 0.02, 1e4])
@pytest.mark.parametrize("stretch", [1e-6, 2.0])
def test_the_energy_spent_keeps_its_digits_however_soft(softness, stretch):
    law = BondLaw(softness, stretch)
    end = min(stretch, 60 / softness)
    work = quad(lambda s: s * np.exp(-softness * s), 0, end, epsabs=0, epsrel=1e-12)[0]
    assert law.spent() == pytest.approx(work, rel=1e-11)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
@pytest.mark.parametrize("times", [0.5, 4.0])
def test_another_horizon_keeps_the_toughness_and_if_it_can_the_strength(law, times):
    other = law.at_horizon(times)
    assert other.spent() * times == pytest.approx(law.spent(), rel=1e-9)
    if other.tail:
        assert other.stretch == law.stretch
    else:
        assert other.stretch <= law.stretch * (1 + 1e-9)
    if times < 1:
        assert other.tail > law.tail


@pytest.mark.parametrize("law", [BondLaw(3.0, 0.02, 0.2)])
def test_the_toughness_of_a_lattice_has_the_limit_of_the_theory(law):
    """(C18), of bonds that soften and of those that break at once."""
    errors = []
    for ratio in (4.0, 8.0, 16.0):
        model = solid(1.0, horizon=ratio).model
        limit = 2 * law.spent() * 6 * model.mu * ratio / np.pi
        errors.append(abs(SofteningMaterial(model, law).toughness(1.0) / limit - 1))
    assert errors[2] < 0.03
    assert errors[2] < 0.5 * errors[0]


def strip(law, turned, **options):
    """A strip pulled along its long side, along y or, turned, along x; nodes, displacement."""
    x = rectangle_nodes(12.0, 20.0, 1.0)[:, :: -1 if turned else 1]
    body, ends = lattice_body(x, 1.0, 3.0), np.abs(x[:, 0 if turned else 1]) > 7
    held = np.repeat(ends[:, None], 2, axis=1)
    soft = SoftBody(solid(1.0).model, body, law, held, no_fail=ends, **options)
    return soft, x * ((1.0, 0.0) if turned else (0.0, 1.0))


@pytest.mark.parametrize("line", [[(9, 3.1), (-9, -2.2)]])
def test_the_force_across_a_slanted_line_is_what_pulls_one_side_off_the_other(line):
    soft, unit = strip(BondLaw(5.0), False)
    u = soft.rest(0.02 * unit.ravel(), np.ones(len(soft.stiffness)))
    d = soft.rows @ u
    pull = soft.stiffness * d * np.exp(-5.0 * np.maximum(d / soft.square, 0))
    force = (soft.rows.T @ pull).reshape(-1, 2) * soft.body.spacing**2
    along = np.subtract(line[1], line[0])
    normal = np.array([-along[1], along[0]]) / np.hypot(*along)
    above = (soft.body.x - line[0]) @ normal > 0
    across = soft.levers(line) @ soft.law.pull(soft.stretch(u))
    assert across == pytest.approx(force[above].sum(axis=0) @ normal)


def test_a_load_without_an_equilibrium_is_left_out_and_named():
    law = BondLaw(4.0, 0.05, 0.05)  # a node loses all its bonds on the way: it hangs loose
    soft, unit = torn_plate(law)
    line = [(-30, 0.0), (30, 0.0)]
    with pytest.warns(UserWarning, match=r"load 1.24 and beyond are left out: .* hang loose"):
        run = soft.pull(unit, loads=[0.84, 1.24], line=line)
    assert run.time.tolist() == [0.84]
    assert run["force"][0] > 1
    with pytest.raises(InputError, match="hang loose"):
        soft.pull(unit, loads=[1.24], line=line)


def test_a_gradient_through_an_unstable_body_is_warned_of():
    """Beyond the peak a slow tail has no single path: differences there have nothing in common."""
    soft, unit = torn_plate(BondLaw(4.0, 0.03, 0.2))
    how = {"line": [(-30, 0.0), (30, 0.0)], "stop": 0.3}
    given = torch.tensor(unit, requires_grad=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        soft.pull(unit, loads=[0.8, 0.96, 1.04], **how)
        before = soft.pull(given, loads=[0.8, 0.92], **how)["force"][-1]
    (gradient,) = torch.autograd.grad(before, given)
    way = torch.from_numpy(np.random.default_rng(0).normal(size=unit.shape) * soft.held)
    assert float((gradient * way).sum()) == pytest.approx(
        difference(
            lambda t: soft.pull(unit + t * way.numpy(), loads=[0.8, 0.92], **how)["force"][-1],
            [0.0],
            1e-6,
        )[0],
        rel=1e-5,
    )
    with pytest.warns(UserWarning, match=r"loads 0.96 and 1.04: the body stays unstable"):
        soft.pull(given, loads=[0.8, 0.96, 1.04], **how)


@pytest.mark.parametrize("name", ["softness", "stretch", "tail", "u"])
def test_a_pull_has_the_gradient_of_differences(name, monkeypatch):
    """To the numbers of the bonds and what is held, past the peak, along the path that is taken."""
    monkeypatch.setattr(adjoint, "TOLERANCE", 1e-12)
    problem, rim = plate(20, 5.0, 10.05, True)
    start = {"softness": 4.0, "stretch": 0.05, "tail": 0.05, "u": problem.u}
    start = {key: torch.tensor(value, dtype=torch.float64) for key, value in start.items()}
    loads, section = rate(20) * np.arange(84.0, 112.0, 4.0), [(-30.0, 0.0), (30.0, 0.0)]
    seed = torch.from_numpy(np.random.default_rng(0).normal(size=problem.u.shape)) / 100

    def value(of):
        numbers = {key: of[key] for key in ("softness", "stretch", "tail")}
        body = SofteningMaterial(LPSMaterial(1.0, 1.0, 1.0, [1.0], 10.05), BondLaw(1.0, 0.05, 0.05))
        given = replace(problem, u=of["u"])
        run = simulate(body, given, loads=loads, line=section, no_fail=rim, parameters=numbers)
        assert run["broken"][-1] > 0
        weights = torch.linspace(0.5, 1.0, len(run["force"]), dtype=torch.float64)
        return (weights * run["force"]).sum() + (seed * run.u).sum()

    leaf = start[name].clone().requires_grad_()
    (gradient,) = torch.autograd.grad(value(start | {name: leaf}), leaf)
    way = torch.ones_like(leaf) if name != "u" else torch.from_numpy(problem.u)
    way = way.detach() * (1.0 if name == "u" else start[name])

    def along(t):
        return float(value(start | {name: start[name] + t[0] * way}))

    slope = difference(along, [0.0], 1e-6)[0]
    assert float((gradient * way).sum()) == pytest.approx(slope, rel=1e-6)


def test_a_pull_in_compression_goes_through_all_its_loads():
    soft, unit = torn_plate(BondLaw(4.0, 0.05, 0.05))
    run = soft.pull(-unit, loads=[0.1, 0.2, 0.3], line=[(-30, 0.0), (30, 0.0)])
    assert len(run.time) == 3
    assert (run["force"] < 0).all()
