"""The reduced loss is the full one: its value, its gradients, whatever the data."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.support.problems import KERNELS, REDUCED, ell, kernel, lattice, manufactured, noise
from warp_peri import InputError
from warp_peri.fitting import rows
from warp_peri.fitting.training_data import sample_weights
from warp_peri.materials.lps_adam import OperatorLoss, class_weights
from warp_peri.materials.lps_rows import Products, class_pairs

HORIZON = 2.5


def samples(spacing=1.0, seed=0):
    """Loads of very different size that no kernel explains."""
    points = lattice(ell(), HORIZON, spacing=spacing)
    points = manufactured(kernel("growing", HORIZON, spacing), points, 4, seed=seed)
    size = np.array([1.0, 0.1, 3.0, 1.0])[:, None, None]
    return replace(points, u=size * points.u, b=size * (points.b + noise(points, 4, seed=seed)))


SETS = {"one lattice": [samples()], "two lattices": [samples(), samples(0.5, seed=1)]}


def both(sets, normalise):
    """The residual by rows and by Warp's operator, of each set."""
    weights = sample_weights(sets, normalise=normalise)
    return (
        [RowsLoss(samples, weight) for samples, weight in zip(sets, weights)],
        [OperatorLoss(samples, HORIZON, weight) for samples, weight in zip(sets, weights)],
    )


class RowsLoss:
    """‖R p − y‖² as a function of λ, μ, α, D."""

    def __init__(self, samples, weight):
        products = Products(samples, HORIZON)
        self.classes, self.rows = products.classes, products.rows(weight)

    def loss(self, lam, mu, alpha, D):
        w = class_weights(self.classes, alpha, D)
        i, j = class_pairs(len(w))
        p = torch.cat([mu * w, (lam - mu) * w[i] * w[j]])
        return (torch.from_numpy(self.rows.R) @ p - torch.from_numpy(self.rows.y)).square().sum()


def leaves(lam=-0.2, mu=0.7, *, alpha, D):
    """λ, μ, α and D."""
    values = lam, mu, alpha, D
    return [torch.tensor(value, dtype=torch.float64, requires_grad=True) for value in values]


def reduced_loss(grids, *parameters):
    return sum(grid.loss(*parameters) for grid in grids)


def compare(grids, full, parameters):
    """Relative difference of the values, the difference of the gradients, and their size."""
    values = [reduced_loss(grids, *parameters), sum(part.loss(*parameters) for part in full)]
    gradient, expected = (
        torch.cat([part.reshape(-1) for part in torch.autograd.grad(loss, parameters)])
        for loss in values
    )
    relative = abs(values[0].item() / values[1].item() - 1)
    return relative, (gradient - expected).norm(), expected.norm()


@pytest.mark.parametrize("block", [None, 1], ids=["one block", "many blocks"])
@pytest.mark.parametrize("normalise", [False, True], ids=["absolute", "normalised"])
@pytest.mark.parametrize("sets", SETS.values(), ids=SETS)
def test_is_the_full_loss_with_its_gradients(sets, normalise, block, monkeypatch):
    if block:
        monkeypatch.setattr(rows, "BLOCK", block)
    grids, full = both(sets, normalise)
    start = leaves(0.0, 1.0, alpha=1.0, D=np.random.default_rng(0).uniform(size=4))
    _, _, size = compare(grids, full, start)
    for name, shape in KERNELS.items():
        loss, gradient, _ = compare(grids, full, leaves(**shape))
        assert loss <= REDUCED, name
        assert gradient <= REDUCED * size, name


@pytest.mark.parametrize("normalise", [False, True], ids=["absolute", "normalised"])
@pytest.mark.parametrize("sets", SETS.values(), ids=SETS)
def test_the_loss_is_its_definition(sets, normalise):
    residual, load = 0.0, 0.0
    for samples in sets:
        model = kernel("positive", HORIZON, samples.spacing, lam=-0.2, mu=0.7)
        Lu = model.on(samples)(samples.u)
        for force, b in zip(Lu, samples.b[:, samples.interior]):
            size = np.sum(b**2) if normalise else 1.0
            residual += np.sum((force - b) ** 2) / size
            load += np.sum(b**2) / size
    grids, full = both(sets, normalise)
    parameters = leaves(**KERNELS["positive"])
    for loss in (reduced_loss(grids, *parameters), sum(part.loss(*parameters) for part in full)):
        assert loss.item() == pytest.approx(residual / load, rel=1e-11)


def test_errors_are_those_of_each_loaded_sample():
    (points,) = SETS["one lattice"]
    b = points.b.copy()
    b[2] = 0
    full = OperatorLoss(replace(points, b=b), HORIZON, np.ones(4))
    Lu = kernel("steep", HORIZON, lam=0.1, mu=0.7).on(points)(points.u)
    inside = b[:, points.interior]
    expected = [np.linalg.norm(Lu[s] - inside[s]) / np.linalg.norm(inside[s]) for s in (0, 1, 3)]
    errors = full.errors(0.1, 0.7, 2.9, [1.0])
    np.testing.assert_allclose(errors, expected, rtol=1e-12)


def test_sets_that_carry_nothing_to_fit_are_refused():
    (points,) = SETS["one lattice"]
    none = np.empty((0, len(points.x), 2))
    with pytest.raises(InputError, match="the training set has no samples"):
        sample_weights([points, replace(points, u=none, b=none)], normalise=False)
    collar = np.where(points.interior[:, None], 0.0, noise(points, 4))
    with pytest.raises(InputError, match="the training set has no loads on its interior"):
        sample_weights([replace(points, b=collar)], normalise=False)
    b = points.b.copy()
    b[1, points.interior] = 0
    with pytest.raises(InputError, match="sample 1 has no load and cannot be normalised"):
        sample_weights([replace(points, b=b)], normalise=True)
