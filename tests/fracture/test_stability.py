"""Positive kernels stay stable whatever breaks; kernels that change sign are refused."""

import numpy as np
import pytest

from tests.support.bodies import plate, random_breaking, solid
from tests.support.problems import kernel
from warp_peri import InputError
from warp_peri.fracture.bonds import (
    bond_matrix,
    bond_weights,
    bonds_of,
    check_breakable,
    energy_bounds,
    largest_stiffness,
    stretch_matrix,
)
from warp_peri.points.families import bond_classes


@pytest.mark.parametrize("sides", [(8, 8), (4, 4, 4)])
@pytest.mark.parametrize("lam", [-0.6, 0.3, 4.0])
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


@pytest.mark.parametrize("sides", [(8, 8), (4, 4, 4)])
@pytest.mark.parametrize("lam", [-0.6, 0.3, 100.0])
def test_no_body_is_stiffer_than_its_bound(lam, sides):
    body, random = plate(*sides), np.random.default_rng(1)
    model = solid(lam, dimension=len(sides)).model
    bound, bonds = largest_stiffness(model, body.classes), bonds_of(model, body.classes)
    for share in (0.0, 0.5):
        L = bond_matrix(body, random_breaking(body, random, share), bonds)
        assert 0 < np.linalg.eigvalsh(L.toarray())[-1] <= bound


def test_a_sign_changing_model_refuses_to_break_with_the_figure():
    model, classes = kernel("sign-changing", 4.0), bond_classes(1.0, 4.0)
    w = bond_weights(model, classes).min()
    assert w < 0
    with pytest.raises(InputError, match=f"changes sign .* from {w:.4g} to"):
        check_breakable(model, classes)


def test_the_step_is_that_of_the_bound():
    brittle = solid(3.0, density=4.0)
    bound = largest_stiffness(brittle.model, bond_classes(1.0, 3.0))
    assert brittle.longest_step(1.0) == pytest.approx(2 * np.sqrt(4.0 / bound))
