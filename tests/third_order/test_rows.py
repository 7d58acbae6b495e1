"""A third-order crystal on every layout of nodes, against plain sums over bonds."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.nonlinear import far_ends, solid, tangent
from tests.support.problems import ROUNDING, lattice, noise, periodic
from warp_peri.core import pointwise
from warp_peri.materials.third_order import PlacedThirdOrder
from warp_peri.points.families import bond_classes

HORIZON = 3.0


def shuffled():
    """In no order at all, so that no two nodes follow one another."""
    points = lattice(3, HORIZON)
    order = np.random.default_rng(5).permutation(len(points.x))
    return replace(points, x=points.x[order], interior=points.interior[order])


def apart():
    """Two squares in opposite corners of a rectangle that is mostly empty."""
    blocks = np.zeros((60, 60), bool)
    blocks[:2, :2] = blocks[-2:, -2:] = True
    return lattice(blocks, HORIZON)


def partly_periodic():
    """Periodic, with an interior of nine columns."""
    return replace(periodic((20, 30))[0], interior=np.arange(600) % 30 < 9)


LAYOUTS = {"shuffled": shuffled, "mostly empty": apart, "partly periodic": partly_periodic}


@pytest.mark.parametrize("kind", LAYOUTS)
def test_force_and_derivatives(kind):
    """∂/∂u by the sparse tangent of sums over bonds."""
    points, model = LAYOUTS[kind](), solid("filtered")
    op = PlacedThirdOrder(model, points)
    u = 0.05 * noise(points)
    classes = bond_classes(model.spacing, model.reach)
    p_in, p_out = (2 * p[classes.bond_class] for p in model.weights(classes))
    xi, ends = far_ends(classes.steps, points, op.full)
    H = np.einsum("ipk,pl,p->ikl", u[ends] - u[op.full][:, None], xi, p_in)
    found, P = op.gradients(u)
    assert np.abs(found - H).max() <= ROUNDING * np.abs(H).max()
    stress = np.zeros((len(points.x), 2, 2))
    stress[op.full] = P
    ends = far_ends(classes.steps, points, points.interior)[1]
    force = op.straight(u) - np.einsum("ipkl,pl,p->ik", stress[ends], xi, p_out)
    assert np.abs(op(u) - force).max() <= 4 * ROUNDING * np.abs(force).max()
    if kind != "shuffled":
        return
    v, w = noise(points, seed=2), noise(points, seed=3)[points.interior]
    square = tangent(op, u)
    for rate, expected in (
        (op.jvp(u, v), square @ v.ravel()),
        (op.vjp(u, w), square.T @ w.ravel()),
    ):
        assert np.abs(rate.ravel() - expected).max() <= 1e-12 * np.abs(expected).max()


def test_samples_one_after_another(monkeypatch):
    points = lattice(4, HORIZON)
    op, u = PlacedThirdOrder(solid("energy"), points), 0.05 * noise(points, 5)
    w = noise(points, 5, seed=1)[:, points.interior]

    def found():
        slopes = op.by_numbers("t3", u, w)
        return op(u), op.jvp(u, 2 * u), op.vjp(u, w), op.energy(u), slopes

    first = found()
    monkeypatch.setattr(pointwise, "MOST", 1)
    for one, other in zip(first, found()):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-13 * np.abs(one).max())
