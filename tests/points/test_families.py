"""Families on a lattice: bonds, classes, and what a point set must offer."""

import re
from dataclasses import replace

import numpy as np
import pytest

from tests.support import reference
from tests.support.problems import ell, lattice, periodic
from warp_peri import InputError, Points
from warp_peri.points.families import bond_classes, families_of

HORIZONS = (2.0, 2.3, 2.5, 3.0)
DISK = np.hypot(*np.mgrid[-4:5, -4:5]) <= 4


def bonds_of(families, i):
    some = slice(families.row[i], families.row[i + 1])
    return families.neighbour[some], families.pattern


@pytest.mark.parametrize("angle", [0.0, 0.4, -1.1])
@pytest.mark.parametrize("horizon", HORIZONS)
def test_families_are_those_of_brute_force(horizon, angle):
    points = lattice(ell(), 1.7 * horizon, spacing=1.7, angle=angle, origin=(3.0, -80.0))
    points = replace(points, x=points.x[::-1], interior=points.interior[::-1])
    families = families_of(points, 1.7 * horizon)
    needed = set(np.flatnonzero(points.interior))
    for i in range(len(points.x)):
        near, xi = reference.family(points.x, i, 1.7 * horizon)
        family, bonds = bonds_of(families, i)
        there = family >= 0
        assert sorted(family[there]) == sorted(near)
        order = np.argsort(family[there])
        np.testing.assert_allclose(bonds[there][order], xi[np.argsort(near)], atol=1e-9)
        back = families.neighbour[families.row[family[there]] + families.reverse[there]]
        assert (back == i).all()
        if points.interior[i]:
            needed |= set(near)
    assert np.array_equal(families.whole, sorted(needed))
    assert np.array_equal(families.rows, np.flatnonzero(points.interior))


@pytest.mark.parametrize("horizon", HORIZONS)
def test_periodic_families_wrap_around(horizon):
    points, box = periodic((9, 7), spacing=0.5)
    families = families_of(points, 0.5 * horizon)
    assert len(families.whole) == len(families.rows) == len(points.x)
    for i in range(len(points.x)):
        near, xi = reference.family(points.x, i, 0.5 * horizon, np.array(box))
        family, bonds = bonds_of(families, i)
        assert sorted(family) == sorted(near)
        np.testing.assert_allclose(bonds[np.argsort(family)], xi[np.argsort(near)], atol=1e-12)


@pytest.mark.parametrize(
    ("horizon", "bonds", "lengths"), [(2.5, 20, 4), (3, 28, 6), (4, 48, 9), (5, 80, 13)]
)
def test_classes_are_symmetry_orbits(horizon, bonds, lengths):
    classes = bond_classes(2.0, 2.0 * horizon)
    assert classes.count.sum() == len(classes.steps) == bonds
    assert len(np.unique(classes.r.round(9))) == lengths
    orbits = {}
    for step, number in zip(classes.steps, classes.bond_class):
        orbits.setdefault(number, set()).add(tuple(sorted(np.abs(step))))
        assert np.hypot(*step) * 2.0 == pytest.approx(classes.r[number], rel=1e-14)
    assert [len(orbit) for orbit in orbits.values()] == [1] * len(classes.r)
    assert len({orbit for (orbit,) in orbits.values()}) == len(classes.r)


def test_bonds_of_equal_length_and_different_orbit_have_their_own_weights():
    classes = bond_classes(1.0, 5.0)
    equal = np.flatnonzero(np.isclose(classes.r, 5.0))
    assert sorted(classes.count[equal]) == [4, 8]
    assert abs(np.diff(classes.weight[equal])) > 1e-3


def test_ball_is_closed():
    assert len(bond_classes(0.1, 0.3).steps) == 28  # 3 · 0.1 > 0.3 in floating point
    assert len(bond_classes(1.0, 3.0 * (1 - 1e-5)).steps) < 28


