"""λ and μ of long waves, beside what else fields may hold (theory, 28a)."""

import numpy as np
import pytest

from warp_peri import InputError, Points, Samples
from warp_peri.fitting.long_waves import _stresses, lame_of_long_waves

LAM, MU, SIDE = 0.3, 0.7, 24
CONSTANTS = np.array([LAM, MU, -1.0, -3.0, 0.8, 0.0, 0.0, -4.0, 0.0])
"""Of λ, μ, θ³, θq, Re z³, θ⁴, θ²q, q² and θ Re z³."""


def waves(seed: int, size: float, constants: np.ndarray, bent: float = 0.0) -> Samples:
    """Periodic fields of long waves at rest under −div P, and −bent Δ of the linear part."""
    rng, h = np.random.default_rng(seed), 1.0
    line = np.arange(SIDE) * h
    x = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    fields, loads = [], []
    k = 2 * np.pi * np.fft.fftfreq(SIDE, h)
    K = np.stack(np.meshgrid(k, k, indexing="ij"))
    for _ in range(10):
        u = np.zeros((SIDE, SIDE, 2))
        for _ in range(4):
            n, phase = rng.integers(-2, 3, 2), rng.uniform(0, 2 * np.pi)
            wave = np.cos(2 * np.pi / SIDE * (x @ n) + phase).reshape(SIDE, SIDE, 1)
            u += rng.normal(size=2) * wave
        u *= size * SIDE / np.abs(u).max() / 12
        hat = np.fft.fft2(u, axes=(0, 1))
        H = np.fft.ifft2(1j * hat[..., None] * K.transpose(1, 2, 0)[:, :, None], axes=(0, 1)).real
        small = (H + H.swapaxes(-1, -2)) / 2
        trace = np.trace(small, axis1=-2, axis2=-1)[..., None, None]
        P = LAM * trace * np.eye(2) + 2 * MU * small
        if constants.any():
            parts = _stresses(H.reshape(1, -1, 2, 2), 1.0 + 0j, 1)
            P = P + np.tensordot(constants, np.array(parts), 1).reshape(H.shape)
        div = np.einsum("xykl,lxy->xyk", np.fft.fft2(P, axes=(0, 1)), 1j * K)
        b = -np.fft.ifft2(div * (1 - bent * (K**2).sum(axis=0))[..., None], axes=(0, 1)).real
        fields.append(u.reshape(-1, 2))
        loads.append(b.reshape(-1, 2))
    points = Points(x, np.ones(len(x), bool), h, box=(SIDE * h,) * 2, axis=0.0)
    return Samples(points, np.array(fields), np.array(loads))


def test_stresses_are_slopes_of_their_energies():
    """Central differences in float64 of θ, q and z as they are defined."""
    H, turn = 0.1 * np.random.default_rng(0).normal(size=(1, 3, 2, 2)), np.exp(-0.3j)

    def energies(H: np.ndarray) -> np.ndarray:
        small = (H + H.swapaxes(-1, -2)) / 2
        E = small + H.swapaxes(-1, -2) @ H / 2
        theta = np.trace(E, axis1=-2, axis2=-1)
        dev = E - 0.5 * np.eye(2) * theta[..., None, None]
        q = (dev**2).sum(axis=(-1, -2))
        z = ((E[..., 0, 0] - E[..., 1, 1]) / 2 + 1j * E[..., 0, 1]) * turn**2
        linear = np.trace(small, axis1=-2, axis2=-1)
        lame = [theta**2 / 2 - linear**2 / 2, (E**2).sum((-1, -2)) - (small**2).sum((-1, -2))]
        cubes = [(z**3).real, (z**3).imag]
        fourth = [theta**4, theta**2 * q, q**2, *(theta * cube for cube in cubes)]
        return np.array([*lame, theta**3, theta * q, *cubes, *fourth])

    found, step = np.array(_stresses(H, turn, 2)), 1e-6
    for i, j in np.ndindex(2, 2):
        moved = np.zeros((2, 2))
        moved[i, j] = step
        slope = (energies(H + moved) - energies(H - moved)) / (2 * step)
        np.testing.assert_allclose(found[..., i, j], slope, atol=1e-9)


def test_linear_fields_with_dispersion_take_dispersion_alone():
    """Fields whose strains are of no size, as force constants answer, have nothing nonlinear."""
    samples = waves(1, 3.0, np.zeros(9), bent=0.8)
    waves_of = lame_of_long_waves([samples])
    assert waves_of.terms == ("dispersion",)
    assert (waves_of.lam, waves_of.mu) == pytest.approx((LAM, MU), rel=1e-8)


def test_fourth_order_is_taken_where_the_fields_have_it():
    samples = waves(2, 0.1, CONSTANTS)
    found = lame_of_long_waves([samples])
    assert {"third order", "q²"} <= set(found.terms)
    off = np.abs([found.lam - LAM, found.mu - MU])
    assert (off < 5e-3 * MU).all()
    assert (found.errors < 5e-3 * MU).all()


def test_an_axis_that_is_not_stated_is_learned_and_fields_of_one_wave_are_refused():
    stated = waves(3, 0.1, CONSTANTS)
    points = Points(stated.x, stated.interior, 1.0, box=stated.points.box)
    one, other = (
        lame_of_long_waves([each]) for each in (stated, Samples(points, stated.u, stated.loads))
    )
    assert (one.lam, one.mu) == pytest.approx((other.lam, other.mu), abs=5e-3 * MU)
    with pytest.raises(InputError, match="moduli: the long waves of these loads"):
        lame_of_long_waves([Samples(points, 0 * stated.u, stated.loads)])
