"""The force of a third-order crystal, against plain sums over bonds, and its projection."""

import numpy as np
from numpy.linalg import norm
from numpy.random import default_rng

from tests.crystal.crystals import far_end
from tests.support import approx, near, parametrize, problems, sup
from tests.support.nonlinear import psi, solid
from tests.support.problems import ROUNDING, difference, lattice, noise, on_interior, smooth
from warp_peri.core import torch_bridge
from warp_peri.materials.third_order import PlacedThirdOrder
from warp_peri.points.families import bond_classes

HORIZON = 3.0


def apart():
    """Two squares in opposite corners of a rectangle that is mostly empty, in no order at all."""
    blocks = np.zeros((60, 60), bool)
    blocks[:2, :2] = blocks[-2:, -2:] = True
    points = lattice(blocks, HORIZON)
    return problems.renumbered(points, default_rng(5).permutation(len(points.x)))


@parametrize("points", [apart, problems.partly_periodic])
def test_force_is_that_of_sums_over_bonds(points):
    points, model = points(), solid("filtered")
    op, u = PlacedThirdOrder(model, points), 0.05 * noise(points)
    classes = bond_classes(model.spacing, model.reach)
    p_in, p_out = (2 * p[classes.bond_class] for p in model.weights(classes))
    xi = classes.xi @ points.lattice.axes.T
    ends = np.stack([far_end(points, bond)[1] for bond in xi], axis=1)
    H = np.einsum("ipk,pl,p->ikl", u[ends[op.full]] - u[op.full][:, None], xi, p_in)
    found, P = op.gradients(u)
    near(found, H, ROUNDING)
    stress = np.zeros((len(points.x), 2, 2))
    stress[op.full] = P
    force = np.einsum("ipkl,pl,p->ik", stress[ends[points.interior]], xi, p_out)
    near(op(u), op.straight(u) - force, 4 * ROUNDING)


def test_samples_that_follow_one_another_change_nothing(monkeypatch):
    points = lattice(4, HORIZON)
    op, u = PlacedThirdOrder(solid("energy"), points), 0.05 * noise(points, 5)
    w = noise(points, 5, seed=1)[:, points.interior]

    def found():
        return op(u), op.jvp(u, 2 * u), op.vjp(u, w), op.energy(u), op.by_numbers("t3", u, w)

    first = found()
    monkeypatch.setattr(torch_bridge, "MOST", 1)
    for one, other in zip(first, found()):
        near(other, one, 1e-13)


def test_clipping_projects_the_gradient():
    points, model = lattice(2, HORIZON), solid("energy")
    u = smooth(points.x, 1, wave_number=0.3)[0] * 0.2
    op = PlacedThirdOrder(model, points)
    size = norm(op.gradients(u)[0], axis=(-2, -1))
    assert size.min() < 0.05 < size.max()
    assert op.largest_gradient(u) == approx(size.max())
    uniform, rough = points.x @ np.array([[0.05, 0.03], [-0.02, -0.06]]).T, 0.01 * noise(points)
    for field in (uniform, 4 * uniform):  # the stress is uniform beyond the ball too
        assert sup(op.force(field, radius=0.05)) <= 1e-12
    near(op.force(rough, radius=9.0), op(rough), 0)
    H, P = op.gradients(u)
    within = H * np.minimum(1, 0.05 / size)[:, None, None]
    energy = lambda entries: psi(within + entries.reshape(2, 2), model)
    gap = difference(energy, np.zeros(4), 1e-4).T.reshape(-1, 2, 2) - P
    moved = op.force(u, radius=0.05) - op(u)
    v = on_interior(points, noise(points, seed=3))
    work = (gap * op.gradients(v)[0]).sum()  # the weights of both sides are the same
    near((moved * v[points.interior]).sum(), work, 1e-5)
    assert sup(moved) > 1e-4 * sup(op(u))
