"""Positive kernels stay stable whatever breaks; kernels that change sign are refused."""

import numpy as np
import pytest

from tests.support.bodies import plate, random_breaking, solid
from tests.support.problems import kernel
from warp_peri import InputError, Model
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

STATES = 1000


@pytest.mark.parametrize(
    ("sides", "states"),
    [pytest.param((6, 6), STATES, marks=pytest.mark.slow), ((3, 4, 3), STATES // 5)],
)
@pytest.mark.slow
def test_random_states_have_no_negative_eigenvalue(sides, states):
    d, random = len(sides), np.random.default_rng(0)
    body = plate(*sides, horizon=2.5)
    lowest, highest = [], []
    for _ in range(states):
        mu = 10 ** random.uniform(-1, 1)
        lam = random.choice([-1.98 / d * mu, random.uniform(-2 / d, 5) * mu, 1000 * mu])
        alpha = random.uniform(-1, 2.9)
        model = Model(lam=lam, mu=mu, alpha=alpha, D=random.random(4), horizon=2.5, dimension=d)
        check_breakable(model, body.classes)
        neighbour = random_breaking(body, random, random.random())
        L = bond_matrix(body, neighbour, bonds_of(model, body.classes))
        eigenvalues = np.linalg.eigvalsh(L.toarray())
        bound = largest_stiffness(model, body.classes) if len(highest) < 50 else np.inf
        highest.append(eigenvalues[-1] / bound)
        lowest.append(eigenvalues[0] / max(eigenvalues[-1], 1e-300))
    assert min(lowest) > -1e-12  # rounding; rigid motions are zeros
    assert 0 < max(highest) <= 1


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
