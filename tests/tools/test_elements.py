"""Elements of local elasticity, which models are held against."""

import numpy as np
import pytest

pytest.importorskip("skfem")

import warp_peri as wp
from tools.elements import errors_of_local, piola
from warp_peri.core.elastic import plane_isotropic, voigt_to_tensor

C = np.array([[1.3, 0.3, 0.1], [0.3, 0.9, -0.05], [0.1, -0.05, 0.4]])


def test_elements_of_local_elasticity_are_of_fourth_order_in_the_wave_length():
    """And their error is 1e-4 already where a wave has ten nodes."""
    x = 5.0 * np.argwhere(np.ones((19, 19)))
    points = wp.Points(x, (np.abs(x - 45.0) <= 15.1).all(axis=1), 5.0)
    a, lengths, errors = np.array([0.02, -0.01]), np.array([6.0, 10.0, 14.0]), []
    for length in lengths:
        k = 2 * np.pi / (5.0 * length) * np.array([np.cos(0.4), np.sin(0.4)])
        wave = np.sin(x @ k + 0.3)[:, None]
        b = np.einsum("ijkl,j,l,k->i", voigt_to_tensor(C), k, k, a) * wave
        errors.append(errors_of_local(wp.Samples(points, (wave * a)[None], b[None]), C)[0])
    assert errors[1] < 1e-4
    assert -np.polyfit(np.log(lengths), np.log(errors), 1)[0] > 3.8


def test_third_order_elements_have_the_stress_of_their_energy():
    third, isotropic, step = (-0.5, -6.8, 1.04), voigt_to_tensor(plane_isotropic(0.3, 0.7)), 1e-5
    H = 0.1 * np.random.default_rng(0).normal(size=(2, 2))

    def energy(H):
        E = (H + H.T + H.T @ H) / 2
        t, q = np.trace(E), (E[0, 0] - E[1, 1]) / 2 + 1j * E[0, 1]
        cubic = third[0] * t**3 + third[1] * t * abs(q) ** 2 + third[2] * (q**3).real
        return np.einsum("ij,ijkl,kl", E, isotropic, E) / 2 + cubic

    for one in np.eye(4).reshape(4, 2, 2):
        slope = (energy(H + step * one) - energy(H - step * one)) / (2 * step)
        assert (piola(H, isotropic, third) * one).sum() == pytest.approx(slope, abs=1e-8)
