"""The nonlinear solid: its energy, invariants, gradient and tangent."""

import numpy as np
import pytest

from tests.support.nonlinear import FORMS, psi, solid
from tests.support.problems import ROUNDING, difference, lattice, noise, smooth
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
    product = nonlinear.jvp(0 * points.x, noise(points))
    assert np.abs(product - linear).max() <= ROUNDING * np.abs(linear).max()


@pytest.mark.parametrize("form", FORMS)
def test_tangent(form):
    points = lattice(3, HORIZON)
    op = PlacedThirdOrder(solid(form), points)
    u, toward = strained(points), noise(points, seed=3)
    slope = difference(lambda amount: op(u + amount[0] * toward), np.zeros(1), 1e-2)[0]
    assert np.abs(op.jvp(u, toward) - slope).max() <= DIFFERENCES * np.abs(slope).max()
    inner = np.where(points.interior[:, None], [toward, noise(points, seed=4)], 0.0)
    one, other = (float((op.jvp(u, a) * b[points.interior]).sum()) for a, b in (inner, inner[::-1]))
    assert abs(one - other) <= 1e-12 * abs(one) if form == "energy" else abs(one / other - 1) > 1e-6


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
