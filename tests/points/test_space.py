"""Families and quadrature in three dimensions."""

from itertools import permutations, product
from math import gamma

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.cubes import cube, periodic_cloud, periodic_cube
from warp_peri.errors import InputError
from warp_peri.points.dataset import Dataset, load_dataset, save_dataset
from warp_peri.points.families import bond_classes, families_of
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.points import Points
from warp_peri.points.samples import Samples
from warp_peri.points.scattered import neighbours


def moment(powers):
    """∫ of a monomial over r³ over the unit ball, by Γ functions (Folland)."""
    if any(n % 2 for n in powers):
        return 0.0
    halves = [(n + 1) / 2 for n in powers]
    sphere = 2 * np.prod([gamma(half) for half in halves]) / gamma(sum(halves))
    return sphere / sum(powers)


PERMUTED, SIGNS = list(permutations(range(3))), list(product((1, -1), repeat=3))
POWERS = [powers for powers in product(range(6), repeat=3) if 1 <= sum(powers) <= 5]


def largest_error(xi, weight, horizon):
    """Of all conditions, relative to the largest integral, that of |ξ|."""
    xi = xi / horizon
    r = np.linalg.norm(xi, axis=1)
    sums = [(weight / horizon**3) @ ((xi**p).prod(axis=1) / r**3) - moment(p) for p in POWERS]
    return np.abs(sums).max() / moment((2, 0, 0))


@pytest.mark.parametrize(("ratio", "bonds", "orbits"), [(2.0, 32, 4), (2.5, 80, 6), (3.0, 122, 9)])
def test_lattice_weights_are_exact_and_share_the_symmetry_of_the_cube(ratio, bonds, orbits):
    classes = bond_classes(0.5, 0.5 * ratio, dimension=3)
    assert (len(classes.steps), len(classes.r)) == (bonds, orbits)
    weight = classes.weight[classes.bond_class]
    assert largest_error(classes.xi, weight, classes.horizon) < 1e-12
    np.testing.assert_allclose(np.linalg.norm(classes.xi, axis=1), classes.r[classes.bond_class])
    for n in range(orbits):
        orbit = np.sort(np.abs(classes.steps[classes.bond_class == n]), axis=1)
        assert (orbit == orbit[0]).all()


def test_a_horizon_of_fewer_bonds_than_weights_need_is_refused():
    with pytest.raises(InputError, match="no weights are exact for a family of 26 bonds"):
        bond_classes(1.0, 1.75, dimension=3)


def test_scattered_families_are_those_of_all_pairs_and_their_weights_exact():
    points = periodic_cloud(7)
    families = families_of(points, 2.8)
    step = points.x[None] - points.x[:, None]
    step -= 7 * np.rint(step / 7)
    r = np.linalg.norm(step, axis=2)
    near = (r <= 2.8) & ~np.eye(len(r), dtype=bool)
    owner = np.repeat(np.arange(len(r)), np.diff(families.row))
    assert set(zip(owner, families.neighbour)) == set(zip(*np.nonzero(near)))
    assert (families.neighbour[families.reverse] == owner).all()
    for i in (0, 100):
        e = slice(families.row[i], families.row[i + 1])
        xi = step[i, families.neighbour[e]]
        assert largest_error(xi, families.weight[e], 2.8) < 1e-9


def test_cells_hold_every_pair_of_open_points_too():
    x = np.random.default_rng(2).uniform(0, 9, (500, 3))
    row, neighbour, distance = neighbours(x, 1.7)
    r = np.linalg.norm(x[None] - x[:, None], axis=2)
    owner = np.repeat(np.arange(len(x)), np.diff(row))
    assert len(owner) == np.count_nonzero(r <= 1.7) - len(x)
    np.testing.assert_allclose(distance, r[owner, neighbour], rtol=1e-14)


def test_the_families_of_a_lattice_know_their_collar():
    points = cube(2, 2.0)
    families = families_of(points, 2.0)
    steps = families.classes.steps
    i = families.rows[0]
    ends = families.neighbour[families.row[i] : families.row[i + 1]]
    assert (points.x[ends] - points.x[i] == steps).all()
    with pytest.raises(InputError, match="complete families out to twice the horizon.*fits is 2"):
        families_of(points, 3.0)
    periodic = families_of(periodic_cube((5, 6, 7)), 2.0)
    assert (periodic.neighbour >= 0).all()


def test_a_turned_cube_has_the_families_of_the_straight_one():
    points = cube(2, 2.0)
    turn = Rotation.from_euler("xyz", [25, -40, 65], degrees=True).as_matrix()
    turned = Points(points.x @ turn.T + [7.0, 3.0, 1.0], points.interior, 1.0)
    _, axes = lattice_steps(turned)
    best = min(np.abs(axes - turn[:, list(p)] * s).max() for p in PERMUTED for s in SIGNS)
    assert best < 1e-12
    here, there = families_of(points, 2.0), families_of(turned, 2.0)
    assert here.weight == pytest.approx(there.weight, rel=1e-14)
    ends = there.neighbour[there.row[there.rows[0]] : there.row[there.rows[0] + 1]]
    np.testing.assert_allclose(turned.x[ends] - turned.x[there.rows[0]], there.pattern, atol=1e-12)
    with pytest.raises(InputError, match="expected a cubic lattice of spacing 1.0 Å; off it: "):
        families_of(Points(turned.x + 1e-3 * np.eye(len(turned.x), 3), turned.interior, 1.0), 2.0)


def test_data_files_keep_three_dimensions(tmp_path):
    points = periodic_cube((5, 6, 7))
    random = np.random.default_rng(0)
    samples = Samples(points, random.normal(size=(2, 210, 3)), random.normal(size=(2, 210, 3)))
    save_dataset(tmp_path / "s.h5", Dataset({"train": samples}, 1.0, 1000.0))
    again = load_dataset(tmp_path / "s.h5")["train"]
    assert again.box == points.box
    for name in ("x", "u", "b"):
        assert (getattr(again, name) == getattr(samples, name)).all()
