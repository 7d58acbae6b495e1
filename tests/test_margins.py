"""Margins of stage 2: eigenvalues of their definitions, with the right derivatives."""

import numpy as np
import pytest
import torch

from tests.problems import lattice
from warp_peri import Model, certify
from warp_peri.conditions import Conditions, ZoneSearch
from warp_peri.families import bond_classes
from warp_peri.margins import DENSE_ZETA, DenseMargins, SymbolMargins

HORIZON = 2.5


def weights(D, horizon=HORIZON):
    """Class weights of a kernel on the unit lattice, as a leaf."""
    classes = bond_classes(1.0, horizon)
    kw = Model(0.3, 0.8, 1.2, D, horizon).influence(classes.r) * classes.weight
    return torch.tensor(kw / (classes.count @ (kw * classes.r**2)), requires_grad=True)


def test_dense_margins_are_those_of_the_certificate():
    points, D = lattice(5, HORIZON), [1.0, 0.3, 0.2]
    one = torch.ones((), dtype=torch.float64)
    w = weights(D)
    found = DenseMargins([points], HORIZON)(one, one, [(w, w)]).detach().numpy()
    figures = certify(Model(0.3, 0.8, 1.2, D, HORIZON), spacing=1.0, points=points)
    expected = [figures.gamma_min - DENSE_ZETA, figures.inf_sup_min - DENSE_ZETA]
    np.testing.assert_allclose(found, [*expected, figures.gamma_minus_2phi_min], rtol=1e-8)


def test_dense_derivatives():
    margins = DenseMargins([lattice(5, HORIZON)], HORIZON)
    one = torch.ones((), dtype=torch.float64)
    w, p = weights([1.0, 0.3, 0.2]), weights([0.7, 0.5, 0.4])
    assert torch.autograd.gradcheck(lambda w, p: margins(one, one, [(w, p)]), (w, p), eps=1e-7)


@pytest.mark.parametrize("kind", ["direct", "paper"])
def test_symbol_margins_are_the_worst_of_the_zone_with_their_derivatives(kind):
    conditions = Conditions(bond_classes(1.0, HORIZON), kind, 0.01)
    margins = SymbolMargins([conditions])
    w, p = weights([1.0, 0.3, 0.2]), weights([0.7, 0.5, 0.4])
    lam, mu = (torch.tensor(x, dtype=torch.float64, requires_grad=True) for x in (-0.1, 0.8))
    found = margins(lam, mu, [(w, p)]).detach().numpy()
    v, z, kappa = 0.8 * w.detach().numpy(), 0.8 * p.detach().numpy(), -0.9 / 0.8**2
    worst, _ = ZoneSearch(conditions).worst(v, z, kappa)
    np.testing.assert_allclose(found, worst, atol=2e-3)  # a coarser grid than the search's
    assert (found >= worst - 1e-12).all()
    assert torch.autograd.gradcheck(
        lambda lam, mu, w, p: margins(lam, mu, [(w, p)]), (lam, mu, w, p), eps=1e-7
    )
