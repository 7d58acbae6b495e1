"""Lattice bodies with free surfaces, and what cracks cut."""

import numpy as np
import pytest

from tests.support.bodies import plate
from warp_peri.fracture.body import cracked, crossing_bonds


def test_a_straight_crack_cuts_what_crosses_it():
    body = plate()
    node, bond = np.nonzero(body.neighbour >= 0)
    (x, y), (u, v) = body.x[node].T, body.x[body.neighbour[node, bond]].T
    with np.errstate(all="ignore"):  # of bonds along it
        place = x + (u - x) * y / (y - v)
    across = (y * v < 0) & (-4 < place) & (place < 3)
    np.testing.assert_array_equal(crossing_bonds(body, [(-4, 0), (3, 0)])[node, bond], across)


def test_a_polygon_cuts_what_crosses_it():
    """A triangle, through each bond by the signs of its volumes with the triangle's edges."""
    body = plate(5, 4, 6, horizon=2.0)
    c, s = np.cos(0.4), np.sin(0.4)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    a, b, c = corners = np.array([(-1.6, 0, -2.3), (1.7, 0, -2.1), (0.2, 0, 2.2)]) @ turn.T

    def side(p, q, r, s):
        return np.sign(np.linalg.det(np.stack([q - p, r - p, s - p])))

    cut = crossing_bonds(body, corners)
    for node, bond in np.argwhere(body.neighbour >= 0):
        start, end = body.x[node], body.x[body.neighbour[node, bond]]
        apart = side(start, a, b, c) * side(end, a, b, c) < 0
        turns = {side(start, end, p, q) for p, q in ((a, b), (b, c), (c, a))}
        assert cut[node, bond] == (apart and turns in ({1.0}, {-1.0}))


@pytest.mark.parametrize("angle", [0.3, 2.6])
def test_cuts_are_symmetric_and_corners_leak_nothing(angle):
    body = plate()
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    square = 2.37 * np.array([(1, 1), (-1, 1), (-1, -1), (1, -1), (1, 1)]) @ turn
    neighbour = cracked(body, [square])
    node, bond = np.nonzero((neighbour < 0) & (body.neighbour >= 0))
    assert (neighbour[body.neighbour[node, bond], body.opposite[bond]] < 0).all()
    inside = (np.abs(body.x @ turn.T) < 2.37).all(axis=1)
    node, bond = np.nonzero(neighbour >= 0)
    assert (inside[node] == inside[neighbour[node, bond]]).all()


def test_a_crack_through_nodes_is_moved_with_a_word():
    body = plate()
    with pytest.warns(UserWarning, match="5 nodes lie on it; it is moved"):
        cut = crossing_bonds(body, [(-2, 0.5), (3, 0.5)])
    beside = crossing_bonds(body, [(-2, 0.499), (3, 0.499)])
    assert (cut == beside).all()
