"""Factors of tangents: of narrow bands, in double and single precision, where they are definite."""

import numpy as np

from tests.support.sheets import hgo_dictionary, waves
from warp_peri import Points
from warp_peri.materials.hyperelastic.equilibrium import StaticProblem
from warp_peri.materials.hyperelastic.operator import HyperelasticOperator


def test_lattices_have_a_band_as_wide_as_their_shorter_side_and_rough_factors_half_the_bits():
    for sides in ((7, 40), (40, 7)):
        steps = np.argwhere(np.ones(np.add(sides, 12), bool))
        inside = ((steps >= 6) & (steps < np.add(sides, 6))).all(axis=1)
        points = Points(steps, inside, 1.0)
        problem = StaticProblem(HyperelasticOperator(hgo_dictionary(), points))
        assert problem.pattern.width <= 2 * (6 * 7 + 7)
        u, c = 0.01 * waves(points), np.ones(7)
        K = problem.pattern.matrix(problem.op, u, c)
        factors, stable = problem.factors(c, u)
        assert stable
        half = factors.rough()
        y = np.random.default_rng(0).normal(size=(K.shape[0], 2))
        np.testing.assert_allclose(K @ factors.solve(y), y, atol=1e-10)
        np.testing.assert_allclose(K @ factors.solve(y[:, 0]), y[:, 0], atol=1e-10)
        np.testing.assert_allclose(half.solve(y), factors.solve(y), rtol=1e-2, atol=1e-3)
        assert half.band.dtype == np.float32
        assert problem.factors(-c, u) == (None, False)
        assert problem.factors(c, np.nan * u) == (None, False)
        shifted, stable = problem.factors(-c, u, shifts=True)
        assert not stable
        assert (y[:, 0] @ shifted.solve(y[:, 0])) > 0
