"""The certificate: what it computes, what it proves, and that it proves nothing false."""

from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from numpy.linalg import eigvalsh
from numpy.random import default_rng

from tests.support import approx, near, parametrize, reference, refused
from tests.support.problems import ell, kernel, lattice
from tests.support.symbols import anywhere, form, smallest, smallest_margins, symbol, zone
from warp_peri import LPSMaterial, certify
from warp_peri.core.stencil import ratios
from warp_peri.materials.lps import stiffnesses
from warp_peri.materials.lps_law import StabilityConditions, product_basis
from warp_peri.materials.lps_operator import LPSOperator
from warp_peri.points.families import bond_classes
from warp_peri.solvers.systems import DENSE, smallest_eigenvalue

ZONE = zone(161)
ZONE = ZONE[np.hypot(*ZONE.T) > 1e-9]
CLASSES = bond_classes(1.0, 3.0)


@parametrize(("name", "horizon"), [("1/r", 2.5), ("steep", 3.0), ("sign-changing", 2.5)])
def test_minimum_and_bound_against_a_fine_grid(name, horizon):
    model = kernel(name, horizon, lam=-0.2)
    found, expected = certify(model, spacing=1.0), smallest(symbol(model, ZONE), ZONE).min()
    assert found.symbol_min <= expected + 1e-12
    assert found.symbol_min == approx(expected, abs=1e-3)
    assert found.symbol_bound <= max(expected, 0)
    if expected > 0.05:
        assert found.symbol_bound >= 0.9 * expected
    assert found.holds == ("exactly one solution" in found.statement)


def test_what_does_not_hold_is_not_stated_and_what_holds_is():
    found = certify(kernel("sign-changing", 2.5), spacing=1.0)
    assert found.symbol_min < -0.03 < 0 == found.symbol_bound
    assert found.statement == "Nothing is proven on the lattice of spacing 1 Å."
    # Γ is positive, λ below μ lets the dilatation pull D down
    model = LPSMaterial(-0.6, 0.8, 1.0, [-0.54, 0.63, -0.08, -0.12, 0.18, -0.12], horizon=3.0)
    assert certify(replace(model, lam=0.8), spacing=1.0).holds
    found = certify(model, spacing=1.0, points=lattice(4, 3.0))
    assert found.gamma_min > 0 > found.symbol_min
    assert not found.holds
    # (iii) of the paper fails and D(k) is positive: with a domain the proof is the same
    model, points = kernel("sign-changing", 3.0, lam=20.0), lattice(11, 3.0)
    bare, dense = certify(model, spacing=1.0), certify(model, spacing=1.0, points=points)
    assert dense.gamma_minus_2phi_min < -0.04
    assert dense.statement == bare.statement
    assert (bare.holds, dense.holds, dense.paper, bare.paper) == (True, True, False, None)


def test_dense_figures_are_those_of_the_definition():
    model, points = kernel("sign-changing", 3.0), lattice(ell(), 3.0)
    inside = np.flatnonzero(points.interior)
    pulls = np.zeros((2 * len(inside), len(points.x), 2))
    for number, (i, a) in enumerate((i, a) for i in inside for a in (0, 1)):
        pulls[number, i, a] = 1.0
    gamma = replace(model, lam=1.0, mu=1.0).on(points)(pulls).reshape(len(pulls), -1).T  # L = Γ
    phi = np.array([[reference.dilatation(points.x, i, model, u) for u in pulls] for i in inside])
    figures = certify(model, spacing=1.0, points=points)
    schwarz = eigvalsh(gamma - 2 * phi.T @ phi)
    near(figures.gamma_min, eigvalsh(gamma)[0], 1e-9)
    near(figures.gamma_minus_2phi_min, schwarz[0], 1e-9)
    near(figures.gamma_minus_2phi_max, schwarz[-1], 1e-9)
    values = eigvalsh(phi @ np.linalg.solve(gamma, phi.T))
    values = values[values > 1e-9 * values[-1]]
    near(figures.inf_sup_min, values[0], 1e-6)
    assert figures.inf_sup_rank == len(values)
    with refused("spacing: expected that of the points, 1 Å, got 0.9"):
        certify(model, spacing=0.9, points=points)


def test_a_mode_that_changes_sign_across_a_symmetric_body_is_found():
    """Two halves and a bond between them: the lowest mode is antisymmetric."""
    chain = sp.diags_array(np.append(0.5, np.linspace(1.0, 2.0, DENSE - 1)))
    body = sp.block_array([[chain, sp.eye_array(DENSE)], [sp.eye_array(DENSE), chain]])
    near(smallest_eigenvalue(sp.csc_array(body)), -0.5, 1e-5)


@parametrize("seed", range(4))
def test_smallest_eigenvalue_is_at_least_the_proven_share_of_the_laplacians(seed):
    """Of kernels that change sign, on squares, disks, an L and frames of random size."""
    random, found = default_rng(seed), None
    while not (found and found.holds and model.influence(np.linspace(1, 3, 20)).min() < 0):  # noqa: F821
        mu, D = random.uniform(0.3, 1.0), random.normal(0.3, 0.6, size=5)
        model = LPSMaterial(random.uniform(-0.9 * mu, 3 * mu), mu, random.uniform(-1, 2.9), D, 3.0)
        found = certify(model, spacing=1.0)
    domain = np.ones(random.integers(4, 9, 2), bool)
    i, j = (int(random.integers(1, n - 1)) for n in domain.shape)
    a, b = np.indices(domain.shape)
    domain = [domain, np.hypot(a - i, b - j) <= 3, (a < i) | (b < j), (a != i) | (b != j)][seed % 4]
    points, node = lattice(domain, 3.0), np.argwhere(domain)
    L = LPSOperator(model, points).matrix()
    L = L[:, np.repeat(points.interior, 2)].toarray()
    step = np.abs(node[:, None] - node[None]).sum(-1)
    laplacian = eigvalsh(4.0 * (step == 0) - (step == 1))[0]
    assert eigvalsh((L + L.T) / 2)[0] >= found.symbol_bound * laplacian
    assert found.symbol_bound > 0.9 * found.symbol_min


def printed(v, kappa, mu, k):
    """Of D − 0.02 s, μ Γ − 0.02 s and μ (Γ − 2φφᵗ) the smallest eigenvalue over s, shape [3, K]."""
    found = [smallest(form(CLASSES, k, v, each), k) for each in (kappa, 0.0, -2 / mu)]
    return np.array(found) - [[0.02], [0.02], [0.0]]


@parametrize("kind", ["direct", "paper"])
def test_the_conditions_are_the_printed_ones_and_the_search_finds_the_softest(kind):
    model, conditions = kernel("sign-changing", 3.0, lam=0.7), StabilityConditions(kind, 0.02)
    v, kappa = stiffnesses(model, CLASSES)
    k = anywhere(7, 2)
    bonds, (i, j) = product_basis(CLASSES), np.triu_indices(len(v))
    for number, (own, level) in enumerate(conditions.forms(kappa, model.mu, conditions.zeta)):
        tensors = np.tensordot(np.concatenate([v, own * v[i] * v[j]]), bonds.basis, 1)
        margins = ratios(bonds.steps, tensors, k)[0] - level
        expected = printed(v, kappa, model.mu, k)[number]
        assert margins == approx(expected, abs=1e-12)
    margins = smallest_margins(CLASSES, conditions, v, kappa)
    expected = printed(v, kappa, model.mu, ZONE).min(1)[: len(margins)]
    assert (margins <= expected + 1e-5).all()
    assert (margins >= expected - 1e-3).all()
