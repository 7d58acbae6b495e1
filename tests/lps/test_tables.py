"""A fixed model on scattered points: the force from tables is the force, and no table is stale."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import warp as wp

from tests.support.clouds import cloud, periodic_cloud
from tests.support.problems import KERNELS, LAM, ROUNDING, kernel, noise
from warp_peri import InputError
from warp_peri.kernels.lps import influence as influence_kernels
from warp_peri.launch import launch, zeros
from warp_peri.lps.bonds import Bonds, Tabulated, influence, powers
from warp_peri.lps.model import bernstein_basis
from warp_peri.lps.operator import NodeOperator, lps_force
from warp_peri.transfer.operator import LPSOperator

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
    """L u with K of every bond computed now."""
    return lps_force(operator.bonds, torch.from_numpy(u), operator.model.solid).numpy()


def relative(value, expected):
    return np.abs(value - expected).max() / np.abs(expected).max()


@pytest.mark.parametrize("kind", SETS)
@pytest.mark.parametrize("name", KERNELS)
def test_is_the_force_to_rounding(kind, name):
    points = SETS[kind]()
    operator = NodeOperator(kernel(name, HORIZON), points, allow_uncertified=True)
    u = noise(points, 2)
    assert relative(operator(u), anew(operator, u)) < ROUNDING
    np.testing.assert_array_equal(operator(u[1]), operator(u)[1])
    given = torch.tensor(u, requires_grad=True)
    assert relative(operator(u), operator(given).detach().numpy()) < ROUNDING
    assert torch.autograd.grad(operator(given).sum(), given)[0].abs().max() > 0


def test_is_the_force_without_a_dilatation():
    points = cloud(5, HORIZON / 3)
    bond_based = kernel("sign-changing", HORIZON, lam=0.8, mu=0.8)
    operator = NodeOperator(bond_based, points, allow_uncertified=True)
    assert operator.bonds.bond_based
    assert relative(operator(noise(points)), anew(operator, noise(points))) < ROUNDING


@pytest.mark.parametrize("D", VANISHING)
def test_a_bond_that_the_function_does_not_see(D):
    """Bernstein coefficients of degree 1: K vanishes where r = 0 or r = δ, at the last bond."""
    x = cloud(5, HORIZON).x
    points = replace(cloud(5, HORIZON), x=np.round(x * 4) / 4)
    model = replace(kernel("sign-changing", HORIZON), D=D)
    operator = NodeOperator(model, points, allow_uncertified=True)
    u = noise(points)
    assert (operator.bonds.families.r == HORIZON).any()
    assert relative(operator(u), anew(operator, u)) < ROUNDING


def test_no_table_is_stale():
    points = cloud(5, HORIZON)
    u = noise(points)
    operator = NodeOperator(kernel("positive", HORIZON), points, allow_uncertified=True)
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
    operator = LPSOperator(kernel("positive", HORIZON), points, allow_uncertified=True)
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
        forces.append(Tabulated(bonds)(wp.from_torch(u, dtype=bonds.vec), solid).numpy())
    assert relative(*forces) < 2e-5


@pytest.mark.parametrize(("precision", "rounding"), [("float64", 2e-15), ("float32", 1e-5)])
@pytest.mark.parametrize("alpha", [-8.0, 0.0, 2.9])
@pytest.mark.parametrize("degree", [0, 10, 21])
def test_many_bonds_at_a_time_have_their_influence_and_its_adjoint(
    precision, rounding, alpha, degree
):
    """Against sums in double precision, of as many bonds as fill no register and do; r off 1."""
    bonds = Bonds(cloud(4, HORIZON), HORIZON, precision=precision)
    random = np.random.default_rng(degree)
    D = random.normal(size=degree + 1)
    values = bonds.floats(np.array([alpha])), bonds.floats(D)
    kw = influence(bonds, *values)[0].numpy()
    r, weight = (getattr(bonds, name).numpy().astype(float) for name in ("r", "weight"))
    assert len(r) % 32
    assert len(r) > 128
    basis = bernstein_basis(np.minimum(r, bonds.horizon), bonds.horizon, degree)
    size = np.abs(weight * r**-alpha)
    off = np.abs(kw - weight * r**-alpha * (basis @ D))
    assert (off <= (1 + degree) * rounding * size * np.abs(D).max()).all()
    for first, last in ((0, 5), (3, len(r) - 1)):
        seeds = random.normal(size=last - first)
        by = zeros(1, degree + 2, dtype=bonds.scalar)
        kernel = influence_kernels.by_lanes(degree, bonds.scalar).adjoint
        of = powers(bonds, *values), bonds.floats(seeds)
        launch(kernel, 1, (0, first, last, *of), (by,))
        each = (seeds * (weight * r**-alpha)[first:last])[:, None] * basis[first:last]
        log_r = np.log(r[first:last, None])
        want = np.append(each.sum(axis=0), -(log_r * each * D).sum())
        largest = np.append(np.abs(each).sum(axis=0), np.abs(log_r * each * D).sum())
        tolerance = 20 * (1 + degree) * rounding * largest.max()
        np.testing.assert_allclose(by.numpy()[0], want, rtol=0, atol=tolerance)
