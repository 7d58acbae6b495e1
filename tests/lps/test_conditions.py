"""The solvability conditions on the symbol, their derivatives, and the search for violations."""

import numpy as np
import pytest

from tests.support.problems import GRADIENT, KERNELS, difference, kernel
from tests.support.symbols import form, smallest, smallest_margins
from warp_peri import InputError
from warp_peri.core.stencil import ratios
from warp_peri.fitting.settings import CONDITIONS, Conditions, Optimum
from warp_peri.materials.lps import stiffnesses
from warp_peri.materials.lps_fit import LPSFound, LPSLaw, class_pairs, product_basis
from warp_peri.points.families import bond_classes

CLASSES = bond_classes(1.0, 3.0)
every_kernel = pytest.mark.parametrize("name", KERNELS)
every_kind = pytest.mark.parametrize("kind", CONDITIONS)


def printed(v, kappa, mu, k):
    """Of D − 0.02 s, μ Γ − 0.02 s and μ (Γ − 2φφᵗ) the smallest eigenvalue over s, shape [3, K]."""
    of = (kappa, 0.0, -2 / mu)
    found = np.array([smallest(form(CLASSES, k, v, each), k) for each in of])
    return found - np.array([[0.02], [0.02], [0.0]])


@every_kernel
@every_kind
def test_derivatives_of_the_numbers(name, kind):
    model, method = kernel(name, 3.0, lam=0.1), Optimum("isotropic", smoothness=1e-3)
    start = LPSFound(model.solid)
    law = LPSLaw([CLASSES], start, Conditions(kind, 0.02), method)
    y = law.start(start)
    at = law(y)
    assert len(at.forms) == len(CONDITIONS[kind])

    def values(y):
        there = law(y)
        forms = [each.p for each in there.forms]
        return np.concatenate([*there.p, *forms, there.equal, there.margins, there.beside])

    slopes = np.vstack([*at.slopes, *(each.slopes for each in at.forms), at.A, at.M, at.by])
    expected = difference(values, y, 1e-3).T
    assert np.abs(slopes - expected).max() <= GRADIENT * np.abs(expected).max()


@every_kernel
def test_the_conditions_are_the_printed_ones(name):
    """Of all forms at any waves, by rows that are linear in their numbers."""
    model = kernel(name, 3.0, lam=0.1, mu=0.6)
    v, kappa = stiffnesses(model, CLASSES)
    k = np.random.default_rng(2).uniform(-np.pi, np.pi, (7, 2))
    bonds, (i, j) = product_basis(CLASSES), class_pairs(len(v))
    for number, (own, level) in enumerate(Conditions("paper", 0.02).forms(kappa, 0.6)):
        tensors = np.tensordot(np.concatenate([v, own * v[i] * v[j]]), bonds.basis, 1)
        margins = ratios(bonds.steps, tensors, k)[0] - level
        np.testing.assert_allclose(margins, printed(v, kappa, 0.6, k)[number], atol=1e-12)


@every_kernel
@every_kind
def test_the_search_finds_what_a_finer_grid_finds(name, kind):
    v, kappa = stiffnesses(kernel(name, 3.0, lam=0.7), CLASSES)
    margins = smallest_margins(CLASSES, Conditions(kind, 0.02), v, kappa)
    line = np.linspace(1e-3, np.pi, 301)
    fine = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2)
    mu = CLASSES.count * CLASSES.r**2 @ v
    expected = printed(v, kappa, mu, fine).min(axis=1)[: len(margins)]
    assert (margins <= expected + 1e-5).all()
    assert (margins >= expected - 1e-3).all()


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
        Conditions(kind, zeta)
