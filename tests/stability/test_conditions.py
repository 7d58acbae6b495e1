"""The solvability conditions on the symbol, their gradients, and the search for violations."""

import numpy as np
import pytest

from tests.support.problems import GRADIENT, KERNELS, difference, kernel
from warp_peri import InputError
from warp_peri.lps.model import stiffnesses
from warp_peri.lps.symbol import symbol
from warp_peri.points.families import bond_classes
from warp_peri.regression.optimum import CONDITIONS, Conditions, LatticeConditions, ZoneSearch

CLASSES = bond_classes(1.0, 3.0)
K = np.random.default_rng(2).uniform(-np.pi, np.pi, (7, 2))
every_kernel = pytest.mark.parametrize("name", KERNELS)
every_kind = pytest.mark.parametrize("kind", CONDITIONS)


def eigenvalues(wave, v, kappa):
    """Of Γ + κ φφᵗ at each wave vector."""
    d11, d22, d12 = wave.entries(v, kappa)
    return np.linalg.eigvalsh(np.stack([d11, d12, d12, d22], -1).reshape(-1, 2, 2))


@every_kernel
@pytest.mark.parametrize("lam", [-0.2, 0.9])
def test_gradient_of_the_ratio(name, lam):
    wave = symbol(CLASSES, K)
    v, kappa = stiffnesses(kernel(name, 3.0, lam=lam), CLASSES)
    gradients = wave.ratio_gradient(v, kappa)
    expected = (
        difference(lambda v: wave.ratio(v, kappa), v, 1e-3 * np.abs(v).max()).T,
        difference(lambda x: wave.ratio(v, x[0]), [kappa], 1e-3)[0],
    )
    for gradient, reference in zip(gradients, expected):
        assert np.abs(gradient - reference).max() <= GRADIENT * np.abs(reference).max()


@every_kernel
@every_kind
def test_gradients_of_the_margins(name, kind):
    wave, conditions = symbol(CLASSES, K), LatticeConditions(CLASSES, Conditions(kind, 0.02))
    v, kappa = stiffnesses(kernel(name, 3.0), CLASSES)

    def margins(x):
        return conditions.margins(wave, x[1:], x[0])

    scale = 1e-3 * np.abs(v).max()
    expected = np.moveaxis(difference(margins, np.concatenate([[kappa], v]), scale), 0, -1)
    gradients = conditions.gradients(wave, v, kappa)
    assert gradients.shape == (len(conditions.names), len(K), 1 + len(v))
    assert np.abs(gradients - expected).max() <= GRADIENT * np.abs(expected).max()


@every_kernel
def test_margins_are_the_printed_conditions(name):
    model = kernel(name, 3.0, lam=0.1, mu=0.6)
    v, kappa = stiffnesses(model, CLASSES)
    wave = symbol(CLASSES, K)
    s = wave.laplacian
    margins = LatticeConditions(CLASSES, Conditions("paper", 0.02)).margins(wave, v, kappa)
    np.testing.assert_allclose(margins[0], eigenvalues(wave, v, kappa)[:, 0] / s - 0.02, atol=1e-12)
    np.testing.assert_allclose(margins[1], eigenvalues(wave, v, 0.0)[:, 0] / s - 0.02, atol=1e-12)
    expected = 0.6 * eigenvalues(wave, v / 0.6, -2.0)[:, 0] / s  # Γ − 2φφᵗ of w, times μ
    np.testing.assert_allclose(margins[2], expected, atol=1e-12)
    direct = LatticeConditions(CLASSES, Conditions("direct", 0.02)).margins(wave, v, kappa)
    assert np.array_equal(direct, margins[:1])


@every_kernel
@every_kind
def test_the_search_finds_what_a_finer_grid_finds(name, kind):
    conditions = LatticeConditions(CLASSES, Conditions(kind, 0.02))
    point = stiffnesses(kernel(name, 3.0, lam=0.7), CLASSES)
    smallest, where = ZoneSearch(conditions, 30).worst(*point)
    line = np.linspace(1e-3, np.pi, 301)
    fine = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2)
    expected = conditions.margins(symbol(CLASSES, fine), *point).min(axis=1)
    assert (smallest <= expected + 1e-5).all()
    again = conditions.margins(symbol(CLASSES, where), *point).min(axis=1)
    np.testing.assert_allclose(again, smallest, atol=1e-5)


@pytest.mark.parametrize(
    ("kind", "zeta", "words"),
    [
        ("plain", 0.01, "conditions: expected one of direct, paper, got 'plain'"),
        ("direct", 0.0, "zeta: expected a stiffness > 0, got 0.0"),
        ("direct", np.nan, "zeta: expected a stiffness > 0, got nan"),
    ],
)
def test_bad_choices_are_refused(kind, zeta, words):
    with pytest.raises(InputError, match=words):
        LatticeConditions(CLASSES, Conditions(kind, zeta))