@pytest.mark.parametrize(
    ("interior", "collar"), [(3, 4.9), (3, 5.9), (7, 8.3), (DISK, 6.4), (DISK, 9.9), (ell(), 7.0)]
)
def test_error_names_the_largest_horizon_that_fits(interior, collar):
    h = 2.5
    points = lattice(interior, collar * h / 2, spacing=h)
    with pytest.raises(InputError, match="out to twice the horizon") as caught:
        families_of(points, 8 * h)
    said = re.search(
        r"(\d+) of (\d+) have not at horizon 20 Å; the largest that fits is ([\d.]+) Å",
        str(caught.value),
    )
    assert int(said[2]) == points.interior.sum()
    largest = float(said[3])
    families_of(points, largest)
    longer = np.unique(h * np.hypot(*np.mgrid[0:12, 0:12]))
    longer = longer[longer > largest * 1.001][0]
    with pytest.raises(InputError, match="the largest that fits"):
        families_of(points, longer)


def test_error_counts_the_nodes_that_lack_the_collar():
    points = lattice(5, 2.0)
    hole = np.argmin(np.abs(points.x - (-4, -4)).sum(1))  # reached by the lower left corner only
    keep = np.arange(len(points.x)) != hole
    whole = Points(points.x[keep], points.interior[keep], 1.0)
    families_of(whole, 2.0)  # a corner of the square is no family member
    hole = np.argmin(np.abs(points.x - (-4, 0)).sum(1))
    keep = np.arange(len(points.x)) != hole
    with pytest.raises(InputError, match=r"1 of 25 have not at horizon 2 Å; no horizon") as told:
        families_of(Points(points.x[keep], points.interior[keep], 1.0), 2.0)
    assert "Free edges and holes: Body(mesh" in str(told.value)


def test_error_says_when_no_horizon_fits():
    points = lattice(3, 1.0)
    with pytest.raises(InputError, match="9 of 9 .* no horizon of two spacings or more fits"):
        families_of(points, 3.0)


def test_no_horizon_of_two_spacings_or_more_lacks_weights():
    for horizon in np.unique(np.hypot(*np.mgrid[0:7, 0:7])):
        if 2 <= horizon <= 6:
            bond_classes(1.0, horizon)


def moved(points, **change):
    return replace(points, **change)


POINTS = lattice(3, 2.0)
SHIFTED = POINTS.x + np.where(np.arange(len(POINTS.x)) == 7, 1e-3, 0)[:, None]
BAD_POINTS = {
    "a node off the lattice": (moved(POINTS, x=SHIFTED), "spacing 1.0 Å; off it: 7"),
    "spacing too small": (moved(POINTS, spacing=0.9), "no two points are that close"),
    "spacing too large": (moved(POINTS, spacing=2.0), "square lattice of spacing 2.0"),
    "a rectangular lattice": (moved(POINTS, x=POINTS.x * (1, 1.001)), "square lattice"),
    "one point": (Points([[0.0, 0.0]], [True], 1.0), "no two points"),
}


@pytest.mark.parametrize(("points", "words"), BAD_POINTS.values(), ids=BAD_POINTS)
def test_bad_points_are_refused(points, words):
    with pytest.raises(InputError, match=words):
        families_of(points, 2.0 * max(points.spacing, 1.0))


@pytest.mark.parametrize("horizon", [0.99, 0.0, -1.0, np.nan, np.inf])
def test_a_horizon_below_one_spacing_is_refused(horizon):
    with pytest.raises(InputError, match="horizon: expected at least one spacing"):
        bond_classes(1.0, horizon)


@pytest.mark.parametrize("spacing", [0.0, -1.0, np.nan, np.inf])
def test_a_spacing_that_is_none_is_refused(spacing):
    with pytest.raises(InputError, match="spacing: expected a lattice spacing > 0"):
        bond_classes(spacing, 3.0)


@pytest.mark.parametrize("box", [(9.5, 9.0), (4.0, 9.0)])
def test_a_box_that_does_not_fit_is_refused(box):
    points = replace(periodic((9, 9))[0], box=box)
    with pytest.raises(InputError, match="box: expected"):
        families_of(points, 2.0)


def test_a_rotated_lattice_is_not_periodic_along_the_axes():
    with pytest.raises(InputError, match="box: expected a lattice along the axes"):
        families_of(replace(lattice(9, 2.0, angle=0.3), box=(9.0, 9.0)), 2.0)
