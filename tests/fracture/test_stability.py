"""Positive kernels stay stable whatever breaks; kernels that change sign are refused."""

import numpy as np
import pytest

from tests.support.bodies import plate, random_breaking, solid
from warp_peri.fracture.bonds import (
    bond_matrix,
    bond_weights,
    bonds_of,
    energy_bounds,
    largest_stiffness,
    stretch_matrix,
)


@pytest.mark.parametrize(("sides", "lam"), [((8, 8), -0.6), ((4, 4, 4), 4.0)])
def test_the_energy_of_a_node_lies_between_its_bounds(lam, sides):
    d, body, random = len(sides), plate(*sides), np.random.default_rng(1)
    model = solid(lam, dimension=d).model
    neighbour = random_breaking(body, random, 0.5)
    stretch, place = stretch_matrix(body, neighbour)
    node, bond = np.divmod(place, neighbour.shape[1])
    w = bond_weights(model, body.classes)[bond]
    for _ in range(20):
        along = stretch @ random.standard_normal(body.x.size)
        squares = np.bincount(node, w * along**2 / body.r[bond] ** 2)
        theta = np.bincount(node, d * w * along)
        energy = (lam - 1) / 2 * theta**2 + d * (d + 2) / 2 * squares
        low, high = energy_bounds(model)
        assert (energy >= low * squares * (1 - 1e-12)).all()
        assert (energy <= high * squares * (1 + 1e-12)).all()


@pytest.mark.parametrize(("sides", "lam"), [((8, 8), 100.0), ((4, 4, 4), -0.6), ((8, 8), 0.3)])
def test_no_body_is_stiffer_than_its_bound(lam, sides):
    body, random = plate(*sides), np.random.default_rng(1)
    model = solid(lam, dimension=len(sides)).model
    bound, bonds = largest_stiffness(model, body.classes), bonds_of(model, body.classes)
    for share in (0.0, 0.5):
        L = bond_matrix(body, random_breaking(body, random, share), bonds)
        assert 0 < np.linalg.eigvalsh(L.toarray())[-1] <= bound
