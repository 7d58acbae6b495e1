"""The nonlinear solid: its energy, invariants, gradient and tangent."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.support.nonlinear import FORMS, psi, rotation, solid, tangent
from tests.support.problems import AXIS, ROUNDING, difference, lattice, noise, smooth
from warp_peri.materials.third_order import PlacedThirdOrder

HORIZON = 3.0
DIFFERENCES = 1e-8


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
    product = tangent(nonlinear, 0 * points.x) @ noise(points).ravel()
    assert np.abs(product - linear.ravel()).max() <= ROUNDING * np.abs(linear).max()


@pytest.mark.parametrize("degrees", [17.0, 90.0])
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

    slope = difference(lambda amount: op(u + amount[0] * toward), np.zeros(1), 1e-2)[0]
    square = tangent(op, u)
    predicted = (square @ toward.ravel()).reshape(-1, 2)
    assert np.abs(slope - predicted).max() <= DIFFERENCES * np.abs(slope).max()
    assert np.abs(op.jvp(u, toward) - predicted).max() <= 1e-12 * np.abs(slope).max()
    inside = square[:, np.repeat(points.interior, 2)].toarray()
    asymmetry = np.abs(inside - inside.T).max() / np.abs(inside).max()
    assert asymmetry <= 1e-14 if form == "energy" else asymmetry > 1e-5


@pytest.mark.parametrize("form", FORMS)
def test_gradients_to_the_constants_are_those_of_differences(form):
    points, names = lattice(2, HORIZON), ("t3", "tq2", "q3")
    op, u = PlacedThirdOrder(solid(form), points), 0.05 * noise(points, 2)
    seed = noise(points, 2, seed=4)[:, points.interior]
    slopes = {name: op.by_numbers(name, u, seed) for name in names}
    for name in names:
        value = op.learnable[name]
        ends = [op.at(op.learnable | {name: value * (1 + e)})(u) for e in (0.5, -0.5)]
        expected = (seed * (ends[0] - ends[1])).sum() / value
        assert float(slopes[name]) == pytest.approx(expected, rel=1e-10)
    numbers = {n: torch.tensor(op.learnable[n], dtype=torch.float64) for n in names}
    field = torch.from_numpy(u).requires_grad_()
    force = op.force_with_parameters(field, {n: one.requires_grad_() for n, one in numbers.items()})
    back = torch.autograd.grad(force, [field, *numbers.values()], torch.from_numpy(seed))
    np.testing.assert_array_equal(back[0], op.vjp(u, seed))
    assert [float(one) for one in back[1:]] == [float(slopes[n]) for n in names]


def test_clipping_projects_the_gradient():
    points, model = lattice(2, HORIZON), solid("energy")
    u = smooth(points.x, 1, wave_number=0.3)[0] * 0.2
    op = PlacedThirdOrder(model, points)
    size = np.linalg.norm(op.gradients(u)[0], axis=(-2, -1))
    assert size.min() < 0.05 < size.max()
    assert op.largest_gradient(u) == pytest.approx(size.max())
    uniform = points.x @ np.array([[0.05, 0.03], [-0.02, -0.06]]).T
    rough = 0.01 * noise(points)
    # of a uniform gradient the stress beyond the ball is that on it, wherever it is uniform
    for field in (uniform, 4 * uniform):
        assert np.abs(op.force(field, radius=0.05)).max() <= 1e-12
    assert np.array_equal(op.force(rough, radius=9.0), op(rough))
    assert np.abs(op.force(u, radius=0.05) - op(u)).max() > 1e-4 * np.abs(op(u)).max()
    H, _ = op.gradients(u)
    near = H * np.minimum(1, 0.05 / size)[:, None, None]
    energy = lambda entries: psi(near + entries.reshape(2, 2), model)
    P = difference(energy, np.zeros(4), 1e-4).T.reshape(-1, 2, 2)
    gap = P - op.gradients(u)[1]
    moved = op.force(u, radius=0.05) - op(u)
    v = np.where(points.interior[:, None], noise(points, seed=3), 0.0)
    work = (gap * op.gradients(v)[0]).sum()  # the weights of both sides are the same
    assert (moved * v[points.interior]).sum() == pytest.approx(work, rel=1e-5)
