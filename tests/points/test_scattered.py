"""Families and weights of any points, and the operator on them."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tests.support import reference
from tests.support.clouds import cloud, periodic_cloud, plain
from tests.support.problems import KERNELS, QUADRATURE, ROUNDING, kernel, lattice, noise
from tests.support.solving import solve
from warp_peri import InputError, Points
from warp_peri.materials.lps_matrices import matrices
from warp_peri.points.families import HORIZON_TOLERANCE, families_of
from warp_peri.points.quadrature import quadrature_weights
from warp_peri.points.scattered import neighbours, reverse_bonds
from warp_peri.proofs import solvability

RANDOM = np.random.default_rng(3)
CLOUDS = {
    "random": (RANDOM.uniform(0, 9, (400, 2)), 1.3, None),
    "lattice": (np.argwhere(np.ones((14, 9))) - 5.0, 3.0, None),
    "clustered": (RANDOM.normal(size=(450, 2)) * np.repeat([[0.02], [1], [7]], 150, 0), 0.9, None),
    "far from the origin": (1e5 + RANDOM.uniform(0, 9, (300, 2)), 1.1, None),
    "on a line": (np.stack([np.arange(40.0), np.zeros(40)], axis=1), 2.5, None),
    "sparse": (RANDOM.uniform(0, 900, (50, 2)), 60.0, None),
    "periodic": (RANDOM.uniform(0, 9, (400, 2)), 1.3, (9.0, 9.0)),
    "periodic, two cells": (RANDOM.uniform(0, 9, (60, 2)), 4.4, (9.0, 13.0)),
    "periodic lattice": (np.argwhere(np.ones((9, 7))) * 1.0, 3.0, (9.0, 7.0)),
    "outside the box": (RANDOM.uniform(-20, 20, (300, 2)), 1.3, (9.0, 9.0)),
}  # fmt: skip


@pytest.mark.parametrize(("x", "horizon", "box"), CLOUDS.values(), ids=CLOUDS)
def test_neighbours_are_those_of_a_tree(x, horizon, box):
    reach = horizon * (1 + HORIZON_TOLERANCE)
    row, neighbour, r = neighbours(x, reach, box)
    tree = cKDTree(x if box is None else x % box, boxsize=box)
    pairs = tree.query_pairs(reach, output_type="ndarray")
    expected = np.concatenate([pairs, pairs[:, ::-1]])
    start = np.repeat(np.arange(len(x)), np.diff(row))
    pairs_found = np.stack([start, neighbour], axis=1)
    assert np.array_equal(np.unique(pairs_found, axis=0), np.unique(expected, axis=0))
    assert len(pairs_found) == len(expected)
    bonds = x[neighbour] - x[start]
    if box is not None:
        bonds -= np.round(bonds / box) * box
    np.testing.assert_allclose(r, np.hypot(*bonds.T), rtol=1e-9)
    reverse = reverse_bonds(row, neighbour)
    assert np.array_equal(neighbour[reverse], start)
    assert np.array_equal(reverse[reverse], np.arange(len(reverse)))
    assert np.array_equal(r[reverse], r)


@pytest.mark.parametrize("degree", [3, 5, 6])
def test_weights_are_exact_and_of_smallest_norm(degree):
    horizon = 3.4
    points = cloud(6, horizon)
    families = families_of(points, horizon, degree=degree)
    for i in families.whole:
        some = slice(families.row[i], families.row[i + 1])
        xi = points.x[families.neighbour[some]] - points.x[i]
        W = families.weight[some]
        r = np.hypot(*xi.T)
        for a, b in reference.monomials(degree):
            integral = W @ (xi[:, 0] ** a * xi[:, 1] ** b / r**3) / horizon ** (a + b - 1)
            assert integral == pytest.approx(reference.ball_integral(a, b, 1.0), abs=QUADRATURE)
        if degree == 5:
            np.testing.assert_allclose(W, reference.quadrature(xi, horizon), atol=1e-9)
        np.testing.assert_allclose(W, quadrature_weights(xi, horizon, degree=degree), atol=1e-9)


@pytest.mark.parametrize("name", KERNELS)
def test_the_operator_is_the_reference(name):
    points = cloud(4, 3.0)
    model = replace(kernel(name, 3.0), lam=-0.2)
    u = noise(points)
    expected = reference.operator(points.x, points.interior, model, u)
    size = np.abs(expected).max()
    with pytest.warns(UserWarning, match="certified"):
        force = model.on(points, allow_uncertified=True)(u)
    np.testing.assert_allclose(force, expected, rtol=0, atol=1e-10 * size)
    L = matrices(model, points).operator(model.lam, model.mu)
    force = (L @ u.ravel()).reshape(-1, 2)
    np.testing.assert_allclose(force, expected, rtol=0, atol=1e-10 * size)


def test_the_operator_is_the_reference_in_a_periodic_box():
    points, box = periodic_cloud(7)
    model = kernel("sign-changing", 3.0)
    u = noise(points)
    expected = reference.operator(points.x, points.interior, model, u, np.array(box))
    with pytest.warns(UserWarning, match="certified"):
        force = model.on(points, allow_uncertified=True)(u)
    np.testing.assert_allclose(force, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("method", ["lu", "gmres"])
@pytest.mark.filterwarnings("ignore:spacing. the model is certified")
def test_a_solve_gives_the_displacement_back(method):
    points = cloud(8, 3.0)
    u = noise(points, 2)
    model = plain(3.0)
    b = np.zeros_like(u)
    b[:, points.interior] = model.on(points, allow_uncertified=True)(u)
    solved = solve(model, points, b, u, method=method, allow_uncertified=True)
    np.testing.assert_allclose(solved, u, atol=1e-7)


def test_solvability_figures():
    points = cloud(8, 3.0)
    model = plain(3.0)
    figures = solvability(model, points)
    L = matrices(model, points).operator(model.lam, model.mu)
    A = L[:, np.repeat(points.interior, 2)].toarray()
    assert figures.symmetric_min == pytest.approx(np.linalg.eigvalsh((A + A.T) / 2)[0])
    assert figures.singular_min == pytest.approx(np.linalg.svd(A)[1][-1])
    assert figures.asymmetry == pytest.approx(np.linalg.norm(A - A.T) / np.linalg.norm(A + A.T))
    assert 0.02 < figures.asymmetry < 0.5  # scattered points are not symmetric
    ordered = solvability(model, lattice(8, 3.0))
    assert ordered.asymmetry < ROUNDING
    assert ordered.symmetric_min == pytest.approx(ordered.singular_min)


def test_sparse_solvability_is_the_dense_one(monkeypatch):
    points, model = cloud(10, 3.0), plain(3.0)
    dense = solvability(model, points)
    monkeypatch.setattr(sys.modules["warp_peri.solvers.direct"], "DENSE", 10)
    sparse = solvability(model, points)
    assert sparse.symmetric_min == pytest.approx(dense.symmetric_min, rel=1e-4)
    assert sparse.singular_min == pytest.approx(dense.singular_min, rel=1e-6)


GOOD = cloud(4, 3.0)


FAR = Points(np.vstack([GOOD.x, [400.0, 0.0]]), np.append(GOOD.interior, False), 0.0)
NUMBER = len(GOOD.x)
BAD = {
    "an isolated point": (FAR, 3.0, f"isolated.*: {NUMBER}"),
    "a horizon below the spacing": (GOOD, 0.1, "horizon: expected at least the spacing"),
    "no horizon": (GOOD, 0.0, "horizon: expected a length > 0"),
    "a horizon that is no number": (GOOD, np.nan, "horizon: expected a length > 0"),
    "poor families": (GOOD, 1.6, r"no weights are exact for the families of \d+ nodes: \d+, "),
    "a horizon beyond the collar": (GOOD, 6.0, r"16 of 16 have not at horizon 6 Å \(nodes \d+, "),
}


@pytest.mark.parametrize(("points", "horizon", "words"), BAD.values(), ids=BAD)
def test_bad_points_are_refused_by_number(points, horizon, words):
    with pytest.raises(InputError, match=words):
        families_of(points, horizon)


def test_points_that_are_no_numbers_are_refused():
    x = GOOD.x.copy()
    x[5, 1] = np.nan
    with pytest.raises(InputError, match=r"x: expected finite values, got nan at index \[5, 1\]"):
        replace(GOOD, x=x)


def test_a_box_that_does_not_fit_is_refused():
    points = replace(periodic_cloud(7)[0], box=(5.9, 20.0))
    with pytest.raises(InputError, match="box: expected two periods above 6"):
        families_of(points, 3.0)


@pytest.mark.parametrize("degree", [1, 2.5, -1])
def test_a_degree_below_two_is_refused(degree):
    with pytest.raises(InputError, match="quadrature degree: expected"):
        families_of(GOOD, 3.0, degree=degree)


def test_a_cloud_needs_no_singular_values(monkeypatch):
    """They take four times as long as all else; what needs them are families near a line."""
    points, families = cloud(12, 3.0, perturbation=0.3), []
    singular = np.linalg.svd

    def counted(rows, **options):
        families.append(len(rows))
        return singular(rows, **options)

    monkeypatch.setattr(np.linalg, "svd", counted)
    families_of(points, 3.0)
    assert sum(families) <= 0.01 * len(points.x)


def bytes_per_bond(families):
    held = (families.row, families.neighbour, families.reverse, families.r, families.weight)
    return sum(array.nbytes for array in (*held, families.pattern)) / len(families.neighbour)


def test_memory_is_within_forty_bytes_a_bond():
    points, _ = periodic_cloud(40)
    families = families_of(points, 3.0)
    working = 8 + 8  # K W, and a dilatation's own K W
    assert bytes_per_bond(families) + working <= 40.5  # the half byte is row, which is by node
    ordered = families_of(replace(lattice(60, 3.0)), 3.0)
    assert bytes_per_bond(ordered) < 4.5


def test_negative_weights_are_counted():
    points = cloud(4, 3.0, perturbation=0.45, seed=1)
    families = families_of(points, 3.0)
    rows = np.repeat(np.arange(len(points.x)), np.diff(families.row))
    inside = families.weight[points.interior[rows]]
    share = solvability(plain(3.0), points).negative_weights
    assert share == np.count_nonzero(inside < 0) / len(inside) > 0
    assert solvability(plain(3.0), lattice(4, 3.0)).negative_weights == 0


@pytest.mark.parametrize("spacing", [0.0, 1.0])
@pytest.mark.parametrize("dimension", [2, 3])
def test_nodes_that_stand_twice_are_refused_where_points_are_made(spacing, dimension):
    x = np.argwhere(np.ones((5,) * dimension)).astype(float)
    for scale in (1e-9, 1.0, 1e9):
        Points(scale * x, np.ones(len(x), bool), scale * spacing)  # near is not twice
        more = scale * np.concatenate([x, x[[7, 3]] + 1e-12])
        with pytest.raises(InputError, match=f"points: 2 duplicates: 3 and {len(x) + 1}, 7 and"):
            Points(more, np.ones(len(more), bool), scale * spacing)
