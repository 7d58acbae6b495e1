"""A fixed model on scattered points: its force is that of its matrices, and no table is stale."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.support.clouds import cloud, periodic_cloud
from tests.support.problems import KERNELS, LAM, ROUNDING, kernel, noise
from warp_peri import InputError
from warp_peri.materials.lps import bernstein_basis
from warp_peri.materials.lps_bonds import Bonds
from warp_peri.materials.lps_force import lps_force
from warp_peri.materials.lps_matrices import matrices

HORIZON = 3.0
pytestmark = pytest.mark.filterwarnings("ignore:spacing")


def beside_a_crack():
    points = cloud(6, HORIZON)
    outside = points.x[:, 0] > 3
    return replace(points, interior=points.interior & ~outside, outside=outside)


SETS = {"cloud": lambda: cloud(5, HORIZON), "periodic": lambda: periodic_cloud(8)[0]}
SETS["body"] = beside_a_crack
VANISHING = [[0.0, 1.0], [1.0, 0.0]]


def anew(operator, u):
    """L u from matrices, K of every bond computed now."""
    model = operator.model
    L = matrices(model, operator.points).operator(model.lam, model.mu)
    return (L @ u.reshape(-1, L.shape[1]).T).T.reshape(*u.shape[:-2], -1, 2)


def relative(value, expected):
    return np.abs(value - expected).max() / np.abs(expected).max()


@pytest.mark.parametrize("kind", SETS)
@pytest.mark.parametrize("name", KERNELS)
def test_is_the_force_to_rounding(kind, name):
    points = SETS[kind]()
    operator = kernel(name, HORIZON).on(points, allow_uncertified=True)
    u = noise(points, 2)
    assert relative(operator(u), anew(operator, u)) < ROUNDING
    np.testing.assert_array_equal(operator(u[1]), operator(u)[1])
    given = torch.tensor(u, requires_grad=True)
    assert relative(operator(u), operator(given).detach().numpy()) < ROUNDING
    assert torch.autograd.grad(operator(given).sum(), given)[0].abs().max() > 0


def test_is_the_force_without_a_dilatation():
    points = cloud(5, HORIZON / 3)
    bond_based = kernel("sign-changing", HORIZON, lam=0.8, mu=0.8)
    operator = bond_based.on(points, allow_uncertified=True)
    assert operator.bonds.bond_based
    assert relative(operator(noise(points)), anew(operator, noise(points))) < ROUNDING


@pytest.mark.parametrize("D", VANISHING)
def test_a_bond_that_the_function_does_not_see(D):
    """Bernstein coefficients of degree 1: K vanishes where r = 0 or r = δ, at the last bond."""
    x = cloud(5, HORIZON).x
    points = replace(cloud(5, HORIZON), x=np.round(x * 4) / 4)
    model = replace(kernel("sign-changing", HORIZON), D=D)
    operator = model.on(points, allow_uncertified=True)
    u = noise(points)
    assert (operator.bonds.families.r == HORIZON).any()
    assert relative(operator(u), anew(operator, u)) < ROUNDING


def test_no_table_is_stale():
    points = cloud(5, HORIZON)
    u = noise(points)
    operator = kernel("positive", HORIZON).on(points, allow_uncertified=True)
    before = operator(u)
    for change in (
        {"lam": -0.1},
        {"mu": 0.5},
        {"alpha": 0.9},
        {"D": [0.2, 1.0, 0.4, 0.2]},
        {"D": [0.1, 0.7]},
    ):
        operator.model = replace(operator.model, **change)
        assert relative(operator(u), anew(operator, u)) < ROUNDING
        assert relative(operator(u), before) > 1e-3
        before = operator(u)


def test_refuses_what_the_force_refuses():
    points = cloud(5, HORIZON)
    operator = kernel("positive", HORIZON).on(points, allow_uncertified=True)
    with pytest.raises(InputError, match="u: expected float64 of shape"):
        operator(np.zeros((3, 2)))
    with pytest.raises(InputError, match="u: expected float64 of shape"):
        operator(torch.zeros(len(points.x), 3))


def test_single_precision():
    points = SETS["periodic"]()
    solid = kernel("sign-changing", HORIZON, lam=LAM).solid
    forces = []
    for precision in ("float32", "float64"):
        bonds = Bonds(points, HORIZON, precision=precision)
        u = torch.as_tensor(noise(points, 1), dtype=getattr(torch, precision))
        forces.append(lps_force(bonds, u, solid).numpy())
    assert relative(*forces) < 2e-5


@pytest.mark.parametrize(("precision", "rounding"), [("float64", 2e-15), ("float32", 1e-5)])
@pytest.mark.parametrize("alpha", [-8.0, 0.0, 2.9])
@pytest.mark.parametrize("degree", [0, 10, 21])
def test_bonds_have_their_influence_and_its_adjoint(precision, rounding, alpha, degree):
    """Against sums in double precision; r off 1."""
    bonds = Bonds(cloud(4, HORIZON), HORIZON, precision=precision)
    random = np.random.default_rng(degree)
    D = random.normal(size=degree + 1)
    kw = bonds.influence(alpha, D)
    r, log_r, weight = (table.numpy().astype(float) for table in bonds.tables)
    basis = bernstein_basis(np.minimum(r, bonds.horizon), bonds.horizon, degree)
    size = np.abs(weight * r**-alpha)
    off = np.abs(kw - weight * r**-alpha * (basis @ D))
    assert (off <= (1 + degree) * rounding * size * np.abs(D).max()).all()
    seeds = random.normal(size=len(r))
    by_alpha, by_D = bonds.influence(alpha, D, seeds)
    each = (seeds * weight * r**-alpha)[:, None] * basis
    want = np.append(each.sum(axis=0), -(log_r[:, None] * each * D).sum())
    largest = np.append(np.abs(each).sum(axis=0), np.abs(log_r[:, None] * each * D).sum())
    tolerance = 20 * (1 + degree) * rounding * largest.max()
    np.testing.assert_allclose(np.append(by_D, by_alpha), want, rtol=0, atol=tolerance)
