"""Families on a lattice and on any points: bonds, classes, weights, what a body must offer."""

from dataclasses import replace
from itertools import product
from re import search

import numpy as np
from numpy.linalg import eigvalsh, norm, svd
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from tests.support import approx, filterwarnings, near, parametrize, problems, reference
from tests.support.clouds import cloud, periodic_cloud, plain
from tests.support.problems import ell, kernel, lattice, manufactured, normal, periodic, rotation
from tests.support.solving import solve
from tests.support.told import each_refused, refused, warned
from warp_peri import LPS, Bernstein, Points, fit
from warp_peri.certificates import check_solvability
from warp_peri.points import families
from warp_peri.points.families import bond_classes, families_of, largest_strain, quadrature_weights
from warp_peri.points.points import axis_of, grid_places


@parametrize(("horizon", "angle", "box"), [(2.0, 0.0, None), (3.0, 0.4, None), (3.0, 0.0, (9, 7))])
def test_families_are_those_of_brute_force(horizon, angle, box):
    if box:
        points, box = periodic(box, spacing=1.7)
    else:
        points = lattice(ell(), 1.7 * horizon, spacing=1.7, angle=angle, origin=(3.0, -80.0))
        points = problems.renumbered(points, np.s_[::-1])
    families = families_of(points, 1.7 * horizon)
    needed = {*np.flatnonzero(points.interior)}
    for i in range(len(points.x)):
        ends, xi = reference.family(points.x, i, 1.7 * horizon, box and np.array(box))
        family = families.neighbour[families.row[i] : families.row[i + 1]]
        there = family >= 0
        order = np.argsort(family[there])
        assert_array_equal(family[there][order], np.sort(ends))
        assert_allclose(families.pattern[there][order], xi[np.argsort(ends)], atol=1e-9)
        back = families.neighbour[families.row[family[there]] + families.reverse[there]]
        assert (back == i).all()
        needed |= {*ends} if points.interior[i] else set()
    assert_array_equal(families.whole, sorted(needed))
    assert_array_equal(families.rows, np.flatnonzero(points.interior))


def test_classes_are_orbits_of_the_lattices_symmetry_in_a_closed_ball():
    """Bonds of equal length and different orbit have their own weights: (5, 0) and (4, 3)."""
    for dimension, horizon, bonds, lengths in ((2, 3, 28, 6), (2, 5, 80, 14), (3, 3.0, 122, 9)):
        classes = bond_classes(2.0, 2.0 * horizon, dimension=dimension)
        assert (len(classes.steps), len(classes.r), classes.count.sum()) == (bonds, lengths, bonds)
        orbit, r = np.sort(np.abs(classes.steps), axis=1), norm(classes.xi, axis=1)
        assert len(np.unique(orbit, axis=0)) == lengths
        assert len(np.unique(np.c_[orbit, classes.bond_class], axis=0)) == lengths
        assert_allclose(r, classes.r[classes.bond_class])
        each, own = quadrature_weights(classes.xi, classes.horizon), classes.weight
        near(own[classes.bond_class], each, 1e-9)
        equal = np.flatnonzero(np.isclose(classes.r, 10.0))
        assert len(equal) < 2 or abs(np.diff(own[equal])) > 1e-3
    assert len(bond_classes(0.1, 0.3).steps) == 28  # 3 · 0.1 > 0.3 in floating point
    assert len(bond_classes(1.0, 3.0 * (1 - 1e-5)).steps) < 28


def test_the_error_names_a_horizon_that_fits_or_counts_the_nodes_without_a_collar():
    """One without a missing node within twice of it, whatever its bonds."""
    h = 2.5
    for interior, collar in ((3, 4.9), (np.hypot(*np.mgrid[-4:5, -4:5]) <= 4, 9.9), (ell(), 7.0)):
        points = lattice(interior, collar * 1.25, spacing=h)
        with refused("out to twice the horizon") as caught:
            families_of(points, 8 * h)
        said = search(r"of (\d+) have not at horizon 20 Å; ([\d.]+) Å fits", str(caught.value))
        assert int(said[1]) == points.interior.sum()
        assert float(said[2]) > 0.45 * h * np.ceil(collar)
        families_of(points, float(said[2]))
    points = lattice(5, 2.0)
    corner, side = (np.abs(points.x - at).sum(1) > 0.5 for at in ((-4, -4), (-4, 0)))
    families_of(Points(points.x[corner], points.interior[corner], 1.0), 2.0)  # no family's member
    with refused(r"1 of 25 .* 2 Å; no horizon of two spacings or more fits.* Free edges and holes"):
        families_of(Points(points.x[side], points.interior[side], 1.0), 2.0)


