"""Solves on scattered points through a certified lattice."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import warp_peri as wp
from tests.points.test_interpolation import cloud
from tests.support.problems import kernel, lattice
from tests.support.solving import solve
from warp_peri import InputError, Points, Samples, evaluate
from warp_peri.statics.scattered import ThroughLattice
from warp_peri.transfer.lattice import dispersion
from warp_peri.transfer.operator import LPSOperator

HOME = replace(kernel("1/r", 3.0), largest_wave_number=2.0)
pytestmark = pytest.mark.filterwarnings("ignore:transferred")


@pytest.fixture(scope="module")
def operator():
    x = cloud(17, 0.45, seed=3).x
    return ThroughLattice(HOME, Points(x, np.abs(x).max(axis=1) <= 4.0, 0.0))


def waves(x):
    """A wave and its load, of the material at home: shape [1, N, 2] each."""
    k = np.array([0.5, 0.3])
    u = np.cos(x @ k)[:, None] * (1.0, -0.4)
    return u[None], (u @ dispersion(HOME, 1.0, k).T)[None]


def wrong(operator, solved, u):
    inside = operator.points.interior
    return np.linalg.norm((solved - u)[:, inside]) / np.linalg.norm(u[:, inside])


def test_symmetric_and_positive_definite(operator):
    figures = operator.figures()
    assert figures.asymmetry < 1e-12
    assert figures.smallest_eigenvalue > 0
    assert figures.smallest_singular_value > 0.5
    assert figures.condition < 1e4
    A = operator.problem.stiffness.toarray()
    assert figures.smallest_eigenvalue == pytest.approx(np.linalg.eigvalsh(A)[0], rel=1e-6)
    T = operator.unknown.toarray()
    smallest = np.linalg.svd(T, compute_uv=False)[-1]
    assert figures.smallest_singular_value == pytest.approx(smallest, rel=1e-6)


def test_the_patch_test(operator):
    """Affine displacement needs no load, whatever the points."""
    x = operator.points.x
    u = (x @ np.array([[0.01, 0.004], [-0.002, 0.02]]) + 0.3)[None]
    held = np.where(operator.points.interior[:, None], 0.0, u)
    assert operator.solve(0 * u, held) == pytest.approx(u, abs=1e-9)
    assert np.abs(operator(u)).max() < 1e-10


def test_waves_are_answered_as_at_home(operator):
    u, b = waves(operator.points.x)
    on_lattice = operator.solve(waves(operator.x)[1], u)
    assert wrong(operator, on_lattice, u) < 0.005
    at_nodes = operator.solve(b, u)
    assert wrong(operator, at_nodes, u) < 0.006


def test_solve_and_evaluate_go_this_way(operator):
    u, b = waves(operator.points.x)
    solved = solve(HOME, operator.points, b, u)
    assert solved == pytest.approx(operator.solve(b, u), abs=1e-12)
    assert np.array_equal(solved[:, ~operator.points.interior], u[:, ~operator.points.interior])
    table = evaluate(HOME, Samples(operator.points, u, b))
    assert table["E_u"] == pytest.approx(wrong(operator, solved, u))
    assert table["E_res"] < 0.05
    assert table["transferred_from"] == 1.0


def test_own_numbers_and_refusal_stay(operator):
    u, b = waves(operator.points.x)
    with pytest.raises(InputError, match="certified on 1 Å, not on scattered points"):
        solve(HOME, operator.points, b, u, transfer=False)
    with pytest.raises(InputError, match="solver: expected Direct.. on scattered points"):
        solve(HOME, operator.points, b, u, method="gmres")


def test_the_operator_goes_this_way_by_kernels(operator):
    u, b = waves(operator.points.x)
    by_kernels = LPSOperator(HOME, operator.points)
    assert by_kernels(u) == pytest.approx(operator(u), abs=1e-12)
    assert by_kernels(u[0]) == pytest.approx(operator(u)[0], abs=1e-12)
    assert np.array_equal(by_kernels.load(b[0]), operator.load(b)[0])
    x = torch.from_numpy(u).requires_grad_()
    seed = np.random.default_rng(0).normal(size=(1, operator.points.interior.sum(), 2))
    (by_kernels(x) * torch.from_numpy(seed)).sum().backward()
    # linear in u: the gradient is Aᵗ, which is A between unknowns
    inside = np.zeros_like(u)
    inside[:, operator.points.interior] = seed
    gradient = x.grad.numpy()[:, operator.points.interior]
    assert gradient == pytest.approx(operator(inside), abs=1e-12)
    direction = np.random.default_rng(1).normal(size=u.shape)
    change = ((by_kernels(u + direction) - by_kernels(u)) * seed).sum()
    assert (x.grad.numpy() * direction).sum() == pytest.approx(change, rel=1e-10)
    with pytest.raises(InputError, match="u: expected"):
        by_kernels(torch.from_numpy(u[:, :5]))
    with pytest.raises(InputError, match="not on scattered points"):
        LPSOperator(HOME, operator.points, transfer=False)


def test_a_lattice_loads_its_own_nodes():
    points = lattice(3, 3.0)
    b = np.random.default_rng(0).normal(size=(2, len(points.x), 2))
    loads = LPSOperator(HOME, points).load(b)
    assert np.array_equal(loads, b[:, points.interior])
    for wrong in (b[:, points.interior], b[0, :, 0]):
        with pytest.raises(InputError, match="b: expected shape"):
            LPSOperator(HOME, points).load(wrong)


def test_what_does_not_carry_a_lattice():
    points = cloud(10)
    with pytest.raises(InputError, match=r"collar: expected nodes .* Å around the interior"):
        ThroughLattice(HOME, points)
    wide = cloud(17)
    wide = Points(wide.x, np.abs(wide.x).max(axis=1) <= 4.0, 0.0)
    hole = np.hypot(*(wide.x - (7.0, 0.0)).T) > 2.5
    with pytest.raises(InputError, match="missing from"):
        ThroughLattice(HOME, Points(wide.x[hole], wide.interior[hole], 0.0))
    carried = ThroughLattice(HOME, wide)
    with pytest.raises(InputError, match="b: expected shape"):
        carried.load(np.zeros((1, 7, 2)))
    for u in (np.zeros((len(wide.x), 2)), np.zeros((1, 7, 2))):
        with pytest.raises(InputError, match="u: expected shape"):
            carried(u)
    with pytest.raises(InputError, match="broken bonds do not go through a lattice"):
        ThroughLattice(HOME, replace(wide, outside=np.zeros(len(wide.x), bool)))


def test_points_that_fill_no_plane():
    x = np.stack([np.arange(50.0), np.zeros(50)], axis=1)
    with pytest.raises(InputError, match="they are on a line"):
        LPSOperator(HOME, Points(x, x[:, 0] == 25, 0.0))
    with pytest.raises(InputError, match="expected at least 40 nodes"):
        LPSOperator(
            HOME, Points(np.array([[2.0, 0], [0, 2], [0, 0]]), np.array([True, False, False]), 0.0)
        )


def test_a_load_that_is_no_number_on_the_collar_is_told(operator):
    """It was called singular: a load between scattered nodes is read beside the interior too."""
    u, b = waves(operator.points.x)
    unknown = np.where(operator.points.interior[:, None], b, np.nan)
    with pytest.raises(InputError, match="b: expected finite values on the collar too"):
        operator.solve(unknown, u)
    problem = wp.Dirichlet(operator.points, unknown[0], u[0])
    with pytest.raises(InputError, match="b: expected finite values on the collar too"):
        wp.solve(HOME, problem)


def shaken(n, shift=0.45):
    """Nodes of a square of side 2, n spacings wide, each shifted, with a collar."""
    steps = np.arange(-16, n + 17)
    x = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2) * 2 / n - 1
    inside = (np.abs(x) < 1 + 1e-9).all(axis=1)
    shifts = np.random.default_rng(0).uniform(-shift, shift, x.shape)
    return Points(x + 2 / n * shifts, inside, 0.0)


@pytest.mark.slow
def test_a_plain_solid_is_proven_there_and_converges_by_order_two():
    """To u of local elasticity, sines of λ = 0.3, μ = 1; nothing is certified beforehand."""
    lam, mu, k, errors = 0.3, 1.0, np.array([2.0, 1.5]), []
    for n in (10, 20):
        points = shaken(n)
        phase = points.x @ k
        u = np.stack([np.sin(phase), np.cos(phase + 0.5)], axis=1)
        along = u @ np.outer(k, k)
        b = mu * (k @ k) * u + (lam + mu) * along
        solid = wp.Model(lam, mu, 1.0, np.ones(1), horizon=3 * 2 / n)
        solution = wp.solve(solid, wp.Dirichlet(points, b, u))
        inside = points.interior
        errors.append(np.linalg.norm((solution.u - u)[inside]) / np.linalg.norm(u[inside]))
        assert solution.operator.carrier is not None
    order = np.log2(errors[0] / errors[1])
    assert order > 1.9, errors
    assert errors[-1] < 7e-3
