"""The LPS operator and its matrices: the invariants, and Warp against the slow reference."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.support import reference
from tests.support.problems import KERNELS, LAM, MU, ROUNDING, ell, kernel, lattice, noise, periodic
from warp_peri import InputError
from warp_peri.materials.lps import moduli
from warp_peri.materials.lps_matrices import matrices
from warp_peri.points.families import bond_classes

every_kernel = pytest.mark.parametrize("name", KERNELS)
HORIZON = 2.5


def relative(value, expected):
    return np.abs(value - expected).max() / np.abs(expected).max()


@every_kernel
@pytest.mark.parametrize(("horizon", "angle"), [(2.0, 0.0), (3.0, 0.7)])
def test_is_the_reference(name, horizon, angle):
    model = kernel(name, horizon, lam=-0.2)
    points = lattice(ell(), horizon, angle=angle, origin=(5.0, -2.0))
    u = noise(points)
    expected = reference.operator(points.x, points.interior, model, u)
    assert relative(model.on(points)(u), expected) < 10 * ROUNDING
    L = matrices(model, points).operator(model.lam, model.mu)
    assert relative((L @ u.ravel()).reshape(-1, 2), expected) < 10 * ROUNDING


@every_kernel
def test_is_the_reference_on_a_periodic_lattice(name):
    model = kernel(name, HORIZON)
    points, box = periodic((6, 7))
    u = noise(points)
    expected = reference.operator(points.x, points.interior, model, u, np.array(box))
    assert relative(model.on(points)(u), expected) < 10 * ROUNDING


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
    deviatoric = replace(model, lam=1.0, mu=1.0).on(points)(u)
    assert relative((parts.gamma @ u.ravel()).reshape(-1, 2), deviatoric) < 10 * ROUNDING


@pytest.mark.parametrize("horizon", [2.0, 2.5, 3.0, 4.0, 5.0])
def test_moduli_of_the_plain_kernel_are_the_continuum_constants(horizon):
    constants = moduli(kernel("1/r", horizon), bond_classes(1.0, horizon))
    expected = {"C11": LAM + 2 * MU, "C12": LAM, "C44": MU}
    assert constants == pytest.approx(expected, rel=1e-9)


def test_scale_and_sign_of_the_influence_function_have_no_effect():
    model = kernel("sign-changing", HORIZON)
    points = lattice(3, HORIZON)
    u = noise(points)
    expected = model.on(points)(u)
    for factor in (-1.0, 1e-9, 1e9):
        scaled = replace(model, D=factor * model.D)
        assert relative(scaled.on(points)(u), expected) < 10 * ROUNDING


def test_samples_are_independent_and_arrays_of_any_layout_serve():
    points = lattice(3, HORIZON)
    operator = kernel("steep", HORIZON).on(points)
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
    operator = kernel("1/r", HORIZON).on(lattice(3, HORIZON))
    with pytest.raises(InputError, match=r"u: expected float64 of shape \[S, 169, 2\], S ≥ 1"):
        operator(u)
