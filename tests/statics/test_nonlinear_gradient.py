"""The gradient of an equilibrium against differences of whole solves."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.statics.test_nonlinear import problem, proven
from tests.support.nonlinear import FORMS
from tests.support.problems import difference, noise
from tests.support.solving import solve_nonlinear
from warp_peri.operator.nonlinear import NonlinearOperator
from warp_peri.statics.nonlinear_gradient import nonlinear_equilibrium


@pytest.mark.filterwarnings("ignore:strain")
@pytest.mark.parametrize("form", FORMS)
def test_gradient_of_a_solution(form):
    model = proven(form)
    points, u, b = problem(model, 0.02, interior=3)
    operator = NonlinearOperator(model, points)
    seed = noise(points, seed=8)
    leaves = [torch.tensor(field[None], requires_grad=True) for field in (b, u)]
    tables, bulk = operator.tables.clone().requires_grad_(), operator.bulk.clone().requires_grad_()
    numbers = operator.numbers.clone().requires_grad_()
    parameters = {"tables": tables, "bulk": bulk, "numbers": numbers}
    solved = nonlinear_equilibrium(model, points, *leaves, **parameters, tolerance=1e-12)
    by = torch.autograd.grad((solved[0] * torch.from_numpy(seed)).sum(), [*leaves, numbers])
    directions = noise(points, 2, seed=9) * 0.01

    def value(load, collar, solid=model):
        solved = solve_nonlinear(solid, points, load, collar, tolerance=1e-13)
        return (solved * seed).sum()

    along_b = difference(lambda t: value(b + np.tensordot(t, directions, 1), u), np.zeros(2), 1e-2)
    along_u = difference(lambda t: value(b, u + np.tensordot(t, directions, 1)), np.zeros(2), 1e-2)
    for slopes, gradient in ((along_b, by[0]), (along_u, by[1])):
        expected = (directions * gradient[0].numpy()).sum(axis=(1, 2))
        assert np.abs(slopes - expected).max() <= 1e-7 * np.abs(slopes).max()

    def of_t3(change):
        return value(b, u, replace(model, t3=model.t3 + change[0]))

    slope = difference(of_t3, np.zeros(1), 0.05)[0]
    assert float(by[2][2]) == pytest.approx(slope, rel=1e-6)
