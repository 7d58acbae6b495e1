"""The residual by rows is Warp's operator's: its value, its gradients, whatever the data."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.support.problems import KERNELS, REDUCED, ell, kernel, lattice, manufactured, noise
from warp_peri import InputError
from warp_peri.fitting import rows
from warp_peri.fitting.rows import sample_weights
from warp_peri.materials.lps_law import Products
from warp_peri.materials.lps_stages import OperatorLoss, class_weights, total_loss

HORIZON = 2.5


def samples(spacing=1.0, seed=0):
    """Loads of very different size that no kernel explains."""
    points = lattice(ell(), HORIZON, spacing=spacing)
    points = manufactured(kernel("growing", HORIZON, spacing), points, 4, seed=seed)
    size = np.array([1.0, 0.1, 3.0, 1.0])[:, None, None]
    return replace(points, u=size * points.u, b=size * (points.b + noise(points, 4, seed=seed)))


SETS = {"one lattice": [samples()], "two lattices": [samples(), samples(0.5, seed=1)]}


def by_rows(sets, weights, lam, mu, alpha, D):
    """‖R p − y‖² over the sets as a function of λ, μ, α, D."""
    total = 0.0
    for each, weight in zip(sets, weights):
        products = Products(each, HORIZON)
        of, w = products.rows(weight), class_weights(products.classes, alpha, D)
        i, j = np.triu_indices(len(w))
        p = torch.cat([mu * w, (lam - mu) * w[i] * w[j]])
        total += (torch.from_numpy(of.R) @ p - torch.from_numpy(of.y)).square().sum()
    return total


def leaves(lam=-0.2, mu=0.7, *, alpha, D):
    """λ, μ, α and D."""
    values = lam, mu, alpha, D
    return [torch.tensor(value, dtype=torch.float64, requires_grad=True) for value in values]


def slopes(loss, parameters):
    return torch.cat([part.reshape(-1) for part in torch.autograd.grad(loss, parameters)])


@pytest.mark.parametrize(
    ("sets", "normalise", "block"), [("one lattice", False, 1), ("two lattices", True, None)]
)
def test_is_the_full_loss_with_its_gradients(sets, normalise, block, monkeypatch):
    sets = SETS[sets]
    if block:
        monkeypatch.setattr(rows, "BLOCK", block)
    weights = sample_weights(sets, normalise=normalise)
    full = [OperatorLoss(each, HORIZON, weight) for each, weight in zip(sets, weights)]
    start = leaves(0.0, 1.0, alpha=1.0, D=np.random.default_rng(0).uniform(size=4))
    size = slopes(total_loss(full, start), start).norm()
    for name, shape in KERNELS.items():
        given = leaves(**shape)
        pair = by_rows(sets, weights, *given), total_loss(full, given)
        assert abs(pair[0].item() / pair[1].item() - 1) <= REDUCED, name
        gradient, expected = (slopes(loss, given) for loss in pair)
        assert (gradient - expected).norm() <= REDUCED * size, name


def test_the_loss_is_its_definition():
    residual, load, sets = 0.0, 0.0, SETS["two lattices"]
    for each in sets:
        model = kernel("positive", HORIZON, each.spacing, lam=-0.2, mu=0.7)
        for force, b in zip(model.on(each)(each.u), each.b[:, each.interior]):
            size = np.sum(b**2)
            residual += np.sum((force - b) ** 2) / size
            load += 1.0
    found = by_rows(sets, sample_weights(sets, normalise=True), *leaves(**KERNELS["positive"]))
    assert found.item() == pytest.approx(residual / load, rel=1e-11)


def test_a_sample_without_load_cannot_be_normalised():
    (points,) = SETS["one lattice"]
    b = points.b.copy()
    b[1, points.interior] = 0
    with pytest.raises(InputError, match="sample 1 has no load and cannot be normalised"):
        sample_weights([replace(points, b=b)], normalise=True)
