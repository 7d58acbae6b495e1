"""What every solid that breaks must do, in the plane and in space, bonds broken or not.

Such a solid is placed on a body with free faces by a Cracked, not on points with whole families:
the table of laws asks what these cannot offer, a stress at nodes and a collar.
"""

from dataclasses import replace

import numpy as np
from numpy.random import default_rng

from examples.inclusion import Mixed
from tests.support import in_plane_and_space, near, parametrize, refused, sup
from tests.support.bodies import random_breaking
from tests.support.clouds import plain
from tests.support.problems import OTHER, assert_balanced, everywhere, noise, rotation, slope
from warp_peri import Points, runtime, save, simulate, solve
from warp_peri.fracture import BondLaw, BrittleMaterial, Cracked, SofteningMaterial, box_nodes
from warp_peri.fracture.statics import CutSolid
from warp_peri.points.arguments import factors

SIDES = {2: (9, 8), 3: (6, 5, 6)}
CRACK = {
    2: [[(-1, 0.1), (1.2, 0.6)]],
    3: [[(-1, 0.2, -1), (-1, 0.2, 1), (1, 0.2, 1), (1, 0.2, -1)]],
}
linear = lambda d, lam: plain(2.0, lam, dimension=d)
SOLIDS = {
    "brittle": lambda d: BrittleMaterial(linear(d, 0.3), 2.0, toughness=0.01),
    "brittle, by stretch": lambda d: BrittleMaterial(linear(d, 0.8), 2.0, critical_stretch=0.05),
    "soft": lambda d: SofteningMaterial(linear(d, 0.8), BondLaw(4.0, 0.05, 0.05)),
    "mixed": lambda d: Mixed(
        2.0, lambda x: 2.5 + 0.1 * x[..., 0], lambda x: 1 + 0.1 * x[..., 1], dimension=d
    ),
}
every_solid = parametrize(
    "solid", [make(d) for make in SOLIDS.values() for d in (2, 3)],
    ids=[f"{name}-{d}" for name in SOLIDS for d in (2, 3)],
)  # fmt: skip


def points_of(d, angle=0.0):
    x = box_nodes(SIDES[d], 1.0)
    return Points(x @ rotation(angle, d).T, (np.abs(x) < np.abs(x).max(0) - 0.4).all(1), 1.0)


def torn(solid, share, angle=0.0, *, corrected=False):
    """The solid on a body of which a share of the bonds is broken, and its points."""
    points = points_of(solid.dimension, angle)
    body = Cracked(points).body(solid, "solve")
    how = {"neighbour": random_breaking(body, default_rng(1), share), "corrected": corrected}
    return CutSolid(solid, body, ~points.interior, **how), points


@every_solid
@parametrize(("share", "corrected"), [(0.0, False), (0.2, False), (0.2, True)])
def test_forces_balance_and_are_the_derivative_of_the_energy(solid, share, corrected):
    op, points = torn(solid, share, corrected=corrected)
    x, d = points.x, solid.dimension
    u, scale = noise(points), sup(op.matrix @ noise(points).ravel())
    for rigid in (np.ones(d) + 0 * x, x @ (np.tri(d) - np.tri(d).T)):
        near(op(rigid), 0 * op(rigid), 1e-12, scale * sup(rigid))
        assert abs(op.energy(rigid)) < 1e-11 * scale
    f = (op.matrix @ u.ravel()).reshape(u.shape)
    assert_balanced(f)
    moment = x.T @ f
    near(moment, moment.T, 1e-12, sup(x) * np.abs(f).sum())
    assert op.energy(u) > 0
    v = u[::-1] * points.interior[:, None]
    near(op.jvp(u, v), slope(lambda t: op(u + t * v), 1e-3), 1e-8)
    near((op(u) * v[points.interior]).sum(), slope(lambda t: op.energy(u + t * v), 1e-3), 1e-8)
    if share and not isinstance(solid, Mixed):  # whose moduli are functions of positions
        other, R = torn(solid, share, 0.4, corrected=corrected)[0], rotation(0.4, d)
        near(other(u @ R.T), op(u) @ R.T, 1e-11)


@every_solid
def test_a_solve_finds_the_truth_around_a_crack(solid, tmp_path):
    points = points_of(solid.dimension)
    problem = Cracked(points, u=noise(points), cracks=CRACK[solid.dimension])
    op = solve(solid, problem).operator
    u = 1e-3 * noise(points, 2)[1]
    solution = solve(solid, replace(problem, b=op.on_all(op(u)), u=u))
    near(solution.u, u, 1e-9)
    assert solution.residual < 1e-10
    near(float(solution.energy()), op.energy(u), 1e-9)
    if isinstance(solid, Mixed):
        with refused("expected"):
            save(tmp_path / "m.json", solid)


@in_plane_and_space
@parametrize("name", [name for name in SOLIDS if "brittle" in name])
def test_a_motion_in_other_units_and_on_two_threads_breaks_the_same_bonds(
    name, d, monkeypatch, threads
):
    monkeypatch.setattr(runtime, "SLICE", 16)
    solid, x, found = SOLIDS[name](d), box_nodes(SIDES[d], 1.0), []
    length, _ = factors(solid.units, OTHER)
    uneven = 0.01 * x * (1 + default_rng(2).random(x.shape))  # no bonds alike
    for count, one, scale in ((1, solid, 1.0), (2, solid, 1.0), (1, solid.in_units(OTHER), length)):
        threads(count)
        points = everywhere(scale * x, scale, units=one.units)
        step = 0.3 * one.longest_step(scale)
        run = simulate(one, Cracked(points), step=step, steps=15, v=scale * uneven / step)
        found.append((run.details.damage, run.u / scale, run.time))
    assert 0 < found[0][0].mean() < 0.9
    assert all(np.array_equal(a, b) for a, b in zip(found[0], found[1]))
    near(found[0][0], found[2][0], 0)
    near(found[2][1], found[0][1], 1e-9)
    near(found[2][2], found[0][2], 1e-9)
