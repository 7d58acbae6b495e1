"""A fit whose residual's optimum is worse than local elasticity goes on to displacement."""

import numpy as np
import pytest

from tests.support.problems import LAM, MU, kernel, lattice, manufactured, with_nodes
from warp_peri import Bernstein, Samples, evaluate
from warp_peri.core.elastic import from_voigt, plane_isotropic
from warp_peri.learning.fit import learn
from warp_peri.methods import Optimum

HORIZON = 2.5


@pytest.mark.parametrize("axis", [None, 17.0])
def test_fields_of_local_elasticity_are_fitted_by_displacement(axis):
    random, C = np.random.default_rng(0), from_voigt(plane_isotropic(LAM, MU))
    points = lattice(10, HORIZON)
    u, b = np.zeros((2, 10, *points.x.shape))
    for sample in np.repeat(np.arange(10), 4):
        angle, e = random.uniform(0, 2 * np.pi), random.normal(size=2)
        k = 2 * np.pi / random.uniform(3, 20) * np.array([np.cos(angle), np.sin(angle)])
        wave = np.cos(points.x @ k + random.uniform(0, 2 * np.pi))[:, None]
        u[sample] += wave * e
        b[sample] += wave * np.einsum("ijkl,j,l,k->i", C, k, k, e)
    samples = with_nodes(Samples(points, u, b), axis=axis)
    first, found = (
        learn(samples, HORIZON, Bernstein(4), loss=loss) for loss in ("residual", "auto")
    )
    assert (found.loss.name, len(found.history)) == ("output", len(first.history) + 1)
    assert "worse than local elasticity" in found.loss.reason
    assert found.settings.moduli == pytest.approx((LAM, MU), rel=2e-3)
    errors = [evaluate(one.material, samples)["E_u"] for one in (found, first)]
    assert errors[0] < 0.995 * errors[1]


def test_fields_of_the_solid_itself_are_not():
    samples = manufactured(kernel("1/r", HORIZON), lattice(8, HORIZON), 10)
    method = Optimum(moduli=(LAM, MU))
    assert learn(samples, HORIZON, Bernstein(4), method=method).loss.name == "residual"
