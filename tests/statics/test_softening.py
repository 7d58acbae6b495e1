"""Bonds that soften: linear limit, energy's derivative at rest, and a peak."""

import numpy as np
import pytest

from examples.published_plate import plate, pulled, same_toughness
from tests.support.bodies import plate as lattice
from tests.support.bodies import solid
from warp_peri import InputError, Model
from warp_peri.statics.cracked import CutSolid
from warp_peri.statics.softening import SoftBody


def test_without_softness_it_is_the_linear_body():
    soft, unit = plate(20, 5.0, 10.05, 0.0, True)
    times = np.array([10.0, 20.0])
    run = pulled(20, times, 0.0, np.inf, horizon=10.05)
    assert run.force[1] == pytest.approx(2 * run.force[0])
    crack = [[(-10, 0), (10, 0)]]
    linear = CutSolid(Model(1.0, 1.0, 0.0, [1.0], 10.05), soft.body, soft.held, cracks=crack)
    np.testing.assert_allclose(
        soft.rest(unit.ravel().astype(float), np.ones(len(soft._k))).reshape(-1, 2),
        linear.solve(unit),
        atol=1e-7,
    )


def test_softer_bonds_pull_less_and_broken_ones_make_a_peak():
    times = np.arange(20.0, 400.0, 20.0)
    stiff, soft = (pulled(20, times, beta, np.inf, horizon=10.05) for beta in (0.0, 4.0))
    assert (soft.force < stiff.force).all()
    broken = pulled(20, times, 4.0, 0.05, horizon=10.05)
    assert broken.peak[1] < soft.force.max()
    assert broken.broken[-1] > 0
    assert broken.force[-1] < broken.peak[1]


def test_the_same_toughness_at_a_longer_horizon():
    assert same_toughness(0.06, 0.0, 2.0) == pytest.approx(0.06 / np.sqrt(2), rel=1e-6)
    assert 0.06 / np.sqrt(2) > same_toughness(0.06, 5.0, 2.0) > 0.03


def test_dilatation_and_stiffening_are_refused():
    body = lattice(8, 8)
    held = np.abs(body.x) > 3
    with pytest.raises(InputError, match="expected λ = μ"):
        SoftBody(solid(0.5).model, body, 1.0, held)
    with pytest.raises(InputError, match="softness"):
        SoftBody(solid().model, body, -1.0, held)
