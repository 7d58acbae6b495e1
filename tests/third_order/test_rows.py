"""The nonlinear solid's sweeps over rows of pairs of bonds: every layout, against plain sums."""

import numpy as np
import pytest
import torch

from tests.lps.test_rows import SETS, numbered
from tests.support.nonlinear import solid
from tests.support.problems import ROUNDING, difference, lattice, noise
from warp_peri.third_order import sweeps
from warp_peri.third_order.operator import PlacedThirdOrder
from warp_peri.third_order.sweeps import third_order_force

HORIZON = 3.0


def shuffled():
    """In no order at all, so that no two nodes follow one another."""
    points = lattice(5, HORIZON)
    return numbered(points, np.random.default_rng(5).permutation(len(points.x)))


def apart():
    """Two squares in opposite corners of a rectangle that is mostly empty."""
    blocks = np.zeros((60, 60), bool)
    blocks[:3, :3] = blocks[-3:, -3:] = True
    return lattice(blocks, HORIZON)


LAYOUTS = SETS | {"shuffled": shuffled, "mostly empty": apart}


def by_lists(op, points, u):
    """L u from the linear solid, P at the nodes and sums over neighbours, (N2)."""
    sweeps = op.sweeps
    p_out = op.numbers.tables[4, sweeps.pair]
    stress = np.zeros((len(points.x), 2, 2))
    stress[sweeps.full] = op.gradients(u)[1]
    ends = sweeps.neighbour.reshape(len(points.x), -1)[sweeps.rows]
    both = stress[sweeps.rows][:, None] + stress[ends]
    linear = op.straight(u)
    return linear - np.einsum("ipkl,pl,p->ik", both, sweeps.xi, p_out)


def gradients_by_lists(op, points, u):
    """H at the nodes `full`, (N1)."""
    sweeps = op.sweeps
    p_in = op.numbers.tables[3, sweeps.pair]
    ends = sweeps.neighbour.reshape(len(points.x), -1)[sweeps.full]
    eta = u[ends] - u[sweeps.full][:, None]
    return np.einsum("ipk,pl,p->ikl", eta, sweeps.xi, p_in)


def tensors(of):
    return [torch.tensor(each, dtype=torch.float64) for each in (of.tables, of.cubic)]


@pytest.mark.parametrize("kind", LAYOUTS)
def test_force_and_derivatives(kind):
    """Of every layout; ∂/∂u by the sparse tangent, the parameters' by differences."""
    points = LAYOUTS[kind]()
    op = PlacedThirdOrder(solid("filtered"), points)
    u = 0.05 * noise(points)
    H = gradients_by_lists(op, points, u)
    assert np.abs(op.gradients(u)[0] - H).max() <= ROUNDING * np.abs(H).max()
    force = by_lists(op, points, u)
    assert np.abs(op(u) - force).max() <= 2 * ROUNDING * np.abs(force).max()
    seed = noise(points, seed=3)[points.interior]
    given = tensors(op.numbers)
    leaves = [torch.tensor(value, requires_grad=True) for value in (u, *(t.numpy() for t in given))]
    Lu = third_order_force(op.sweeps, *leaves)
    by_u, *others = torch.autograd.grad((torch.from_numpy(seed) * Lu).sum(), leaves)
    expected = (op.tangent(u).T @ seed.ravel()).reshape(-1, 2)
    assert np.abs(by_u.numpy() - expected).max() <= 1e-12 * np.abs(expected).max()
    for n, gradient in enumerate(others):
        direction = given[n] * torch.linspace(0.5, 1.5, given[n].numel()).reshape(given[n].shape)

        def value(amount, n=n, direction=direction):
            moved = [*given[:n], given[n] + float(amount[0]) * direction, *given[n + 1 :]]
            field = third_order_force(op.sweeps, torch.from_numpy(u), *moved)
            return float((torch.from_numpy(seed) * field).sum())

        slope = difference(value, np.zeros(1), 1e-2)[0]
        along = float((gradient * direction).sum())
        assert along == pytest.approx(slope, rel=1e-8)


def test_samples_one_after_another(monkeypatch):
    """The force to the bit; sums over samples are the same for all that memory holds at once."""
    points = lattice(4, HORIZON)
    op = PlacedThirdOrder(solid("energy"), points)
    u = torch.from_numpy(0.05 * noise(points, 5)).requires_grad_()
    tables, cubic = tensors(op.numbers)
    cubic.requires_grad_()
    found = []
    for most in (sweeps.AT_ONCE, 1):
        monkeypatch.setattr(sweeps, "AT_ONCE", most)
        Lu = third_order_force(op.sweeps, u, tables, cubic)
        found.append([Lu.detach(), *torch.autograd.grad((Lu**2).sum(), [u, cubic])])
    for one, other in zip(*found):
        assert (one - other).abs().max() <= 1e-13 * one.abs().max()
    assert torch.equal(found[0][0], found[1][0])
