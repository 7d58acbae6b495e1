"""The certificate: what it computes, what it proves, and that it proves nothing false."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from tests.support import reference
from tests.support.problems import KERNELS, ell, kernel, lattice, periodic
from tests.support.symbols import smallest, symbol
from warp_peri import InputError, Model, certify
from warp_peri.materials.lps_matrices import matrices
from warp_peri.solvers.direct import DENSE, smallest_eigenvalue

ZONE = np.stack(np.meshgrid(*2 * [np.linspace(-np.pi, np.pi, 161)]), -1).reshape(-1, 2)
ZONE = ZONE[np.hypot(*ZONE.T) > 1e-9]
VIOLATING = kernel("sign-changing", 2.5)


def smallest_ratio(model):
    return smallest(symbol(model, ZONE), ZONE).min()


@pytest.mark.parametrize("horizon", [2.0, 3.0, 4.0, 5.0])
def test_the_plain_kernel_holds(horizon):
    certificate = certify(kernel("1/r", horizon), spacing=1.0)
    assert certificate.holds
    assert 0 < certificate.symbol_bound <= certificate.symbol_min
    assert "exactly one solution" in certificate.statement


def test_a_planted_violation_is_reported():
    certificate = certify(VIOLATING, spacing=1.0)
    assert certificate.symbol_min < -0.03
    assert certificate.symbol_bound == 0
    assert not certificate.holds
    assert certificate.statement == "Nothing is proven on the lattice of spacing 1 Å."


def test_a_violation_in_the_dilatation_alone_is_reported():
    """Γ is positive; λ below μ lets the dilatation pull it down."""
    D = [-0.54, 0.63, -0.08, -0.12, 0.18, -0.12]
    model = Model(lam=-0.6, mu=0.8, alpha=1.0, D=D, horizon=3.0)
    assert certify(replace(model, lam=0.8), spacing=1.0).holds
    certificate = certify(model, spacing=1.0, points=lattice(4, 3.0))
    assert certificate.gamma_min > 0
    assert certificate.symbol_min < 0
    assert not certificate.holds


def test_what_holds_is_what_is_stated():
    """(iii) of the paper fails and D(k) is positive: with a domain the proof is the same."""
    model, points = kernel("sign-changing", 3.0, lam=20.0), lattice(11, 3.0)
    bare, dense = certify(model, spacing=1.0), certify(model, spacing=1.0, points=points)
    assert dense.gamma_minus_2phi_min < -0.04
    assert dense.statement == bare.statement
    assert "exactly one solution" in dense.statement
    assert bare.holds
    assert dense.holds
    assert dense.paper is False
    assert bare.paper is None
    L = matrices(model, points).operator(model.lam, model.mu)[:, np.repeat(points.interior, 2)]
    assert np.linalg.eigvalsh(L.toarray())[0] > 0


@pytest.mark.parametrize("horizon", [2.0, 2.5, 3.0])
@pytest.mark.parametrize("name", KERNELS)
def test_minimum_and_bound_against_a_fine_grid(name, horizon):
    model = kernel(name, horizon, lam=-0.2)
    certificate = certify(model, spacing=1.0)
    expected = smallest_ratio(model)
    assert certificate.symbol_min <= expected + 1e-12
    assert certificate.symbol_min == pytest.approx(expected, abs=1e-3)
    assert certificate.symbol_bound <= max(expected, 0)
    if expected > 0.05:
        assert certificate.symbol_bound >= 0.9 * expected


def five_point(interior):
    """The 5-point Dirichlet Laplacian on given nodes of a unit lattice."""
    node = np.argwhere(interior)
    step = np.abs(node[:, None] - node[None]).sum(-1)
    return 4.0 * (step == 0) - (step == 1)


@pytest.mark.parametrize("name", KERNELS)
def test_dense_figures_are_those_of_the_definition(name):
    model = kernel(name, 3.0)
    points = lattice(ell(), 3.0)
    inside = np.flatnonzero(points.interior)
    pulls = np.zeros((2 * len(inside), len(points.x), 2))
    for number, (i, a) in enumerate((i, a) for i in inside for a in (0, 1)):
        pulls[number, i, a] = 1.0
    equal = replace(model, lam=1.0, mu=1.0)  # L = Γ
    gamma = equal.on(points)(pulls).reshape(len(pulls), -1).T
    phi = np.array(
        [[reference.dilatation(points.x, i, model, pull) for pull in pulls] for i in inside]
    )
    figures = certify(model, spacing=1.0, points=points)
    schwarz = np.linalg.eigvalsh(gamma - 2 * phi.T @ phi)
    assert figures.gamma_min == pytest.approx(np.linalg.eigvalsh(gamma)[0], rel=1e-9)
    assert figures.gamma_minus_2phi_min == pytest.approx(schwarz[0], rel=1e-9)
    assert figures.gamma_minus_2phi_max == pytest.approx(schwarz[-1], rel=1e-9)
    assert figures.schwarz == (schwarz[0] >= -1e-10 * schwarz[-1])
    values = np.linalg.eigvalsh(phi @ np.linalg.solve(gamma, phi.T))
    values = values[values > 1e-9 * values[-1]]
    assert figures.inf_sup_min == pytest.approx(values[0], rel=1e-6)
    assert figures.inf_sup_rank == len(values)


def test_figures_are_plain_numbers():
    figures = certify(kernel("1/r", 2.0), spacing=1.0, points=lattice(3, 2.0)).figures()
    assert {type(value) for value in figures.values()} <= {float, int, str}
    assert set(figures) >= {"symbol_min", "symbol_bound", "gamma_min", "inf_sup_min"}


@pytest.mark.parametrize(
    ("spacing", "points", "words"),
    [
        (2.1, None, "horizon: expected at least one spacing"),
        (0.0, None, "spacing: expected a lattice spacing > 0"),
        (1.0, lattice(3, 2.0, spacing=0.9), "spacing: expected that of the points, 0.9 Å, got 1"),
        (1.0, lattice(3, 1.5), "out to twice the horizon"),
    ],
)
def test_lattices_that_do_not_fit_are_refused(spacing, points, words):
    with pytest.raises(InputError, match=words):
        certify(kernel("1/r", 2.0), spacing=spacing, points=points)


def test_a_mode_that_changes_sign_across_a_symmetric_body_is_found():
    """Two halves and a bond between them: the lowest mode is antisymmetric."""
    half = DENSE
    chain = sp.diags_array(np.append(0.5, np.linspace(1.0, 2.0, half - 1)))
    body = sp.csc_array(sp.block_array([[chain, sp.eye_array(half)], [sp.eye_array(half), chain]]))
    assert smallest_eigenvalue(body) == pytest.approx(-0.5, rel=1e-5)


@pytest.mark.parametrize("size", [8, 12, 20])
def test_the_figures_of_a_period_are_those_without_its_translations(size):
    model = kernel("positive", 3.0)
    points, _ = periodic((size, size))
    figures = certify(model, spacing=1.0, points=points)
    parts = matrices(model, points)
    gamma, phi = parts.gamma.toarray(), parts.phi.toarray()
    values, fields = np.linalg.eigh(gamma)
    assert np.abs(values[:2]).max() < 1e-12 * values[-1]
    assert figures.gamma_min == pytest.approx(values[2], rel=1e-9)
    least = np.linalg.eigvalsh(gamma - 2 * phi.T @ phi)
    assert figures.gamma_minus_2phi_min == pytest.approx(least[2], rel=1e-9)
    half = phi @ fields[:, 2:] / np.sqrt(values[2:])
    pencil = np.linalg.eigvalsh(half @ half.T)
    pencil = pencil[pencil > 1e-9 * pencil[-1]]
    assert figures.inf_sup_min == pytest.approx(pencil[0], rel=1e-6)
    assert figures.inf_sup_rank == len(pencil)
