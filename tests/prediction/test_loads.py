"""Loads to learn from: designed ones, and the next of a pool."""

from dataclasses import replace

import numpy as np
import pytest

import warp_peri as wp
from tests.support.problems import kernel, lattice, manufactured
from warp_peri.points.samples import part
from warp_peri.prediction import design_loads, next_load
from warp_peri.prediction.next_load import of_solid

HORIZON = 2.5
LAW = wp.Micromodulus(HORIZON, "4mm")


@pytest.fixture(scope="module")
def samples():
    """Smooth loads, and behind them short ones."""
    points = lattice(10, HORIZON)
    long = manufactured(kernel("positive", HORIZON), points, 4, wave_number=0.2)
    short = manufactured(kernel("positive", HORIZON), points, 4, seed=3, wave_number=1.5)
    both = {name: np.concatenate([getattr(s, name) for s in (long, short)]) for name in "ub"}
    return replace(long, **both, arrays={})


def test_designed_loads_hold_all_waves_without_a_mean():
    sheet = wp.Points.sheet((20, 20), 5.0)
    loads = design_loads(sheet, shortest_wave=20.0)
    assert loads.shape == (2, 400, 2)
    assert np.abs(loads.mean(axis=1)).max() < 1e-12
    assert np.linalg.norm(loads, axis=-1).max() == pytest.approx(1)
    power = np.abs(np.fft.fft2(loads[0].reshape(20, 20, 2), axes=(0, 1))).sum(axis=-1)
    k = np.hypot(*np.meshgrid(*2 * [np.fft.fftfreq(20)]))
    held = power > 1e-9 * power.max()
    assert held[(k > 0) & (k <= 0.25)].all()
    assert not held[k > 0.25 + 1e-9].any()
    with pytest.raises(wp.InputError, match="box"):
        design_loads(lattice(4, 1.0), 3.0)


def test_the_next_load_is_one_that_tells_something_new(samples):
    known = part(samples, slice(0, 3))
    law = wp.fit(samples, LAW).material
    found = next_load(law, samples, known=known)
    assert found.number >= 4, "a short wave"
    assert found.deviation.shape == (8,)
    assert found.deviation[found.number] == found.deviation.min() < found.before
    assert 0 < found.residual < 0.1
    after = next_load(law, samples, known=part(samples, [0, 1, 2, found.number]))
    assert after.before < found.before


def test_of_a_quantity_and_without_any_load_before(samples):
    law = wp.fit(samples, LAW).material
    at = np.array([[1.2, 0.3]])
    found = next_load(law, samples, lambda one: one.symbol(at))
    again = next_load(law, samples, lambda one: 2 * one.symbol(at))
    assert found.number == again.number
    assert again.before == pytest.approx(2 * found.before, rel=1e-6)
    assert found.residual == 0.02
    with pytest.raises(wp.InputError, match="a crystal model or a linear peridynamic solid"):
        next_load(wp.diffusion.Conductor(HORIZON), samples)


def test_a_solid_is_told_by_what_its_data_lack(samples):
    solid = wp.fit(samples, wp.LPS(HORIZON, wp.Bernstein(3)), progress=False).material
    known = part(samples, slice(0, 3))
    found = next_load(solid, samples, known=known)
    assert found.number >= 4, "a short wave"
    assert found.deviation[found.number] == found.deviation.min() < found.before
    after = next_load(solid, samples, known=part(samples, [0, 1, 2, found.number]))
    assert after.before < found.before
    stiffer = next_load(solid, samples, lambda one: one.mu, known=known)
    again = next_load(solid, samples, lambda one: 3 * one.mu, known=known)
    assert again.before == pytest.approx(3 * stiffer.before, rel=1e-6)
    for one in (replace(solid, dimension=3), replace(solid, trained_on=(), certified_on=())):
        with pytest.raises(wp.InputError, match="expected a solid of a sheet"):
            next_load(one, samples)


def test_slopes_of_a_solid_are_those_of_its_residual(samples):
    """What a load tells of μ alone: L u is λ, μ times fixed fields, so its slope to ln μ is known
    where λ = 0, and a kernel's common scale tells nothing."""
    solid = replace(kernel("positive", HORIZON), trained_on=(1.0,))
    _, _, information = of_solid(solid, None)
    told, pull = information(samples)
    L = solid.on(samples.points, allow_uncertified=True)
    u = samples.u[0]
    by = [
        (replace(solid, mu=solid.mu * f)).on(samples.points, allow_uncertified=True)(u)
        for f in (1.01, 0.99)
    ]
    slope = (by[0] - by[1]) / 0.02
    b = samples.b[0][samples.interior]
    square = (b**2).sum()
    assert told[0, 1, 1] == pytest.approx((slope**2).sum() / square, rel=1e-3)
    assert pull[0, 1] == pytest.approx((slope * (b - L(u))).sum() / square, rel=1e-3, abs=1e-9)
    scale = np.concatenate([[0, 0], solid.D])
    assert np.abs(told @ scale).max() < 1e-6 * np.abs(told).max()


def test_periodic_candidates_need_no_displacement(samples):
    law = wp.fit(samples, LAW).material
    sheet = wp.Points.sheet((12, 12), 1.0, axis=samples.axis)
    loads = design_loads(sheet, shortest_wave=4.0, number=3)
    pool = wp.Samples(sheet, np.zeros_like(loads), loads)
    assert next_load(law, pool, known=part(samples, slice(0, 3))).number in range(3)
