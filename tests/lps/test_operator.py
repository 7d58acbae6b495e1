"""The LPS operator and its matrices: the invariants, and Warp against the slow reference."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.support import reference
from tests.support.problems import KERNELS, LAM, MU, ROUNDING, ell, kernel, lattice, noise, periodic
from warp_peri import InputError
from warp_peri.lps.matrices import matrices
from warp_peri.lps.symbol import moduli
from warp_peri.points.families import bond_classes
from warp_peri.transfer.operator import LPSOperator

every_kernel = pytest.mark.parametrize("name", KERNELS)
HORIZON = 2.5


def relative(value, expected):
    return np.abs(value - expected).max() / np.abs(expected).max()


@every_kernel
@pytest.mark.parametrize("horizon", [2.0, 3.0])
def test_is_the_reference(name, horizon):
    model = kernel(name, horizon, lam=-0.2)
    points = lattice(ell(), horizon)
    u = noise(points)
    expected = reference.operator(points.x, points.interior, model, u)
    assert relative(LPSOperator(model, points)(u), expected) < 10 * ROUNDING
    L = matrices(model, points).operator(model.lam, model.mu)
    assert relative((L @ u.ravel()).reshape(-1, 2), expected) < 10 * ROUNDING


@every_kernel
def test_is_the_reference_on_a_periodic_lattice(name):
    model = kernel(name, HORIZON)
    points, box = periodic((6, 7))
    u = noise(points)
    expected = reference.operator(points.x, points.interior, model, u, np.array(box))
    assert relative(LPSOperator(model, points)(u), expected) < 10 * ROUNDING


@every_kernel
def test_matrices_split_the_operator_as_printed(name):
    model = kernel(name, HORIZON)
    points = lattice(ell(), HORIZON)
    parts = matrices(model, points)
    u = noise(points)
    theta = parts.phi @ u.ravel()
    needed = np.unique(parts.psi.indices)
    expected = [reference.dilatation(points.x, i, model, u) for i in needed]
    assert relative(theta[needed], expected) < 10 * ROUNDING
    deviatoric = LPSOperator(replace(model, lam=1.0, mu=1.0), points)(u)
    assert relative((parts.gamma @ u.ravel()).reshape(-1, 2), deviatoric) < 10 * ROUNDING


@every_kernel
@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_an_affine_field_has_its_trace_as_dilatation_and_no_force(name, angle):
    model = kernel(name, HORIZON)
    points = lattice(3, HORIZON, angle=angle, origin=(50.0, -20.0))
    parts, operator = matrices(model, points), LPSOperator(model, points)
    rough = np.abs(operator(noise(points))).max()
    needed = np.unique(parts.psi.indices)
    fields = {
        "translation": np.zeros((2, 2)),
        "rotation": np.array([[0.0, -1.0], [1.0, 0.0]]),
        "affine": np.array([[0.3, -0.7], [0.2, 0.9]]),
    }
    for gradient in fields.values():
        u = points.x @ gradient.T + (0.4, -1.3)
        scale = np.abs(u).max()
        theta = (parts.phi @ u.ravel())[needed]
        np.testing.assert_allclose(theta, np.trace(gradient), rtol=0, atol=ROUNDING * scale)
        assert np.abs(operator(u)).max() < ROUNDING * rough * scale


@every_kernel
def test_a_rotated_lattice_gives_the_rotated_force(name):
    model = kernel(name, HORIZON)
    straight = lattice(3, HORIZON)
    u = noise(straight)
    expected = LPSOperator(model, straight)(u)
    for angle in (0.3, 1.2, 2.9, np.pi / 4):
        rotated = lattice(3, HORIZON, angle=angle, origin=(-7.0, 11.0))
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        Lu = LPSOperator(model, rotated)(u @ turn.T)
        assert relative(Lu, expected @ turn.T) < 1e-11  # positions far from the origin


@every_kernel
def test_momentum_is_balanced_and_the_operator_symmetric_on_a_periodic_lattice(name):
    points, _ = periodic((8, 6))
    operator = LPSOperator(kernel(name, HORIZON), points)
    u, v = noise(points, 2)
    Lu, Lv = operator(u), operator(v)
    np.testing.assert_allclose(Lu.sum(axis=0), 0, atol=ROUNDING * np.abs(Lu).sum())
    assert np.sum(v * Lu) == pytest.approx(np.sum(u * Lv), abs=ROUNDING * np.abs(v * Lu).sum())


@every_kernel
def test_quadratic_fields_feel_the_long_wave_moduli(name):
    model = kernel(name, HORIZON)
    C = moduli(model, bond_classes(1.0, HORIZON))
    points = lattice(2, HORIZON)
    x, y = points.x.T
    zero = np.zeros_like(x)
    operator = LPSOperator(model, points)
    for field, expected in (
        ((x**2 / 2, zero), (-C["C11"], 0)),
        ((y**2 / 2, zero), (-C["C44"], 0)),
        ((x * y, zero), (0, -C["C12"] - C["C44"])),
    ):
        Lu = operator(np.stack(field, axis=1))
        np.testing.assert_allclose(Lu, np.tile(expected, (4, 1)), rtol=0, atol=1e-11)


@pytest.mark.parametrize("horizon", [2.0, 2.5, 3.0, 4.0, 5.0])
def test_moduli_of_the_plain_kernel_are_the_continuum_constants(horizon):
    constants = moduli(kernel("1/r", horizon), bond_classes(1.0, horizon))
    expected = {"C11": LAM + 2 * MU, "C12": LAM, "C44": MU}
    assert constants == pytest.approx(expected, rel=1e-9)


def test_scale_and_sign_of_the_influence_function_have_no_effect():
    model = kernel("sign-changing", HORIZON)
    points = lattice(3, HORIZON)
    u = noise(points)
    expected = LPSOperator(model, points)(u)
    for factor in (-1.0, 1e-9, 1e9):
        scaled = replace(model, D=factor * model.D, D_dilatation=None)
        assert relative(LPSOperator(scaled, points)(u), expected) < 10 * ROUNDING


def test_forces_scale_with_the_units_as_they_should():
    points, finer = lattice(3, 2.5), lattice(3, 10.0, spacing=4.0)
    u = noise(points)
    coarse = LPSOperator(kernel("positive", 2.5), points)(u)
    fine = LPSOperator(kernel("positive", 10.0, spacing=4.0), finer)(u)
    assert relative(fine * 4.0**2, coarse) < 10 * ROUNDING


def test_samples_are_independent_and_arrays_of_any_layout_serve():
    points = lattice(3, HORIZON)
    operator = LPSOperator(kernel("steep", HORIZON), points)
    u = noise(points, 3)
    expected = np.stack([operator(field) for field in u])
    frozen = u.copy()
    frozen.flags.writeable = False
    layouts = (u, np.asfortranarray(u), frozen, torch.from_numpy(u).numpy())
    for layout in layouts:
        assert np.array_equal(operator(layout), expected)
    assert np.array_equal(operator(u[::-1]), expected[::-1])
    assert np.array_equal(operator(torch.from_numpy(u)).numpy(), expected)
    assert np.array_equal(operator(np.ones((len(points.x), 2), int)), np.zeros((9, 2)))


@pytest.mark.parametrize(
    "u",
    [
        np.zeros((5, 2)),
        np.zeros((1, 1, 121, 2)),
        np.zeros((0, 169, 2)),
        torch.zeros(169, 3, dtype=torch.float64),
    ],
    ids=["few nodes", "too deep", "no sample", "in space"],
)
def test_displacements_that_do_not_fit_are_refused(u):
    operator = LPSOperator(kernel("1/r", HORIZON), lattice(3, HORIZON))
    with pytest.raises(InputError, match=r"u: expected float64 of shape \[S, 169, 2\], S ≥ 1"):
        operator(u)


def test_an_uncertified_spacing_is_refused_or_warned_about():
    model = replace(kernel("1/r", HORIZON), certified_on=(2.0,))
    points = lattice(3, HORIZON)
    with pytest.raises(InputError, match="certified on 2 Å, not on 1 Å"):
        LPSOperator(model, points, transfer=False)
    with pytest.warns(UserWarning, match="certified on 2 Å, not on 1 Å"):
        LPSOperator(model, points, allow_uncertified=True)
