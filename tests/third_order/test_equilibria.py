"""Equilibrium of nonlinear solids."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from tests.support.nonlinear import FORMS, solid
from tests.support.problems import ell, lattice, smooth
from tests.support.solving import solve, solve_nonlinear
from warp_peri import InputError
from warp_peri.materials.third_order import PlacedThirdOrder
from warp_peri.solvers import conjugate_gradients, equilibria, linear
from warp_peri.solvers.equilibria import NonlinearRecord

HORIZON = 3.0


def problem(model, size, interior=7, seed=0):
    """A smooth field and the load that holds it, on nodes that are no square."""
    points = lattice(ell() if interior == 0 else interior, HORIZON)
    u = size * smooth(points.x, 1, seed, wave_number=0.5)[0]
    b = np.zeros_like(u)
    b[points.interior] = PlacedThirdOrder(model, points)(u)
    return points, u, b


@pytest.mark.parametrize("form", FORMS)
def test_a_known_answer_is_found_within_the_proven_strain(form):
    model = solid(form)
    points, u, b = problem(model, 0.004)
    records: list[NonlinearRecord] = []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solved = solve_nonlinear(model, points, b, u, records=records, eigenvalues=True)
    assert np.abs(solved - u).max() <= 1e-7 * np.abs(u).max()
    (record,) = records
    assert record.unique
    assert record.largest_gradient <= model.proven_strain(1.0)
    assert record.solves <= 10
    assert record.eigenvalue > 0
    linear = solve(model.linear, points, b, u)
    assert np.abs(linear - u).max() > 1e-4 * np.abs(u).max()


def test_answers_beyond_the_proven_strain_come_with_a_warning():
    model = solid("energy")
    points, u, b = problem(model, 0.1, interior=0)
    with pytest.warns(UserWarning, match=r"proven unique up to \|H\| = .* go beyond it"):
        solved = solve_nonlinear(model, points, np.stack([b, 0 * b]), np.stack([u, 0 * u]))
    assert np.abs(solved[0] - u).max() <= 1e-6 * np.abs(u).max()
    assert not solved[1].any()


def test_newton_goes_where_the_fixed_point_does_not(monkeypatch):
    model = replace(solid("energy"), proven={})
    points, u, b = problem(model, 0.03, interior=0)
    monkeypatch.setattr(equilibria, "MOST_STEPS", 2)
    records: list[NonlinearRecord] = []
    with pytest.warns(UserWarning, match="no strain, for want of a certificate"):
        solved = solve_nonlinear(model, points, b, u, records=records)
    assert records[0].method == "newton"
    assert np.abs(solved - u).max() <= 1e-6 * np.abs(u).max()
    monkeypatch.setattr(conjugate_gradients, "MOST", 1)
    with pytest.raises(InputError, match="sample 0: no equilibrium was found beyond"):
        solve_nonlinear(model, points, 40 * b, u)


def test_iterative_linear_solves_give_the_same_answer(monkeypatch):
    model = solid("filtered")
    points, u, b = problem(model, 0.004)
    solved = solve_nonlinear(model, points, b, u)
    monkeypatch.setattr(linear, "cheapest_method", lambda *points, **options: "lu")
    expected = solve_nonlinear(model, points, b, u)
    assert np.abs(solved - expected).max() <= 1e-6 * np.abs(expected).max()