def test_neighbours_are_all_that_are_near_and_bonds_know_their_way_back():
    uniform = default_rng(3).uniform
    for x, horizon, box in (
        (np.r_[0.01 * normal((99, 2)), uniform(0, 6, (300, 2))], 1.5, None),
        (1e5 + uniform(0, 9, (300, 2)), 1.1, None),
        (uniform(-20, 20, (300, 2)), 1.3, (9.0, 9.0)),
        (uniform(0, 9, (300, 3)), 2.8, (9.0, 9.0, 7.0)),
    ):
        row, neighbour, r, reverse = families.neighbours(x, horizon, box)
        bonds = x[None] - x[:, None]
        bonds -= 0 if box is None else np.round(bonds / box) * box
        length = norm(bonds, axis=2)
        start, end = np.nonzero((length <= horizon) & ~np.eye(len(x), dtype=bool))
        assert_array_equal(np.repeat(np.arange(len(x)), np.diff(row)), start)
        assert_array_equal(neighbour, end)
        assert_allclose(r, length[start, end], rtol=1e-9)
        assert_array_equal(neighbour[reverse], start)
        assert_array_equal(start[reverse], neighbour)


def test_each_scattered_family_has_its_own_weights():
    points = cloud(6, 3.4)
    found = families_of(points, 3.4, degree=3)  # those of degree 5 are in the reference of forces
    for i in found.whole[::5]:
        bonds = slice(*found.row[i : i + 2])
        expected = quadrature_weights(points.x[found.neighbour[bonds]] - points.x[i], 3.4, degree=3)
        assert_allclose(found.weight[bonds], expected, atol=1e-9)


@filterwarnings("ignore:spacing. the model is certified")
def test_solvability_is_told_by_eigenvalues_and_singular_values():
    points, model = cloud(8, 3.0), plain(3.0)
    figures, unknown = check_solvability(model, points), np.repeat(points.interior, 2)
    operator, fields = model.on(points, allow_uncertified=True), np.eye(2 * len(points.x))[unknown]
    A = operator(fields.reshape(-1, *points.x.shape)).reshape(len(fields), -1).T
    assert figures.symmetric_min == approx(eigvalsh((A + A.T) / 2)[0])
    assert figures.singular_min == approx(svd(A)[1][-1])


def test_points_and_horizons_that_fit_no_families_are_refused():
    grid, some, sheet = lattice(3, 2.0), cloud(4, 3.0), periodic((9, 9))[0]
    off = grid.x + np.where(np.arange(len(grid.x)) == 7, 1e-3, 0)[:, None]
    rounded, far = lattice(4, 2.5, spacing=1.2345678), np.array([[400.0, 0.0]])
    each_refused(families_of, {
        "spacing 1.0 Å; off it: 7, by up to 0.001": (replace(grid, x=off), 2.0),
        r"by up to 0\.0.* where 1e-06 Å \(1e-06 sp": (replace(rounded, x=rounded.x.round(2)), 2.5),
        "no two points are that close": (replace(grid, spacing=0.9), 2.0),
        "spread over .* places": (replace(grid, x=np.r_[grid.x[:-1], 1e5 * far]), 2.0),
        "horizon: expected at least one spacing": (grid, 0.99),
        "box: expected whole multiples": (replace(sheet, box=(9.5, 9.0)), 2.0),
        "a lattice along the": (replace(lattice(9, 2.0, angle=0.3), box=(9.0, 9.0)), 2.0),
        f"isolated.*{len(some.x)}": (Points(np.r_[some.x, far], [*some.interior, False], 0.0), 3.0),
        r"no weights are exact for the families of \d+ nodes: \d+, ": (some, 1.6),
        r"16 of 16 have not at horizon 6 Å \(nodes \d+, ": (some, 6.0),
        "box: expected periods above 6": (replace(periodic_cloud(7), box=(5.9, 20.0)), 3.0),
    })  # fmt: skip


