"""Factors of positive definite matrices: banded and sparse ones agree, others are refused."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.linalg import cholesky_banded

from tests.support.sheets import hgo_dictionary, waves
from warp_peri import Points
from warp_peri.materials.hyperelastic import equilibrium
from warp_peri.materials.hyperelastic.equilibrium import StaticProblem
from warp_peri.materials.hyperelastic.operator import HyperelasticOperator


@pytest.mark.parametrize("most", [0, 10**6])
def test_factors_solve_or_say_that_a_matrix_is_not_positive(most, monkeypatch):
    monkeypatch.setattr(equilibrium, "LARGEST_BAND", most)
    random = np.random.default_rng(0)
    A = sp.random(40, 40, 0.2, random_state=0)
    K = (A @ A.T + sp.eye(40)).tocsc()
    y = random.normal(size=(40, 2))
    factors = equilibrium.positive_factors(K)
    np.testing.assert_allclose(K @ factors.solve(y), y, atol=1e-12)
    np.testing.assert_allclose(K @ factors.solve(y[:, 0]), y[:, 0], atol=1e-12)
    order = random.permutation(40)
    band = equilibrium.Band.of(K.indices, K.indptr, order)
    np.testing.assert_allclose(equilibrium.positive_factors(K, band).solve(y), factors.solve(y))
    assert equilibrium.positive_factors((K - 20 * sp.eye(40)).tocsc()) is None
    assert equilibrium.positive_factors((np.nan * K).tocsc()) is None


def test_lattices_have_a_band_as_wide_as_their_shorter_side_and_rough_factors_half_the_bits():
    for sides in ((7, 40), (40, 7)):
        steps = np.argwhere(np.ones(np.add(sides, 12), bool))
        inside = ((steps >= 6) & (steps < np.add(sides, 6))).all(axis=1)
        problem = StaticProblem(HyperelasticOperator(hgo_dictionary(), Points(steps, inside, 1.0)))
        assert problem.pattern.band.width <= 2 * (6 * 7 + 7)
        u, c = 0.01 * waves(Points(steps, inside, 1.0)), np.ones(7)
        K = problem.pattern.matrix(u, c)
        band = problem.pattern.band.filled(K.data)
        factors = equilibrium.BandFactors(
            cholesky_banded(band, lower=True), problem.pattern.band.order
        )
        half = equilibrium.rough(factors)
        y = np.random.default_rng(0).normal(size=(K.shape[0], 2))
        np.testing.assert_allclose(K @ factors.solve(y), y, atol=1e-10)
        np.testing.assert_allclose(half.solve(y), factors.solve(y), rtol=1e-2, atol=1e-3)
        assert half.factor.dtype == np.float32
