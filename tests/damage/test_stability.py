"""Positive kernels stay stable whatever breaks; kernels that change sign are refused."""

import numpy as np
import pytest

from tests.support.bodies import plate, random_breaking, solid
from tests.support.problems import kernel
from warp_peri import InputError, Model
from warp_peri.damage.lattice_body import cracked
from warp_peri.damage.operator import bond_weights, cut_matrix, stiffness_across, stretch_matrix
from warp_peri.damage.solid import (
    breaking_time_step,
    check_breakable,
    check_cut,
    energy_bounds,
    largest_stiffness,
    negative_eigenvalues,
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
        w = bond_weights(model, body.classes)
        eigenvalues = np.linalg.eigvalsh(cut_matrix(body, w, neighbour, mu, lam - mu).toarray())
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
    bound, w = largest_stiffness(model, body.classes), bond_weights(model, body.classes)
    for share in (0.0, 0.5):
        L = cut_matrix(body, w, random_breaking(body, random, share), 1.0, lam - 1.0)
        assert 0 < np.linalg.eigvalsh(L.toarray())[-1] <= bound


def test_a_sign_changing_model_refuses_to_break_with_the_figure():
    model, classes = kernel("sign-changing", 4.0), bond_classes(1.0, 4.0)
    assert (bond_weights(model, classes) < 0).any()
    plus, minus = stiffness_across(model, classes)
    with pytest.raises(InputError, match="changes sign") as refusal:
        check_breakable(model, classes)
    assert f"{plus:.4g} s²" in str(refusal.value)
    assert f"{minus:.4g} s²" in str(refusal.value)


def test_cuts_of_a_sign_changing_model_are_counted_by_inertia():
    # strong repulsion of far bonds: definite while whole, not with its near bonds cut
    model, body = Model(0.3, 0.8, 1.0, [1.0, 1.0, 1.0, -0.9], 3.0), plate(10, 10)
    w = bond_weights(model, body.classes)
    inner = np.repeat((np.abs(body.x) < 3).all(axis=1), 2)
    counts = []
    for neighbour in (body.neighbour, cracked(body, [[(-2.5, 0), (2.5, 0)]])):
        matrix = cut_matrix(body, w, neighbour, model.mu, model.lam - model.mu)[inner][:, inner]
        count = negative_eigenvalues(matrix)
        assert count == (np.linalg.eigvalsh(matrix.toarray()) < 0).sum()
        counts.append(count)
    assert counts[0] == 0
    if counts[1]:
        with pytest.raises(InputError, match=f"{counts[1]} negative eigenvalues"):
            check_cut(matrix)


def test_the_step_is_that_of_the_bound():
    model, classes = solid(3.0).model, bond_classes(1.0, 3.0)
    bound = largest_stiffness(model, classes)
    assert breaking_time_step(model, classes, 4.0) == pytest.approx(2 * np.sqrt(4.0 / bound))
