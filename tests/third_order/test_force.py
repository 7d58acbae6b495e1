"""The nonlinear solid: its energy, invariants, gradient and tangent."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from tests.support.clouds import cloud
from tests.support.nonlinear import FORMS, psi, rotation, solid
from tests.support.problems import AXIS, ROUNDING, difference, lattice, noise, periodic, smooth
from warp_peri import InputError, Points
from warp_peri.launch import set_threads, threads
from warp_peri.third_order.operator import PlacedThirdOrder
from warp_peri.third_order.sweeps import third_order_force

HORIZON = 3.0
DIFFERENCES = 1e-8
STEPS = {"p_in": 1e-5}
"""Of differences, 0.002 elsewhere: clipping has a kink, and H moves with u and p_in."""


def strained(points, size=0.05, seed=0):
    """A rough field of displacement gradients of about `size`."""
    return size * noise(points, seed=seed)


@pytest.mark.parametrize("form", FORMS)
def test_the_linear_solid_is_the_tangent_at_zero(form):
    points, model = lattice(3, HORIZON), solid(form)
    linear = model.linear.on(points)(noise(points))
    nonlinear = PlacedThirdOrder(model, points)
    departures = [
        np.abs(nonlinear(size * noise(points)) / size - linear).max() for size in (1e-3, 1e-4)
    ]
    assert departures[0] / departures[1] == pytest.approx(10, rel=0.1)  # second order is left
    tangent = nonlinear.tangent(0 * points.x) @ noise(points).ravel()
    assert np.abs(tangent - linear.ravel()).max() <= ROUNDING * np.abs(linear).max()


def test_the_force_is_the_gradient_of_the_energy():
    points, _ = periodic((7, 8))
    model = solid("energy")
    op, linear = PlacedThirdOrder(model, points), model.linear.on(points)
    u = strained(points)
    directions = noise(points, 5, seed=2)

    def energy(amounts):
        field = u + np.tensordot(amounts, directions, axes=1)
        H, _ = op.gradients(field)
        return psi(H, model).sum() + (field * linear(field)).sum() / 2

    work = (directions * op(u)).sum(axis=(1, 2))
    slope = difference(energy, np.zeros(5), 2e-3)
    assert np.abs(slope - work).max() <= 1e-9 * np.abs(work).max()


@pytest.mark.parametrize("degrees", [5.0, 17.0, 30.0, 45.0, 90.0])
@pytest.mark.parametrize("form", FORMS)
def test_a_crystal_turned_on_the_same_nodes_has_the_turned_stress(form, degrees):
    """Of affine fields, at any angle, and the same energy: only short waves can differ."""
    points, model, turn = lattice(3, HORIZON), solid(form), rotation(np.deg2rad(degrees))
    turned = replace(points, axis=points.axis + degrees)
    gradient = np.array([[0.05, 0.03], [-0.02, -0.06]])
    there = turn @ gradient @ turn.T
    op, straight = PlacedThirdOrder(model, turned), PlacedThirdOrder(model, points)
    field = points.x @ there.T
    H, P = op.gradients(field)
    _, before = straight.gradients(points.x @ gradient.T)
    assert np.abs(op(field)).max() <= 1e-11
    assert np.abs(P - turn @ before @ turn.T).max() <= 1e-12
    by = AXIS + np.deg2rad(degrees)
    energies = psi(H, model, by), psi(np.broadcast_to(gradient, H.shape), model)
    assert np.abs(energies[0] - energies[1]).max() <= 1e-13
    u = strained(points)
    sixth = PlacedThirdOrder(model, replace(points, axis=points.axis + 60))(u)
    np.testing.assert_allclose(sixth, straight(u), rtol=0, atol=1e-13)  # the crystal's symmetry
    assert np.abs(op(u) - straight(u)).max() > 1e-6 * np.abs(straight(u)).max()


@pytest.mark.parametrize("form", FORMS)
def test_tangent(form):
    points = lattice(3, HORIZON)
    op = PlacedThirdOrder(solid(form), points)
    u, toward = strained(points), noise(points, seed=3)

    def force(amount):
        return op(u + amount[0] * toward)

    slope = difference(force, np.zeros(1), 1e-2)[0]
    tangent = op.tangent(u)
    predicted = (tangent @ toward.ravel()).reshape(-1, 2)
    assert np.abs(slope - predicted).max() <= DIFFERENCES * np.abs(slope).max()
    assert np.abs(op.product(u, toward) - predicted).max() <= 1e-12 * np.abs(slope).max()
    w = noise(points, seed=4)[points.interior]
    back = (tangent.T @ w.ravel()).reshape(-1, 2)
    assert np.abs(op.product_transpose(u, w) - back).max() <= 1e-12 * np.abs(back).max()
    inside = tangent[:, np.repeat(points.interior, 2)].toarray()
    asymmetry = np.abs(inside - inside.T).max() / np.abs(inside).max()
    assert asymmetry <= 1e-14 if form == "energy" else asymmetry > 1e-5


class Problem:
    """A scalar of L u as a function of the field, and of every parameter by name."""

    def __init__(self, form, radius=0.0):
        points = lattice(2, HORIZON)
        placed = PlacedThirdOrder(solid(form), points)
        self.sweeps, self.radius = placed.sweeps, radius
        self.seed = torch.from_numpy(noise(points, 2, seed=4)[:, points.interior])
        tables = placed.numbers.tables
        self.leaves = {"u": 0.05 * noise(points, 2), "tensors": tables[:3], "p_in": tables[3]}
        self.leaves |= {"p_out": tables[4], "cubic": placed.numbers.cubic}

    def scalar(self, u, tensors, p_in, p_out, cubic):
        tables = torch.cat([tensors, p_in[None], p_out[None]])
        Lu = third_order_force(self.sweeps, u, tables, cubic, radius=self.radius)
        return (self.seed * Lu).sum() + (Lu**2).sum() / 100

    def gradient(self):
        given = [torch.tensor(leaf, requires_grad=True) for leaf in self.leaves.values()]
        gradients = torch.autograd.grad(self.scalar(*given), given)
        return {name: gradient.numpy() for name, gradient in zip(self.leaves, gradients)}

    def value(self, name, leaf):
        leaves = self.leaves | {name: leaf.reshape(self.leaves[name].shape)}
        with torch.no_grad():
            return float(self.scalar(*map(torch.from_numpy, leaves.values())))


@pytest.mark.parametrize("radius", [0.0, 0.15])
@pytest.mark.parametrize("form", FORMS)
def test_gradient_against_differences(form, radius):
    problem = Problem(form, radius)
    for name, gradient in problem.gradient().items():
        leaf = problem.leaves[name].ravel()
        if name == "u":
            directions = noise(Points(leaf.reshape(-1, 2), np.ones(len(leaf) // 2, bool), 0.0), 3)
            directions = directions.reshape(3, -1)
            value = lambda amounts, name=name, leaf=leaf, d=directions: problem.value(
                name, leaf + amounts @ d
            )
            expected, gradient = difference(value, np.zeros(3), 1e-5), directions @ gradient.ravel()
        else:
            step = STEPS.get(name, 0.002)
            expected = difference(partial(problem.value, name), leaf, step)
        scale = np.abs(expected).max()
        assert np.abs(gradient.ravel() - expected).max() <= DIFFERENCES * scale, name


def test_results_do_not_depend_on_threads():
    before = threads()
    gradients = []
    try:
        for count in (1, 2, 3):
            set_threads(count)
            gradients.append(Problem("filtered").gradient())
    finally:
        set_threads(before)
    for name, first in gradients[0].items():
        assert all(np.array_equal(first, other[name]) for other in gradients[1:]), name


def test_clipping_projects_the_gradient():
    points, model = lattice(2, HORIZON), solid("energy")
    u = smooth(points.x, 1, wave_number=0.3)[0] * 0.2
    free, clipped = (PlacedThirdOrder(model, points, radius=radius) for radius in (0.0, 0.05))
    H, _ = free.gradients(u)
    size = np.linalg.norm(H, axis=(-2, -1))
    assert size.min() < 0.05 < size.max()
    assert clipped.largest_gradient(u) == pytest.approx(size.max())
    near = H * np.minimum(1, 0.05 / size)[:, None, None]
    energy = lambda entries: psi(near + entries.reshape(2, 2), model)
    by_energy = difference(energy, np.zeros(4), 1e-4).T.reshape(-1, 2, 2)
    assert np.abs(clipped.gradients(u)[1] - by_energy).max() < 1e-6
    assert np.array_equal(clipped(0.01 * u), free(0.01 * u))


def test_what_is_refused():
    model = solid("energy")
    with pytest.raises(InputError, match="a third-order crystal is for lattices"):
        PlacedThirdOrder(model, cloud(2, HORIZON))
    with pytest.raises(InputError, match="for 1, the points have 2, and transfer=False"):
        PlacedThirdOrder(model, lattice(2, HORIZON, spacing=2.0), transfer=False)
    points = lattice(2, HORIZON)
    placed = PlacedThirdOrder(model, points)
    for u in (points.x[:-1], points.x[None, :0], np.zeros((0, *points.x.shape))):
        with pytest.raises(InputError, match=r"u: expected float64 of shape \[S, 196, 2\]"):
            placed(u)
