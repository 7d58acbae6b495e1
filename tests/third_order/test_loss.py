"""The reduced regression of the nonlinear solid against the full residual."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.nonlinear import FORMS, solid
from tests.support.problems import REDUCED, lattice, noise
from warp_peri import InputError, Samples
from warp_peri.learning.nonlinear import reduce_nonlinear
from warp_peri.learning.response import products
from warp_peri.third_order.operator import PlacedThirdOrder


@pytest.fixture(params=FORMS)
def problem(request):
    """A model, two sets of random samples, their weights, and the loss."""
    model = solid(request.param)
    points = lattice(4, 3.0)
    sets = [
        Samples(points, 0.05 * noise(points, 6, seed), 0.1 * noise(points, 6, seed + 1))
        for seed in (0, 2)
    ]
    weights = [np.linspace(1, 2, 6), np.linspace(0.2, 0.4, 6)]
    operator = PlacedThirdOrder(model, points)
    p = model.weights(operator.sweeps.classes)
    return model, sets, weights, reduce_nonlinear(sets, 3.0, weights, p)


def full(model, sets, weights):
    total = 0.0
    for samples, weight in zip(sets, weights):
        left = PlacedThirdOrder(model, samples)(samples.u) - samples.loads[:, samples.interior]
        total += weight @ (left**2).sum(axis=(1, 2))
    return total


def test_reduced_is_full_loss_and_the_constants_are_its_minimum(problem):
    model, sets, weights, loss = problem
    c, (lam, mu) = products(model.linear, loss.classes), (model.linear.lam, model.linear.mu)
    constants = np.array([model.t3, model.tq2, model.q3])
    expected = full(model, sets, weights)
    assert abs(loss.loss(constants, c, lam, mu) - expected) <= REDUCED * expected
    best = loss.constants(c, lam, mu)
    least = loss.loss(best, c, lam, mu)
    left = loss.reduced(lam, mu).R @ c  # constants projected out
    assert left @ left == pytest.approx(least, rel=1e-9)
    t3, tq2, q3 = best
    assert full(replace(model, t3=t3, tq2=tq2, q3=q3), sets, weights) == pytest.approx(least)
    for change in np.eye(3):
        assert loss.loss(best + change, c, lam, mu) > least


def test_sets_of_several_spacings_are_refused(problem):
    model, sets, weights, loss = problem
    coarse = lattice(4, 6.0, spacing=2.0)
    other = Samples(coarse, noise(coarse, 6), noise(coarse, 6))
    p = model.weights(loss.classes)
    with pytest.raises(InputError, match="lattices of one spacing"):
        reduce_nonlinear([sets[0], other], 3.0, weights, p)
