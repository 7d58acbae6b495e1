"""Forces over unbroken bonds, against the matrix, the continuum and bounds; what cracks cut."""

import numpy as np
import warp as wp
from numpy.linalg import det, eigvalsh
from numpy.random import default_rng
from numpy.testing import assert_array_equal

from tests.support import approx, near, parametrize, sup, warned
from tests.support.bodies import plate, random_breaking, solid
from tests.support.problems import ROUNDING, rotation
from warp_peri.fracture import bonds, continuum_stretch
from warp_peri.fracture.body import cracked, crossing_bonds, lattice_body
from warp_peri.fracture.bonds import CutOperator, bond_matrix, bonds_of, largest_stiffness
from warp_peri.points.families import bond_classes
from warp_peri.runtime import floats, zeros

DILATATIONAL = 0.32260
"""4 ∫ c(z)² dz, c the share of a ball's Σ w r² beyond a plane at height z (theory, C6)."""
fields = lambda u: (zeros(len(u), dtype=wp.types.vector(u.shape[1], wp.float64)), zeros(len(u)))
"""Force and energy to fill."""
CROSSING = 26 / 45
"""(V5), 9 ∫ ((1 − t⁴)/2 − ⅔ t (1 − t³))² dt over the crossing bonds of K = 1/r in a ball."""


def swept(operator, u, neighbour):
    """Force and energy by Warp."""
    force, energy = fields(u)
    operator.sweep(floats(u, operator.vector), operator.links(neighbour), force, energy)
    return force.numpy(), energy.numpy()


@parametrize(("sides", "lam"), [((37, 29), 1.0), ((4, 50, 5), 2.0)])
def test_any_order_and_hole_has_the_bits_of_each_node_alone(sides, lam):
    """Rows of 29 to 50 nodes that share pieces with the next; nodes in any order; sums by hand."""
    random = default_rng(1)
    whole = plate(*sides)
    random.shuffle(x := whole.x[random.random(len(whole.x)) < 0.8])
    body, law = lattice_body(x, 1.0, 3.0), solid(lam, dimension=len(sides))
    neighbour, u = random_breaking(body, random, 0.2), 0.1 * random.standard_normal(x.shape)
    d, no_fail, bonds = len(sides), random.random(len(x)) < 0.1, bonds_of(law.model, body.classes)
    w = bonds.share / d
    there, far = neighbour >= 0, np.where(neighbour >= 0, neighbour, 0)
    e = ((u[far] - u[:, None]) * body.xi).sum(2) * there
    theta = d * e @ w
    pull = 2 * d * (d + 2) * w / body.r**2 * e
    pull += d * (lam - 1) * w * (theta[:, None] + theta[far]) * there
    limits = np.quantile(e[there], 0.9) * np.ones(len(w))
    breaks = there & (e > limits) & ~no_fail[:, None] & ~no_fail[far]
    operator = CutOperator(law.model, body, limits=limits, no_fail=no_fail)
    force, energy = fields(u)
    given, links = floats(u, operator.vector), operator.links(neighbour)
    lost = operator.sweep(given, links, force, energy, breaking=True)
    assert_array_equal(operator.kept(links), there & ~breaks)
    assert_array_equal(lost, np.flatnonzero(breaks.any(1)))
    want, L = np.einsum("nb,bi->ni", pull, body.xi), bond_matrix(body, neighbour, bonds)
    for one in (want, -(L @ u.ravel()).reshape(u.shape)):
        near(force.numpy(), one, ROUNDING, sup(want))
    assert energy.numpy().sum() == approx(u.ravel() @ L @ u.ravel() / 2)
    assert abs(L - L.T).max() < ROUNDING * abs(L).max()
    operator.again(links, lost, force, energy)
    again = swept(operator, u, np.where(operator.kept(links), neighbour, -1))
    assert_array_equal(force.numpy(), again[0])
    assert_array_equal(energy.numpy(), again[1])
    order = np.lexsort(x.T)
    tidy, number = lattice_body(x[order], 1.0, 3.0), np.argsort(order)
    moved = np.where(operator.kept(links), number[far], -1)[order]
    sorted_force, _ = swept(CutOperator(law.model, tidy), u[order], moved)
    assert_array_equal(sorted_force, again[0][order])


