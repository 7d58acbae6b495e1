"""The margins that stage 2 sees, and where it goes."""

import numpy as np
import pytest
import torch

from tests.support.problems import GRADIENT, difference, ell, kernel, lattice
from tests.support.symbols import smallest_margins
from warp_peri import certify
from warp_peri.learning.two_stage import (
    DENSE_ZETA,
    PRINTED_HORIZON,
    DenseMargins,
    SymbolMargins,
    _class_matrices,
    least_of_blocks,
    mirror_blocks,
)
from warp_peri.materials.lps import stiffnesses
from warp_peri.methods import Conditions
from warp_peri.points.families import bond_classes

HORIZON, ZETA = 3.0, 0.02
CLASSES = bond_classes(1.0, HORIZON)


def class_weights(model):
    return stiffnesses(model, CLASSES)[0] / model.mu


def margins_of(kind):
    if kind == "dense":
        return DenseMargins([lattice(ell(), HORIZON)], HORIZON)
    return SymbolMargins(Conditions("paper", ZETA), [CLASSES])


@pytest.mark.parametrize("kind", ["symbol", "dense"])
@pytest.mark.parametrize("name", ["sign-changing", "steep"])
def test_gradients_of_the_margins(kind, name):
    margins = margins_of(kind)
    given = np.concatenate([[-0.2, 0.7], class_weights(kernel(name, HORIZON))])

    sigma = torch.from_numpy(CLASSES.count * CLASSES.r**2)

    def values(x):
        # Σ n r² w = 1 must stay: without it the margin of (iii) has a kink at long waves.
        return margins(x[0], x[1], [x[2:] / (sigma @ x[2:])])

    expected = difference(lambda x: values(torch.from_numpy(x)).numpy(), given, 1e-5).T
    start = torch.from_numpy(given).requires_grad_()
    gradients = np.array(
        [torch.autograd.grad(margin, start, retain_graph=True)[0] for margin in values(start)]
    )
    assert np.abs(gradients - expected).max() <= GRADIENT * np.abs(expected).max()


def test_dense_margins_are_those_of_the_certificate():
    model, points = kernel("sign-changing", HORIZON), lattice(ell(), HORIZON)
    weights = [torch.from_numpy(class_weights(model))]
    lam, mu = torch.tensor([model.lam, model.mu], dtype=torch.float64)
    margins = DenseMargins([points], HORIZON)(lam, mu, weights).numpy()
    certificate = certify(model, spacing=1.0, points=points)
    unit = (HORIZON / PRINTED_HORIZON) ** 2
    expected = unit * np.array([certificate.gamma_min, certificate.gamma_minus_2phi_min])
    expected[0] -= DENSE_ZETA
    np.testing.assert_allclose(margins[[0, 2]], expected, rtol=1e-9)
    if certificate.inf_sup_rank == points.interior.sum():
        assert margins[1] == pytest.approx(certificate.inf_sup_min - DENSE_ZETA, rel=1e-6)


def test_mirrors_split_the_dense_conditions_without_changing_them():
    """A square falls into four blocks, an L is one; a nudged square is one again."""
    model, points = kernel("sign-changing", HORIZON), lattice(7, HORIZON)
    w = class_weights(model)
    gammas, phis = _class_matrices(points, HORIZON)
    x = points.x[points.interior]
    assert len(mirror_blocks(gammas, phis, x)) == 4
    assert len(mirror_blocks(gammas, phis, x**1.1)) == 1
    leaf = torch.tensor(w, requires_grad=True)
    whole, blocks = (
        least_of_blocks(parts, leaf) for parts in ([(gammas, phis)], mirror_blocks(gammas, phis, x))
    )
    for one, other in zip(whole, blocks):
        assert other.item() == pytest.approx(one.item(), rel=1e-9, abs=1e-14)
        slope, same = (torch.autograd.grad(margin, leaf)[0].numpy() for margin in (one, other))
        np.testing.assert_allclose(same, slope, atol=1e-9 * np.abs(slope).max())


def test_symbol_margins_are_the_smallest_of_the_zone():
    model = kernel("sign-changing", HORIZON, lam=-0.2)
    conditions = Conditions("paper", ZETA)
    weights = [torch.from_numpy(class_weights(model))]
    lam, mu = torch.tensor([model.lam, model.mu], dtype=torch.float64)
    margins = SymbolMargins(conditions, [CLASSES])(lam, mu, weights).numpy()
    smallest = smallest_margins(CLASSES, conditions, *stiffnesses(model, CLASSES))
    np.testing.assert_allclose(margins, smallest, atol=2e-3)
    assert (margins >= smallest - 1e-12).all()
