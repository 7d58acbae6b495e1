"""Bonds that soften and fail: linear limit, energy spent, a peak, gradients."""

from dataclasses import replace

import numpy as np
import torch
from scipy.integrate import quad
from torch.autograd import grad

from tests.gradients.cases import assert_slopes
from tests.support import approx, near, parametrize, refused, warned
from tests.support.clouds import plain
from tests.support.fields import double
from tests.support.problems import everywhere, normal
from warp_peri import Cracked, simulate
from warp_peri.fracture import BondLaw, SofteningMaterial, adjoint, lattice_body
from warp_peri.fracture.adjoint import SoftBody
from warp_peri.fracture.statics import CutSolid
from warp_peri.points.points import grid_places

MODEL, LINE = plain(10.05, 1.0, 1.0), [(-30.0, 0.0), (30.0, 0.0)]
CRACK = [[(-10, 0), (10, 0)]]


def torn_problem():
    """The published plate, small, its ends moved by one; and nodes whose bonds do not break."""
    x = 5.0 * (grid_places((9, 16)) - (4.0, 7.5))
    free = np.column_stack([x[:, 0] != 0, np.abs(x[:, 1]) < 36])
    start, given = x * (-1 / 120, 1 / 40), np.sign(x) * (0.0, 1.0)
    problem = Cracked(everywhere(x, 5.0), u=np.where(free, start, given), cracks=CRACK, free=free)
    return problem, np.abs(x[:, 1]) > 19.9


def torn_plate(*law):
    """The same as SoftBody, and its displacement at unit load."""
    problem, rim = torn_problem()
    body, how = lattice_body(problem.points.x, 5.0, 10.05), {"cracks": CRACK, "no_fail": rim}
    return SoftBody(MODEL, body, BondLaw(*law), problem.held, **how), problem.u


def test_without_softness_it_is_the_linear_body():
    soft, unit = torn_plate(0.0)
    run = soft.pull(unit, loads=[0.1, 0.2], line=LINE)
    assert run["force"][1] == approx(2 * run["force"][0])
    linear = CutSolid(MODEL, soft.body, soft.held, cracks=CRACK)
    at_rest = soft.rest(unit.ravel(), np.ones(len(soft.stiffness))).reshape(-1, 2)
    assert at_rest == approx(linear.solve(None, unit).u, abs=1e-7)


@parametrize(
    "law", [(0.0, 0.06), (5.0, 0.06), (5.0, 0.05, 0.03), (1e-300, 1e-6), (0.02, 2.0), (1e4, 2.0)]
)
def test_the_energy_spent_is_the_work_of_pulling_a_bond_apart_however_soft(law):
    law = BondLaw(*law)

    def pull(s):
        worst = np.array([s])
        return float((law.pull(worst) * law.share(worst))[0])

    first, *ends = min(law.stretch, 60 / (law.softness or 1)), law.stretch, law.stretch + law.tail
    exact = {"epsabs": 0, "epsrel": 1e-12}
    near(law.spent(), quad(pull, 0, first, **exact)[0] + quad(pull, *ends, **exact)[0], 1e-11)
    assert pull(ends[1] * (1 + 1e-9)) == 0
    assert law.share(ends[0] * np.array([0.0, 0.4])).min() == 1


def test_a_load_without_an_equilibrium_is_left_out_and_named():
    """None is in compression; in tension a node loses all its bonds and hangs loose."""
    soft, unit = torn_plate(4.0, 0.05, 0.05)
    assert (soft.pull(-unit, loads=[0.1, 0.2, 0.3], line=LINE)["force"] < [0, 0, 0]).all()
    with warned(r"load 1.24 and beyond are left out: .* hang loose"):
        run = soft.pull(unit, loads=[0.84, 1.24], line=LINE)
    assert run.time.tolist() == [0.84]
    assert run["force"][0] > 1
    with refused("hang loose"):
        soft.pull(unit, loads=[1.24], line=LINE)


def test_a_gradient_through_an_unstable_body_is_warned_of():
    """Beyond the peak a slow tail has no single path: differences there have nothing in common."""
    soft, unit = torn_plate(4.0, 0.03, 0.2)
    how = {"loads": [0.8, 0.96, 1.04], "line": LINE, "stop": 0.3}
    soft.pull(unit, **how)  # a warning would be an error
    with warned(r"loads 0.96 and 1.04: the body stays unstable"):
        soft.pull(torch.tensor(unit, requires_grad=True), **how)


def test_a_pull_has_the_gradient_of_differences(monkeypatch):
    """To the numbers of the bonds and what is held, past the peak, along the path that is taken."""
    monkeypatch.setattr(adjoint, "TOLERANCE", 1e-12)
    problem, rim = torn_problem()
    start = {"softness": 4.0, "stretch": 0.05, "tail": 0.05, "u": problem.u}
    start = {key: double(value) for key, value in start.items()}
    seed = torch.from_numpy(normal(problem.u.shape)) / 100
    solid = SofteningMaterial(MODEL, BondLaw(1.0, 0.05, 0.05))

    def value(of):
        numbers = {key: of[key] for key in ("softness", "stretch", "tail")}
        how = {"loads": [0.84, 0.92, 1.0], "line": LINE, "no_fail": rim, "parameters": numbers}
        run = simulate(solid, replace(problem, u=of["u"]), **how)
        assert run["broken"][-1] > 0
        weights = torch.linspace(0.5, 1.0, len(run["force"]), dtype=torch.float64)
        return (weights * run["force"]).sum() + (seed * run.u).sum()

    assert_slopes(value, start, 1e-4, 1e-6)
    leaf = start["stretch"].clone().requires_grad_()  # not felt by a body at rest
    how = {"loads": [1.0], "line": LINE, "parameters": {"stretch": leaf}}
    run = simulate(solid, replace(problem, u=0 * problem.u), **how)
    assert not grad(run["force"].sum(), leaf)[0]
    slopes, how["parameters"] = [], {"softness": leaf}
    for law in (BondLaw(4.0), BondLaw(4.0, 1e6, 0.1)):  # neither of which fails
        run = simulate(SofteningMaterial(MODEL, law), problem, **how)
        slopes += grad(run["force"].sum(), leaf)
    assert slopes[0] == slopes[1] != 0
