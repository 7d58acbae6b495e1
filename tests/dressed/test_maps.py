"""Maps of moduli from fields."""

from dataclasses import replace

import numpy as np
import pytest

import warp_peri as wp
from tests.dressed.solids import SPACING, solid
from warp_peri.dressed import fit_maps
from warp_peri.errors import InputError


def sheet(law, maps, points, loads=6):
    """Answers to random waves."""
    rng = np.random.default_rng(0)
    b = np.zeros((loads, *points.x.shape))
    for one in b:
        for _ in range(12):
            k = 2 * np.pi * rng.integers(-3, 4, 2) / np.array(points.box)
            one += rng.normal(size=2) * np.cos(points.x @ k + rng.uniform(0, 6))[:, None]
        one -= one.mean(axis=0)
    body = law.on(points, maps=maps)
    u = wp.solve(body, wp.Dirichlet(points, b, 0 * b)).u
    return wp.Samples(points, u, b)


def test_a_map_is_found_again():
    """Two maps, linear between every second node, from what they answer; and one from two loads."""
    law = solid()
    isotropic = np.array([[1.25, -0.2, 0], [-0.2, 1.25, 0], [0, 0, 0.725]])
    law = replace(law, elastic=isotropic)
    points = wp.Points.sheet((16, 16), SPACING)
    x = points.x / SPACING
    hat = np.prod(1 - np.abs(x - 8) / 8, axis=1)
    maps = {"bulk": 1 + 0.3 * hat, "shear": 1 - 0.5 * hat}
    samples = sheet(law, maps, points)
    fit = fit_maps(law, samples, smoothness=1e-9)
    for name, values in maps.items():
        np.testing.assert_allclose(fit.maps[name], values, atol=2e-3)
        assert (fit.spread[name] > 0).all()
    chosen = fit_maps(law, samples)
    assert chosen.smoothness < 0.1
    assert np.abs(chosen.maps["shear"] - maps["shear"]).max() < 0.1
    same = fit_maps(law, samples, parts="one")
    assert np.array_equal(same.maps["bulk"], same.maps["shear"])
    left = [min(one.history["left_out"].values()) for one in (chosen, same)]
    assert left[0] < 0.2 * left[1]
    with pytest.raises(InputError, match="expected a divisor of 16, 16 nodes"):
        fit_maps(law, samples, coarse=3)
    with pytest.raises(InputError, match="'each' or 'one'"):
        fit_maps(law, samples, parts="two")
    with pytest.raises(InputError, match="expected loads"):
        fit_maps(law, wp.Samples(points, samples.u, 0 * samples.b))
