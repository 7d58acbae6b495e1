"""Where a material is placed: what points state is read, compared or refused, by every material."""

from dataclasses import replace

import numpy as np
import pytest

import warp_peri as wp
from tests.conformance.test_laws import LAWS, TURN, near, placed, rotation, uneven
from tests.support.problems import lattice, noise
from warp_peri.diffusion import DiffusionMaterial, ThermoelasticMaterial
from warp_peri.fracture import Cracked, rectangle_nodes
from warp_peri.neural.material import NeuralOperator

CHANGES = {
    "axis": lambda p: replace(p, axis=(p.axis or 0.0) + 30.0),
    "units": lambda p: replace(p, units=("nm", "GPa")),
    "box": lambda p: replace(p, box=(1e3, 1e3)),
    "outside": lambda p: replace(p, outside=np.arange(len(p.x)) == 0),
    "x": lambda p: replace(p, x=p.x + 1.0),
}


@pytest.mark.parametrize("what", CHANGES)
@pytest.mark.parametrize("name", LAWS)
def test_an_operator_is_for_its_own_points(name, what):
    op, points = placed(LAWS[name])
    other = CHANGES[what](points)
    with pytest.raises(wp.InputError, match=f"operator: expected one on the points.* in {what}"):
        wp.solve(op, wp.Dirichlet(other, None, 0 * points.x))


@pytest.mark.parametrize("name", ["conductor", "coupled"])
def test_conduction_too(name):
    points = lattice(4, 3.0)
    material = DiffusionMaterial(3.0) if name == "conductor" else coupled()
    op = material.on(points)
    field = np.zeros(len(points.x)) if name == "conductor" else np.zeros((len(points.x), 3))
    for what, change in CHANGES.items():
        with pytest.raises(wp.InputError, match=f"in {what}"):
            wp.solve(op, wp.Dirichlet(change(points), None, field))


def coupled():
    return ThermoelasticMaterial(
        wp.LPSMaterial(0.7, 0.8, 1.0, [1.0], 3.0), DiffusionMaterial(3.0), 0.2
    )


@pytest.mark.parametrize("d", [2, 3])
def test_conduction_in_the_plane_and_in_space(d):
    """L |x|² = −2 d κ, whose divergence is that of the continuum."""
    grid = np.argwhere(np.ones(d * (9,))).astype(float)
    interior = ((grid >= 3) & (grid < 6)).all(axis=1)
    points = wp.Points(grid, interior, 1.0)
    square = (grid**2).sum(axis=1)
    op = DiffusionMaterial(2.0, 0.7).on(points)
    np.testing.assert_allclose(op(square), -2 * d * 0.7, rtol=1e-10)
    load = np.full(len(grid), -2 * d * 0.7)
    found = wp.solve(op, wp.Dirichlet(points, load, square)).u
    np.testing.assert_allclose(found, square, atol=1e-10 * square.max())


def test_a_node_outside_pulls_nothing_of_a_coupled_solid():
    points = replace(lattice(5, 3.0), axis=None)
    outside = np.zeros(len(points.x), bool)
    outside[np.argmin(np.linalg.norm(points.x - [-1, 2], axis=1))] = True
    op = coupled().on(replace(points, outside=outside))
    u = np.column_stack([noise(points), noise(points)[:, 0]])
    moved = u.copy()
    moved[outside] += 100.0
    assert np.array_equal(op(moved), op(u))
    with pytest.raises(wp.InputError, match="box: a coupled solid is for a body that does not"):
        coupled().on(wp.Points.sheet((14, 14), 1.0))


def test_directions_of_a_network_turn_with_the_axis():
    material = NeuralOperator(3.0, (6, 8), (10, 12), anisotropic=True, proportional=True).double()
    straight = replace(lattice(4, 3.0), axis=0.0)
    turned = replace(lattice(4, 3.0, angle=TURN), axis=np.rad2deg(TURN))
    u, R = uneven(straight), rotation(TURN)
    force = material.on(straight)(u)
    near(material.on(turned)(u @ R.T), force @ R.T, 1e-11)
    other = material.on(replace(straight, axis=30.0))(u)
    assert np.abs(other - force).max() > 1e-6 * np.abs(force).max()


@pytest.mark.parametrize("name", ["third order, energy", "crystal"])
def test_no_crack_is_solved_by_a_part_of_a_material(name):
    x = rectangle_nodes(14.0, 10.0, 1.0)
    rim = np.abs(x[:, 1]) > 4
    problem = Cracked(wp.Points(x, ~rim, 1.0), u=0 * x, cracks=[[(-3.0, 0.02), (2.2, 0.02)]])
    with pytest.raises(wp.InputError, match=r"Cracked"):
        wp.solve(LAWS[name].material(), problem)
