"""Local elasticity by elements, which models are held against."""

import numpy as np
import pytest

pytest.importorskip("skfem")

import warp_peri as wp
from examples.local_elasticity import errors_by_model
from tools.elements import elastic_solver, errors_of_local, local_solver, moduli_of, piola
from warp_peri.core.elastic import from_voigt, plane_isotropic

C = np.array([[1.3, 0.3, 0.1], [0.3, 0.9, -0.05], [0.1, -0.05, 0.4]])


def waves(length, moduli=C):
    """A wave of so many spacings in a solid of any symmetry, on nodes with a collar of six."""
    x = 5.0 * np.argwhere(np.ones((19, 19))).astype(float)
    inside = (np.abs(x - 45.0) <= 15.1).all(axis=1)
    k = 2 * np.pi / (5.0 * length) * np.array([np.cos(0.4), np.sin(0.4)])
    a = np.array([0.02, -0.01])
    wave = np.sin(x @ k + 0.3)[:, None]
    b = np.einsum("ijkl,j,l,k->i", from_voigt(moduli), k, k, a) * wave
    return wp.Samples(wp.Points(x, inside, 5.0), (wave * a)[None], b[None])


def test_no_mesh_errs_to_speak_of():
    """Fourth order and more in the wave's length, and 1e-4 already where a wave has ten nodes."""
    lengths = np.array([6.0, 10.0, 14.0])
    errors = [errors_of_local(waves(length), C)[0] for length in lengths]
    assert errors[1] < 1e-4
    assert -np.polyfit(np.log(lengths), np.log(errors), 1)[0] > 3.8


def test_third_order_elements_have_the_stress_of_their_energy_and_turn_with_the_body():
    third, rng = (-0.5, -6.8, 1.04), np.random.default_rng(0)
    moduli = plane_isotropic(0.3, 0.7)
    isotropic, H, step = from_voigt(moduli), 0.1 * rng.normal(size=(2, 2)), 1e-5

    def energy(H):
        E = (H + H.T + H.T @ H) / 2
        t, q = np.trace(E), (E[0, 0] - E[1, 1]) / 2 + 1j * E[0, 1]
        cubic = third[0] * t**3 + third[1] * t * abs(q) ** 2 + third[2] * (q**3).real
        return np.einsum("ij,ijkl,kl", E, isotropic, E) / 2 + cubic

    for one in np.eye(4).reshape(4, 2, 2):
        slope = (energy(H + step * one) - energy(H - step * one)) / (2 * step)
        assert (piola(H, isotropic, third) * one).sum() == pytest.approx(slope, abs=1e-8)
    samples = waves(12.0)
    turn = np.array([[np.cos(0.05), -np.sin(0.05)], [np.sin(0.05), np.cos(0.05)]])
    u = samples.x @ (turn @ (np.eye(2) + 0.2 * H) - np.eye(2)).T
    for solve, rounding in (
        (local_solver(samples.points, moduli, third), 3e-7),  # of the interpolation's weights
        (elastic_solver(samples.points, order=1, C=moduli, third=third), 1e-14),
    ):
        wrong = solve(0 * u, u) - u[samples.interior]
        assert np.abs(wrong).max() <= rounding * np.abs(u).max()


def test_models_are_told_with_their_own_moduli():
    solid = wp.Model(0.3, 0.7, 1.0, np.ones(1), horizon=12.5, certified_on=(5.0,))
    own = moduli_of(solid, 5.0)
    found = errors_by_model({"solid": solid}, {"long": waves(40.0, own)}, C)
    assert found["local elasticity, moduli of solid"]["long"] < 1e-4
    assert found["solid"]["long"] < 0.02 < found["local elasticity, true moduli"]["long"]
    with pytest.raises(wp.InputError, match="expected a law of sheets that is linear"):
        moduli_of(object(), 5.0)
