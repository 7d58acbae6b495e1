"""Stress, strain and energy at the nodes."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.clouds import cloud, periodic_cloud, plain
from tests.support.problems import KERNELS, fitted_order, kernel, lattice, noise, periodic
from warp_peri import InputError
from warp_peri.materials.lps import long_wave_moduli, stiffnesses
from warp_peri.materials.lps_matrices import node_fields
from warp_peri.points.families import bond_classes

HORIZON = 3.0
GRADIENT = np.array([[0.3, -0.2], [0.5, 0.1]])


def test_an_affine_field_has_the_stress_of_hooke():
    model = kernel("1/r", HORIZON)  # isotropic on every lattice
    points = lattice(4, HORIZON)
    fields = node_fields(model, points, points.x @ GRADIENT.T)
    strain = (GRADIENT + GRADIENT.T) / 2
    expected = model.lam * np.trace(strain) * np.eye(2) + 2 * model.mu * strain
    np.testing.assert_allclose(fields.stress, np.broadcast_to(expected, (1, 16, 2, 2)), atol=1e-12)
    np.testing.assert_allclose(fields.strain, np.broadcast_to(strain, (1, 16, 2, 2)), atol=1e-12)
    np.testing.assert_allclose(fields.dilatation, np.trace(strain), atol=1e-12)
    np.testing.assert_allclose(fields.energy, (expected * strain).sum() / 2, atol=1e-12)


@pytest.mark.parametrize("name", KERNELS)
def test_other_kernels_have_the_moduli_of_their_symbol(name):
    model = kernel(name, HORIZON, lam=-0.2)
    classes = bond_classes(1.0, HORIZON)
    v, kappa = stiffnesses(model, classes)
    C11, C12, C44 = long_wave_moduli(classes, v, kappa)
    points = lattice(3, HORIZON)
    for gradient, expected in (
        ([[1, 0], [0, 0]], [[C11, 0], [0, C12]]),
        ([[0, 1], [0, 0]], [[0, C44], [C44, 0]]),
    ):
        fields = node_fields(model, points, points.x @ np.array(gradient, float).T)
        np.testing.assert_allclose(fields.stress[0, 4], expected, atol=1e-11)


@pytest.mark.parametrize("name", KERNELS)
def test_energies_add_up_to_half_the_work(name):
    points, _ = periodic((12, 13))
    model = kernel(name, HORIZON, lam=-0.2)
    u = noise(points)
    fields = node_fields(model, points, u)
    work = (u * model.on(points)(u)).sum()
    assert fields.energy.sum() == pytest.approx(work / 2, rel=1e-12)


def test_its_divergence_balances_the_force_to_second_order():
    errors, spacings = [], (1.0, 0.5, 0.25)
    for h in spacings:
        n = round(24 / h)
        points, _ = periodic((n, n), h)
        model = kernel("1/r", 3 * h, h)
        k = 2 * np.pi / 24
        x, y = points.x.T
        u = np.stack([np.sin(k * x) * np.cos(k * y), np.cos(2 * k * x + k * y)], axis=1)
        stress = node_fields(model, points, u).stress.reshape(n, n, 2, 2)
        wave = 2j * np.pi * np.fft.fftfreq(n, h)
        of = np.fft.fft2(stress, axes=(0, 1))
        divergence = of[..., 0] * wave[:, None, None] + of[..., 1] * wave[None, :, None]
        balance = np.fft.ifft2(divergence, axes=(0, 1)).real.reshape(-1, 2)
        force = model.on(points)(u)
        errors.append(np.abs(balance + force).max() / np.abs(force).max())
    assert fitted_order(spacings, errors) > 1.9


def test_scattered_points_are_exact_on_affine_fields():
    points = cloud(5, HORIZON)
    model = plain(HORIZON)
    strain = (GRADIENT + GRADIENT.T) / 2
    expected = model.lam * np.trace(strain) * np.eye(2) + 2 * model.mu * strain
    fields = node_fields(model, points, points.x @ GRADIENT.T)
    np.testing.assert_allclose(fields.stress - expected, 0, atol=1e-9)


def test_another_shape_is_refused():
    with pytest.raises(InputError, match="u: expected shape"):
        node_fields(kernel("1/r", HORIZON), lattice(3, HORIZON), np.zeros((4, 2)))


def test_bonds_of_periodic_points_join_nearest_images():
    points, box = periodic_cloud(9)
    moved = replace(points, x=np.mod(points.x + np.array([3.3, 4.7]), box))  # cut elsewhere
    model, u = kernel("positive", HORIZON), noise(points)
    here, there = node_fields(model, points, u), node_fields(model, moved, u)
    for part, expected in vars(here).items():
        np.testing.assert_allclose(vars(there)[part], expected, rtol=0, atol=1e-9, err_msg=part)


def test_a_body_with_broken_bonds_is_refused():
    points = lattice(4, HORIZON)
    outside = points.x[:, 0] > points.x[points.interior, 0].mean()
    body = replace(points, interior=points.interior & ~outside, outside=outside)
    with pytest.raises(InputError, match="outside: expected none"):
        node_fields(kernel("positive", HORIZON), body, points.x)
