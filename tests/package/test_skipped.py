"""What a scene does not use is not computed again."""

import numpy as np
import pytest
import warp as wp

from tests.support.clouds import cloud
from tests.support.problems import kernel, lattice, noise
from warp_peri.launch import launch_slices
from warp_peri.materials import lps_bonds, lps_force
from warp_peri.points import families
from warp_peri.points.families import bond_classes

HORIZON = 3.0


@pytest.fixture
def launched(monkeypatch):
    """Names of the kernels that are launched, in order."""
    names = []

    def note(kernel, *rest, **options):
        names.append(kernel.key)
        launch_slices(kernel, *rest, **options)

    for module in (lps_bonds, lps_force):
        monkeypatch.setattr(module, "launch_slices", note)
    real = wp.Launch.launch  # of what is packed once

    def packed(launch):
        names.append(launch.kernel.key)
        real(launch)

    monkeypatch.setattr(wp.Launch, "launch", packed)
    return names


@pytest.mark.filterwarnings("ignore:spacing. the model is certified")
@pytest.mark.parametrize("points", [lattice(4, HORIZON), cloud(4, HORIZON, 0.1)])
def test_influence_is_not_computed_again_while_only_u_changes(points, launched):
    model = kernel("sign-changing", HORIZON)
    operator = model.on(points, allow_uncertified=True)
    first, second = noise(points, seed=1), noise(points, seed=2)
    operator(first)
    launched.clear()
    again = operator(second)
    assert len(launched) == 1  # dilatation and force at once
    assert "influence" not in launched[0]
    fresh = model.on(points, allow_uncertified=True)(second)
    np.testing.assert_array_equal(again, fresh)


def test_another_model_on_the_same_bonds_is_computed(launched):
    points = lattice(4, HORIZON)
    model, other = kernel("positive", HORIZON), kernel("sign-changing", HORIZON)
    operator = model.on(points)
    operator(noise(points))
    operator.model = other
    expected = other.on(points)(noise(points))
    np.testing.assert_array_equal(operator(noise(points)), expected)


def test_a_pattern_is_weighted_once(monkeypatch):
    own = bond_classes(1.0, 3.7)
    own.weight[:] = np.nan  # what a caller does to its own copy
    monkeypatch.setattr(families, "quadrature_weights", None)
    assert np.isfinite(bond_classes(1.0, 3.7).weight).all()
