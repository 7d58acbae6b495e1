"""Many nodes at a time on lattices laid out in rows, a bond and its opposite as one: the numbers of
one node and one bond after the other, to rounding.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.support.problems import KERNELS, LAM, MU, ell, lattice, noise, periodic
from warp_peri import Points
from warp_peri.launch import set_threads, threads
from warp_peri.materials.lps_bonds import Bonds
from warp_peri.materials.lps_force import lps_force
from warp_peri.methods import Solid

HORIZON = 3.0


def numbered(points, order):
    """The same points in another order."""
    return replace(points, x=points.x[order], interior=points.interior[order])


def across(points):
    """Numbered along the other axis."""
    return numbered(points, np.lexsort(points.x.T))


SETS = {
    "square": lambda: lattice(20, HORIZON),
    "L with a hole": lambda: lattice(np.kron(ell(), np.ones((4, 4))) > 0, HORIZON),
    "rotated": lambda: lattice(9, HORIZON, angle=0.7),
    "the other axis": lambda: across(lattice(ell(), HORIZON)),
    "periodic": lambda: periodic((7, 40))[0],
    "periodic, the other axis": lambda: across(periodic((9, 7))[0]),
    "periodic, partly interior": lambda: replace(
        periodic((20, 30))[0], interior=np.arange(600) % 30 < 9
    ),
}


def everything(bonds, points, name, samples):
    """L u and its gradients."""
    u = noise(points, samples)
    solid = {"lam": LAM, "mu": MU, **KERNELS[name]}
    dtype = getattr(torch, bonds.scalar.__name__)
    leaves = [torch.tensor(v, dtype=dtype, requires_grad=True) for v in (u, *solid.values())]
    Lu = lps_force(bonds, leaves[0], Solid(*leaves[1:]))
    seed = torch.as_tensor(noise(points, samples, seed=2)[:, points.interior], dtype=dtype)
    gradients = torch.autograd.grad((seed * Lu).sum(), leaves)
    return [Lu.detach().numpy(), *(gradient.numpy() for gradient in gradients)]


@pytest.mark.parametrize("kind", SETS)
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_is_the_force_of_the_lists_of_neighbours(kind, precision, monkeypatch):
    points = SETS[kind]()
    bonds = Bonds(points, HORIZON, precision=precision)
    assert bonds.layout.in_rows
    for name, samples in (("sign-changing", 1), ("positive", 3)):
        by_rows = everything(bonds, points, name, samples)
        with monkeypatch.context() as patch:
            patch.setattr("warp_peri.materials.lps_bonds.rows_of", lambda *_: None)
            lists = Bonds(points, HORIZON, precision=precision)
            by_lists = everything(lists, points, name, samples)
        for ours, other, parts in zip(by_rows, by_lists, 2 * [30] + 4 * [1e3]):
            within = parts * np.finfo(precision).eps * np.abs(other).max()
            np.testing.assert_allclose(ours, other, rtol=0, atol=within)


def test_nodes_in_no_order_or_far_apart_or_beside_a_crack_stay_in_their_lists():
    points = lattice(8, HORIZON)
    order = np.random.default_rng(0).permutation(len(points.x))
    assert not Bonds(numbered(points, order), HORIZON).layout.in_rows
    apart = Points(np.concatenate([points.x, points.x + 200.0]), np.tile(points.interior, 2), 1.0)
    assert not Bonds(apart, HORIZON).layout.in_rows
    outside = points.x[:, 0] > 4
    body = replace(points, interior=points.interior & ~outside, outside=outside)
    assert not Bonds(body, HORIZON).layout.in_rows


def test_two_evaluations_may_be_open_at_once_and_on_any_number_of_threads(monkeypatch):
    monkeypatch.setattr("warp_peri.launch.SLICE", 3)
    points = lattice(20, HORIZON)
    bonds = Bonds(points, HORIZON)
    solid = Solid(LAM, MU, *(KERNELS["positive"][key] for key in ("alpha", "D")))
    before = threads()
    gradients = []
    try:
        for count in (1, 2, 5):
            set_threads(count)
            fields = [torch.tensor(noise(points, seed=n), requires_grad=True) for n in (0, 1)]
            forces = [lps_force(bonds, u, solid) for u in fields]
            work = (forces[0] ** 2).sum() + 3 * (forces[1] ** 3).sum()
            gradients.append([g.numpy() for g in torch.autograd.grad(work, fields)])
    finally:
        set_threads(before)
    for other in gradients[1:]:
        np.testing.assert_array_equal(gradients[0], other)
    by_itself = torch.tensor(noise(points, seed=1), requires_grad=True)
    (3 * (lps_force(bonds, by_itself, solid) ** 3).sum()).backward()
    np.testing.assert_array_equal(by_itself.grad, gradients[0][1])