def test_nodes_that_stand_twice_are_refused_where_points_are_made():
    for spacing, dimension, scale in product((0.0, 1.0), (2, 3), (1e-9, 1.0, 1e9)):
        x = grid_places((5,) * dimension).astype(float)
        problems.everywhere(scale * x, scale * spacing)  # near is not twice
        more = scale * np.concatenate([x, x[[7, 3]] + 1e-12])
        with refused(f"points: 2 duplicates: 3 and {len(x) + 1}, 7 and"):
            problems.everywhere(more, scale * spacing)


def test_the_strain_of_known_fields():
    points = lattice(3, 2.0, spacing=2.5, angle=0.3)
    turn = rotation(0.3)
    u = points.x @ (turn @ np.diag([0.02, -0.05]) @ turn.T)
    shear = (points.x @ turn)[:, 1:] * 0.04 * turn[:, 0]  # of lines: half of it along diagonals
    far = points.x[:, 0] > points.x[points.interior, 0].max() + 1
    for some, field, strain in (
        (points, u, 0.05), (points, np.stack([0 * u, u]), 0.05), (points, shear, 0.02),
        (points, 0 * u + 3.0, 0.0), (cloud(3, 2.5), cloud(3, 2.5).x * 0.1, 0.1),
        (replace(points, outside=far), np.where(far[:, None], 1e3, u), 0.05),
        (problems.everywhere(np.zeros((1, 2))), np.ones((1, 2)), 0.0),
    ):  # fmt: skip
        assert largest_strain(some, field) == approx(strain)


def test_a_solution_strained_beyond_the_training_data_warns():
    points = manufactured(kernel("1/r", 2.5), lattice(4, 2.5), 2)
    model = fit(points, LPS(2.5, Bernstein(0))).material
    assert model.trained_strain == approx(largest_strain(points, points.u))
    solve(model, points, points.b, points.u)
    with warned("strain: the solution reaches .* %, the training data"):
        solve(model, points, 3 * points.b, 3 * points.u)


def test_a_direction_that_is_not_stated_is_x_and_said_once_for_the_same_positions():
    points = replace(lattice(3, 2.0), axis=None)
    with warned("axis: the model depends on direction"):
        assert axis_of(points) == 0.0
    assert axis_of(points) == 0.0  # no second warning


def lattice_family(horizon, d=2):
    steps = grid_places(d * (13,)) - 6
    r = norm(steps, axis=1)
    return steps[(r > 0) & (r <= horizon)].astype(float)


def scattered_family(bonds, horizon, d=2):
    random = default_rng(1)
    away = random.normal(size=(bonds, d))
    r = horizon * random.uniform(0.02, 1, (bonds, 1)) ** (1 / d)
    return r * away / norm(away, axis=1, keepdims=True)


def test_weights_are_exact_and_of_smallest_norm_and_poor_families_are_refused():
    """Or those on a line."""
    for xi, horizon in (
        *((lattice_family(h, d), h) for h, d in ((2.0, 2), (5.0, 2), (3.0, 3))),
        *((scattered_family(bonds, 1.7, d), 1.7) for bonds, d in ((60, 2), (200, 3))),
    ):
        W, least = quadrature_weights(xi, horizon), reference.quadrature(xi, horizon)
        rows, exact = reference.reproducing(xi / horizon)
        near(rows @ W / horizon ** xi.shape[1], exact, 1e-10 * np.pi, 1)
        near(W, least, 1e-9)
    line = np.delete(np.linspace(-1, 1, 41), 20)[:, None] * [1.0, 0.0]
    for xi in (lattice_family(1.5), scattered_family(9, 1.5), lattice_family(1.75, 3), line):
        with refused(f"exact for a family of {len(xi)} bonds"):
            quadrature_weights(xi, 1.75)
