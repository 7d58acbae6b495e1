"""Coefficients from fields: recovered where the dictionary holds the truth."""

import numpy as np
import pytest

from tests.support.sheets import everything, hgo_dictionary, square, waves
from warp_peri import InputError
from warp_peri.learning.energy_fit import equations, fit_energy, non_negative, residual
from warp_peri.operator.hyperelastic import HyperelasticOperator

TRUTH = np.array([0.2, 0.15, 0.1, 0.1, 0.07, 0.08, 0.2])


@pytest.fixture(scope="module")
def samples():
    points = square(4)
    op = HyperelasticOperator(hgo_dictionary(), points)
    u = np.stack([waves(points, 0.3, seed) for seed in range(3)])
    b = op.everywhere(u, TRUTH)
    return square(4, u=u, b=b)


def test_least_squares_finds_the_truth(samples):
    fit = fit_energy(samples, hgo_dictionary(), ridge=0.0)
    np.testing.assert_allclose(fit.solid.coefficients, TRUTH, rtol=1e-6)
    assert fit.residual < 1e-8
    assert 1.1 < fit.solid.stretch < 1.8


def test_signs_are_kept_and_bounds_too(samples):
    fit = fit_energy(samples, hgo_dictionary(), positive=True, stiffness=0.12)
    c = fit.solid.coefficients
    assert (c[:4] >= 0.12).all()
    assert (c >= 0).all()
    assert fit.residual < 0.2


def test_the_reduced_equations_are_the_equations(samples):
    op = HyperelasticOperator(everything(), samples)
    system = equations(op, samples)
    c = np.random.default_rng(0).normal(size=len(op.dictionary))
    b = samples.b[:, op.interior]
    left = np.linalg.norm((op.force(samples.u, c) - b).reshape(3, -1), axis=1)
    size = np.linalg.norm(b.reshape(3, -1), axis=1)
    assert residual(system, c) == pytest.approx(np.sqrt(np.mean((left / size) ** 2)), rel=1e-8)
    assert (non_negative(system) >= 0).all()


def test_what_cannot_be_learned_is_refused(samples):
    with pytest.raises(InputError, match="convex and stress-free"):
        fit_energy(samples, everything(), positive=True)
    with pytest.raises(InputError, match="loads are not known"):
        fit_energy(square(4, u=samples.u), hgo_dictionary())