@parametrize(
    ("dimension", "lam", "limit", "ratios", "share"),
    [
        (2, 1.0, 6 / np.pi, (4.0, 8.0, 16.0), 0.5),
        (2, 3.0, 6 / np.pi + 2 * DILATATIONAL, (4.0, 8.0, 16.0), 0.5),
        (3, 3.0, 3 + 2 * CROSSING, (2.5, 5.0, 10.0), 0.6),
    ],
)
def test_the_lattices_toughness_has_the_limit_of_the_theory(dimension, lam, limit, ratios, share):
    errors = []
    for ratio in ratios:
        model = solid(lam, horizon=ratio, dimension=dimension).model
        classes = bond_classes(1.0, ratio, dimension=dimension)
        errors.append(abs(bonds.unit_toughness(model, classes) / ratio / limit - 1))
    assert errors[2] < 0.05
    assert errors[2] < share * errors[0]
    if lam == 1:  # no dilatation: the formula of the continuum
        assert continuum_stretch(model, 16 * limit) == approx(1.0)


@parametrize(("sides", "lam"), [((8, 8), 100.0), ((4, 4, 4), -0.6), ((8, 8), 0.3)])
def test_no_body_is_stiffer_than_its_bound(lam, sides):
    body, random = plate(*sides), default_rng(1)
    model = solid(lam, dimension=len(sides)).model
    bound, bonds = largest_stiffness(model, body.classes), bonds_of(model, body.classes)
    for share in (0.0, 0.5):
        L = bond_matrix(body, random_breaking(body, random, share), bonds)
        assert 0 < eigvalsh(L.toarray())[-1] <= bound


def test_a_straight_crack_cuts_what_crosses_it_and_one_through_nodes_is_moved_with_a_word():
    body = plate()
    node, bond = np.nonzero(body.neighbour >= 0)
    (x, y), (u, v) = body.x[node].T, body.x[body.neighbour[node, bond]].T
    with np.errstate(all="ignore"):  # of bonds along it
        place = x + (u - x) * y / (y - v)
    across = (y * v < 0) & (-4 < place) & (place < 3)
    assert_array_equal(crossing_bonds(body, [(-4, 0), (3, 0)])[node, bond], across)
    with warned("5 nodes lie on it; it is moved"):
        cut = crossing_bonds(body, [(-2, 0.5), (3, 0.5)])
    assert_array_equal(cut, crossing_bonds(body, [(-2, 0.499), (3, 0.499)]))


def test_a_polygon_cuts_what_crosses_it():
    """A triangle, through each bond by the signs of its volumes with the triangle's edges."""
    body = plate(5, 4, 6, horizon=2.0)
    corners = [(-1.6, 0, -2.3), (1.7, 0, -2.1), (0.2, 0, 2.2)] @ rotation(0.4, 3).T
    a, b, c = corners
    side = lambda p, q, r, s: np.sign(det(np.stack([q - p, r - p, s - p])))
    cut = crossing_bonds(body, corners)
    for node, bond in np.argwhere(body.neighbour >= 0):
        start, end = body.x[node], body.x[body.neighbour[node, bond]]
        apart = side(start, a, b, c) * side(end, a, b, c) < 0
        turns = {side(start, end, p, q) for p, q in ((a, b), (b, c), (c, a))}
        assert cut[node, bond] == (apart and turns in ({1.0}, {-1.0}))


@parametrize("angle", [0.3, 2.6])
def test_cuts_are_symmetric_and_corners_leak_nothing(angle):
    body = plate()
    turn = rotation(angle).T
    square = 2.37 * np.array([(1, 1), (-1, 1), (-1, -1), (1, -1), (1, 1)]) @ turn
    neighbour = cracked(body, [square])
    node, bond = np.nonzero((neighbour < 0) & (body.neighbour >= 0))
    assert (neighbour[body.neighbour[node, bond], body.opposite[bond]] < 0).all()
    inside = (np.abs(body.x @ turn.T) < 2.37).all(1)
    node, bond = np.nonzero(neighbour >= 0)
    assert (inside[node] == inside[neighbour[node, bond]]).all()
