"""Bonds that soften and fail: linear limit, energy's derivative, a peak, another horizon."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.integrate import quad

from tests.support.problems import difference
from warp_peri import Cracked, InputError, LPSMaterial, Points, simulate
from warp_peri.fracture import BondLaw, SofteningMaterial, adjoint, lattice_body
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


@pytest.mark.parametrize(("softness", "stretch"), [(1e-300, 1e-6), (0.02, 2.0), (1e4, 2.0)])
def test_the_energy_spent_keeps_its_digits_however_soft(softness, stretch):
    law = BondLaw(softness, stretch)
    end = min(stretch, 60 / softness)
    work = quad(lambda s: s * np.exp(-softness * s), 0, end, epsabs=0, epsrel=1e-12)[0]
    assert law.spent() == pytest.approx(work, rel=1e-11)


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


def test_a_pull_has_the_gradient_of_differences(monkeypatch):
    """To the numbers of the bonds and what is held, past the peak, along the path that is taken."""
    monkeypatch.setattr(adjoint, "TOLERANCE", 1e-12)
    problem, rim = plate(20, 5.0, 10.05, True)
    start = {"softness": 4.0, "stretch": 0.05, "tail": 0.05, "u": problem.u}
    start = {key: torch.tensor(value, dtype=torch.float64) for key, value in start.items()}
    loads, section = rate(20) * np.arange(84.0, 108.0, 8.0), [(-30.0, 0.0), (30.0, 0.0)]
    seed = torch.from_numpy(np.random.default_rng(0).normal(size=problem.u.shape)) / 100

    def value(of):
        numbers = {key: of[key] for key in ("softness", "stretch", "tail")}
        body = SofteningMaterial(LPSMaterial(1.0, 1.0, 1.0, [1.0], 10.05), BondLaw(1.0, 0.05, 0.05))
        given = replace(problem, u=of["u"])
        run = simulate(body, given, loads=loads, line=section, no_fail=rim, parameters=numbers)
        assert run["broken"][-1] > 0
        weights = torch.linspace(0.5, 1.0, len(run["force"]), dtype=torch.float64)
        return (weights * run["force"]).sum() + (seed * run.u).sum()

    leaves = {key: one.clone().requires_grad_() for key, one in start.items()}
    gradients = torch.autograd.grad(value(leaves), list(leaves.values()))
    for (name, own), gradient in zip(start.items(), gradients):
        along = lambda t, n=name, x=own: float(value(start | {n: (1 + t[0]) * x}))
        slope = difference(along, [0.0], 1e-6)[0]
        assert float((gradient * own).sum()) == pytest.approx(slope, rel=1e-6), name
    leaf = start["stretch"].clone().requires_grad_()  # not felt by a body at rest
    body = SofteningMaterial(LPSMaterial(1.0, 1.0, 1.0, [1.0], 10.05), BondLaw(1.0, 0.05, 0.05))
    how = {"loads": [1.0], "line": section, "parameters": {"stretch": leaf}}
    run = simulate(body, replace(problem, u=0 * problem.u), **how)
    assert not torch.autograd.grad(run["force"].sum(), leaf)[0]


def test_a_pull_in_compression_goes_through_all_its_loads():
    soft, unit = torn_plate(BondLaw(4.0, 0.05, 0.05))
    run = soft.pull(-unit, loads=[0.1, 0.2, 0.3], line=[(-30, 0.0), (30, 0.0)])
    assert len(run.time) == 3
    assert (run["force"] < 0).all()
