"""The linear peridynamic solid learned from fields on a cubic lattice."""

import numpy as np
import pytest

import warp_peri as wp
from tests.support import cubes
from warp_peri.crystals import crystal_from_lps
from warp_peri.methods import GaussNewton


@pytest.fixture(scope="module")
def made():
    """Rough and smooth fields on a period, and the loads that a model answers them with."""
    model = cubes.solid(2.0, 0.5, 0.8, D=[1.0, 0.6, 1.4])
    points, random = cubes.periodic_cube((10, 10, 10)), np.random.default_rng(0)
    k = 2 * np.pi / 10 * random.integers(-2, 3, size=(4, 3))
    u = random.normal(size=(4, 1000, 3)) + 10 * np.sin(points.x @ k.T).T[:, :, None]
    return model, wp.Samples(points, u, crystal_from_lps(model, 1.0).on(points)(u))


def test_a_model_is_found_again_with_its_proof(made):
    model, samples = made
    fit = wp.fit(samples, wp.LPS(2.0, wp.Bernstein(2)))
    assert fit.material.lam == pytest.approx(0.5, rel=1e-6)
    found, true = (one.influence(np.linspace(0.5, 2.0, 9)) for one in (fit.material, model))
    np.testing.assert_allclose(found / found[0], true / true[0], rtol=1e-6)
    proven = crystal_from_lps(model, 1.0).certificate.proven
    assert fit.certificate.symbol_bound == pytest.approx(proven)


@pytest.mark.parametrize("moduli", ["isotropic", (0.5, 0.8)])
def test_long_waves_are_isotropic_where_asked(made, moduli):
    fit = wp.fit(made[1], wp.LPS(2.0, wp.Bernstein(2), method=GaussNewton(moduli=moduli)))
    C = crystal_from_lps(fit.material, 1.0).moduli()
    assert C["C11"] - C["C12"] == pytest.approx(2 * C["C44"])
    if moduli != "isotropic":
        assert (C["C12"], C["C44"]) == pytest.approx(moduli)
