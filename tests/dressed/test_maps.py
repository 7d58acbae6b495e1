"""Maps of moduli from fields."""

from dataclasses import replace

import numpy as np
import pytest

import warp_peri as wp
from tests.dressed.solids import SPACING, solid
from warp_peri.dressed import fit_density, fit_maps
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


def test_a_law_of_density_is_carried_to_another_sheet():
    """Learned on a ramp, it answers on a blob; far beyond its densities the nearest is taken."""
    law, points = solid(), wp.Points.sheet((16, 16), SPACING)
    x, y = points.x.T / SPACING
    ramp = 1 - 0.08 * (1 - np.abs(x - 8) / 8)
    blob = 1 - 0.07 * np.exp(-((x - 5) ** 2 + (y - 9) ** 2) / 8)
    truth = {"bulk": (-5.0, 9.0), "shear": (-4.0, 2.0), "tetragonal": (-2.0, 3.0)}

    def maps(rho):
        return {name: 1 + a * (1 - rho) + b * (1 - rho) ** 2 for name, (a, b) in truth.items()}

    found = fit_density(sheet(law, maps(ramp), points), law, ramp, parts="each")
    # sites have means of d and d² of their nodes, in the maps and in the fit alike
    for name, numbers in truth.items():
        np.testing.assert_allclose(found.coefficients[name], numbers, rtol=1e-6)
        assert (found.spread[name] < 1e-3).all()
    for name, values in maps(blob).items():
        np.testing.assert_allclose(found.maps(blob)[name], values, rtol=1e-7)
    with pytest.warns(UserWarning, match="learned from 0.920 to 1.000, got 0.800"):
        clipped = found.maps(1 - 0.2 * (1 - ramp) / 0.08)
    assert clipped["bulk"].min() == pytest.approx(1 - 5 * 0.08 + 9 * 0.08**2)
    one = fit_density(sheet(law, maps(ramp), points), law, ramp)
    assert -5 < one.coefficients["bulk"][0] < -2
    assert one.spread["bulk"][0] > found.spread["bulk"][0]
    with pytest.raises(InputError, match="expected one that varies enough"):
        fit_density(sheet(law, maps(ramp), points), law, 1 - 0 * ramp)
    with pytest.raises(InputError, match="density: expected 256 numbers"):
        fit_density(sheet(law, maps(ramp), points), law, ramp[:9])


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
    fit = fit_maps(samples, law, smoothness=1e-9)
    for name, values in maps.items():
        np.testing.assert_allclose(fit.maps[name], values, atol=2e-3)
        assert (fit.spread[name] > 0).all()
    chosen = fit_maps(samples, law)
    assert chosen.smoothness < 0.1
    assert SPACING < fit.resolution < chosen.resolution < 16 * SPACING
    assert np.abs(chosen.maps["shear"] - maps["shear"]).max() < 0.1
    same = fit_maps(samples, law, parts="one")
    assert np.array_equal(same.maps["bulk"], same.maps["shear"])
    left = [min(one.history["left_out"].values()) for one in (chosen, same)]
    assert left[0] < 0.2 * left[1]
    with pytest.warns(UserWarning, match="2.6 apart, the fields are smoothed over 6.*give 3 times"):
        seen = fit_maps(samples, law, smoothness=1e-9, smoothing=6.0)
    assert fit.resolution < seen.resolution == 6.0
    with pytest.raises(InputError, match="radius > 0"):
        fit_maps(samples, law, smoothing=-1.0)
    with pytest.raises(InputError, match="expected a divisor of 16, 16 nodes"):
        fit_maps(samples, law, coarse=3)
    with pytest.raises(InputError, match="'each' or 'one'"):
        fit_maps(samples, law, parts="two")
    with pytest.raises(InputError, match="expected loads"):
        fit_maps(wp.Samples(points, samples.u, 0 * samples.b), law)
