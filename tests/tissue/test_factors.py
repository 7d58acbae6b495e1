"""Factors of positive definite matrices: full and sparse ones agree, others are refused."""

import numpy as np
import pytest
import scipy.sparse as sp

from warp_peri.tissue import equilibrium


@pytest.mark.parametrize("full", [0, 100])
def test_factors_solve_or_say_that_a_matrix_is_not_positive(full, monkeypatch):
    monkeypatch.setattr(equilibrium, "DENSE", full)
    random = np.random.default_rng(0)
    A = sp.random(40, 40, 0.2, random_state=0)
    K = (A @ A.T + sp.eye(40)).tocsc()
    y = random.normal(size=(40, 2))
    factors = equilibrium.positive_factors(K)
    np.testing.assert_allclose(K @ factors.solve(y), y, atol=1e-12)
    np.testing.assert_allclose(K @ factors.solve(y[:, 0]), y[:, 0], atol=1e-12)
    assert equilibrium.positive_factors((K - 20 * sp.eye(40)).tocsc()) is None
    assert equilibrium.positive_factors((np.nan * K).tocsc()) is None
