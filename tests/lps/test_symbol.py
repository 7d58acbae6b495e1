"""The symbol, against plane waves through the Warp operator and against a slow sum."""

import numpy as np
import pytest

from tests.support.problems import KERNELS, kernel, periodic
from tests.support.symbols import smallest, symbol
from warp_peri.core.groups import lattice_group
from warp_peri.core.stencil import laplacian, zone_sample
from warp_peri.materials.lps import lps_stencil, moduli, stiffnesses
from warp_peri.materials.lps_fit import class_pairs, product_basis
from warp_peri.points.families import bond_classes

every_kernel = pytest.mark.parametrize("name", KERNELS)


def matrix(model, classes, k):
    """D(k), shape [K, 2, 2]."""
    return lps_stencil(model, classes.spacing).symbol(classes.spacing * k)


@every_kernel
@pytest.mark.parametrize("spacing", [1.0, 2.5])
def test_plane_waves_through_the_operator(name, spacing):
    model = kernel(name, 2.5 * spacing, spacing, lam=-0.2)
    points, box = periodic((8, 7), spacing)
    operator = model.on(points)
    a = np.array([0.7 + 0.2j, -0.4 + 1.1j])
    for p, q in ((1, 0), (0, 2), (3, 2), (4, 0), (-2, 3)):
        k = 2 * np.pi * np.array([p, q]) / box
        wave = np.exp(1j * points.x @ k)[:, None]
        Lu = operator((wave * a).real) + 1j * operator((wave * a).imag)
        expected = wave * (matrix(model, bond_classes(spacing, model.horizon), k[None])[0] @ a)
        np.testing.assert_allclose(Lu, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@every_kernel
def test_long_waves_feel_the_moduli(name):
    model, classes = kernel(name, 2.5), bond_classes(1.0, 2.5)
    C = moduli(model, classes)
    small = 1e-4
    straight, diagonal = matrix(model, classes, small * np.array([[1, 0], [1, 1]])) / small**2
    expected = np.diag([C["C11"], C["C44"]])
    np.testing.assert_allclose(straight, expected, rtol=0, atol=1e-6)
    expected = np.full((2, 2), C["C12"] + C["C44"]) + np.eye(2) * (C["C11"] - C["C12"])
    np.testing.assert_allclose(diagonal, expected, rtol=0, atol=1e-6)


@every_kernel
def test_the_stencil_has_the_symbol_of_the_formula(name):
    model, classes = kernel(name, 2.5, 2.0 / 2), bond_classes(1.0, 2.5)
    k = np.random.default_rng(1).uniform(-np.pi, np.pi, (20, 2))
    expected = symbol(model, k)
    size = np.abs(expected).max()
    np.testing.assert_allclose(matrix(model, classes, k), expected, atol=1e-13 * size)
    v, kappa = stiffnesses(model, classes)
    bonds, (i, j) = product_basis(classes), class_pairs(len(v))
    p = np.concatenate([v, kappa * v[i] * v[j]])
    np.testing.assert_allclose(
        np.tensordot(bonds.symbol(k), p, (1, 0)), expected, atol=1e-13 * size
    )


def test_the_laplacian_is_the_five_point_one():
    points, (n1, n2) = periodic((6, 5), 2.0)
    k = 2 * np.pi * np.array([2 / n1, 1 / n2])
    wave = np.exp(1j * points.x @ k).reshape(6, 5)
    five = sum(wave - np.roll(wave, step, axis) for axis in (0, 1) for step in (1, -1))
    np.testing.assert_allclose(five, laplacian(2.0 * k[None]) * wave, atol=1e-13)


@every_kernel
def test_the_sample_has_the_values_of_the_whole_zone(name):
    model, intervals = kernel(name, 2.5), 8
    line = np.pi * np.arange(-intervals, intervals + 1) / intervals
    zone = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2)
    zone = zone[np.abs(zone).sum(1) > 0]
    part = zone_sample(lattice_group(2), 2, intervals)
    part = part[np.abs(part).max(axis=1) > 0.1]
    assert len(part) < len(zone) / 6
    ratio = [smallest(symbol(model, k), k) for k in (zone, part)]
    assert ratio[0].min() == pytest.approx(ratio[1].min(), rel=1e-12)
    assert ratio[0].max() == pytest.approx(ratio[1].max(), rel=1e-12)
