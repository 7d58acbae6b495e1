"""λ and μ of long waves, beside what else fields may hold (theory, 28a)."""

import numpy as np
from numpy.random import default_rng

from tests.support import approx, refused
from tests.support.nonlinear import strain
from tests.support.problems import difference, everywhere, normal
from warp_peri import Points, Samples
from warp_peri.fitting.long_waves import _stresses, lame_of_long_waves
from warp_peri.points.points import grid_places

LAM, MU, SIDE = 0.3, 0.7, 24
CONSTANTS = np.array([LAM, MU, -1.0, -3.0, 0.8, 0.0, 0.0, -4.0, 0.0])
"""Of λ, μ, θ³, θq, Re z³, θ⁴, θ²q, q² and θ Re z³."""


def waves(seed, size, constants, bent=0.0):
    """Periodic fields of long waves at rest under −div P, and −bent Δ of the linear part."""
    rng, count = default_rng(seed), 10
    x = grid_places((SIDE, SIDE)).astype(float)
    n, phase = rng.integers(-2, 3, (count, 4, 2)), rng.uniform(0, 2 * np.pi, (count, 4))
    wave = np.cos(2 * np.pi / SIDE * (n @ x.T) + phase[..., None])
    u = np.einsum("smn,smk->snk", wave, rng.normal(size=(count, 4, 2)))
    u *= size * SIDE / 12 / np.abs(u).max(axis=(1, 2), keepdims=True)
    K = 2 * np.pi * np.stack(np.meshgrid(*2 * [np.fft.fftfreq(SIDE)], indexing="ij"), axis=-1)
    hat = np.fft.fft2(u.reshape(count, SIDE, SIDE, 2), axes=(1, 2))
    H = np.fft.ifft2(1j * hat[..., None] * K[:, :, None], axes=(1, 2)).real
    small = (H + H.swapaxes(-1, -2)) / 2
    P = LAM * np.trace(small, axis1=-2, axis2=-1)[..., None, None] * np.eye(2) + 2 * MU * small
    if constants is not None:
        P = P + np.tensordot(constants, _stresses(H, 1.0 + 0j, 1), 1)
    div = np.einsum("sxykl,xyl->sxyk", np.fft.fft2(P, axes=(1, 2)), 1j * K)
    b = -np.fft.ifft2(div * (1 - bent * (K**2).sum(2))[..., None], axes=(1, 2)).real
    return Samples(everywhere(x, box=(SIDE,) * 2, axis=0.0), u, b.reshape(u.shape))


def test_stresses_are_slopes_of_their_energies():
    """Central differences in float64 of θ, q and z as they are defined."""
    H = 0.1 * normal((1, 3, 2, 2))

    def energies(H):
        (E, theta, z), small = strain(H, 0.3), (H + H.swapaxes(-1, -2)) / 2
        linear, q = np.trace(small, axis1=-2, axis2=-1), 2 * abs(z) ** 2
        lame = [theta**2 / 2 - linear**2 / 2, (E**2).sum((-1, -2)) - (small**2).sum((-1, -2))]
        cubes = [(z**3).real, (z**3).imag]
        fourth = [theta**4, theta**2 * q, q**2, *(theta * cube for cube in cubes)]
        return np.array([*lame, theta**3, theta * q, *cubes, *fourth])

    found = np.array(_stresses(H, np.exp(-0.3j), 2))
    slopes = difference(lambda move: energies(H + move.reshape(2, 2)), np.zeros(4), 1e-6, order=2)
    assert np.moveaxis(slopes, 0, -1).reshape(found.shape) == approx(found, abs=1e-9)


def test_linear_fields_with_dispersion_take_dispersion_alone():
    """Fields whose strains are of no size, as force constants answer, have nothing nonlinear."""
    found = lame_of_long_waves([waves(1, 3.0, None, bent=0.8)])
    assert found.terms == ("dispersion",)
    assert (found.lam, found.mu) == approx((LAM, MU), rel=1e-8)


def test_fourth_order_is_taken_where_fields_have_it_and_an_axis_not_stated_is_learned():
    stated = waves(2, 0.1, CONSTANTS)
    found = lame_of_long_waves([stated])
    assert {"third order", "q²"} <= set(found.terms)
    assert (found.errors < 5e-3 * MU).all()
    points = Points(stated.x, stated.interior, 1.0, box=stated.points.box)
    for one in (found, lame_of_long_waves([Samples(points, stated.u, stated.loads)])):
        assert (one.lam, one.mu) == approx((LAM, MU), abs=5e-3 * MU)
    with refused("moduli: the long waves of these loads"):
        lame_of_long_waves([Samples(points, 0 * stated.u, stated.loads)])
