"""Equilibrium of third-order crystals."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.nonlinear import FORMS, solid
from tests.support.problems import ell, lattice, loaded, smooth
from warp_peri import Dirichlet, InputError, Newton, solve
from warp_peri.solvers import equilibria, systems
from warp_peri.solvers.linear import Linear


def problem(model, size, interior=7):
    """A smooth field and the load that holds it."""
    points = replace(lattice(interior, 3.0), axis=0.0)
    made = loaded(model.on(points), size * smooth(points.x, 1, 0, wave_number=0.5))
    return points, made.u[0], made.b[0]


@pytest.mark.parametrize("form", FORMS)
def test_a_known_answer_is_found_within_the_proven_strain(form, monkeypatch):
    model = solid(form)
    points, u, b = problem(model, 0.004)
    posed = Dirichlet(points, b, u)
    solution = solve(model, posed, solver=Newton(1e-8, True))  # a warning would be an error
    assert np.abs(solution.u - u).max() <= 1e-7 * np.abs(u).max()
    (record,) = solution.details
    assert record.unique
    assert record.largest_gradient <= model.proven_strain(1.0)
    assert record.solves <= 10
    assert record.eigenvalue > 0
    assert np.abs(solve(model.linear, posed).u - u).max() > 1e-4 * np.abs(u).max()
    monkeypatch.setattr(Linear, "method", lambda *asked, **options: "lu")
    factorised = solve(model, posed, solver=Newton(1e-8)).u
    assert np.abs(solution.u - factorised).max() <= 1e-6 * np.abs(u).max()


def test_answers_beyond_the_proven_strain_come_with_a_warning():
    model = solid("energy")
    points, u, b = problem(model, 0.1, ell())
    with pytest.warns(UserWarning, match=r"proven unique up to \|H\| = .* go beyond it"):
        solved = solve(model, Dirichlet(points, np.stack([b, 0 * b]), np.stack([u, 0 * u]))).u
    assert np.abs(solved[0] - u).max() <= 1e-6 * np.abs(u).max()
    assert not solved[1].any()


def test_newton_goes_where_the_fixed_point_does_not(monkeypatch):
    model = replace(solid("energy"), proven={})
    points, u, b = problem(model, 0.03, ell())
    monkeypatch.setattr(equilibria, "MOST_STEPS", 2)
    with pytest.warns(UserWarning, match="no strain, for want of a certificate"):
        solution = solve(model, Dirichlet(points, b, u))
    assert solution.details[0].method == "newton"
    assert np.abs(solution.u - u).max() <= 1e-6 * np.abs(u).max()
    monkeypatch.setattr(systems, "MOST", 1)
    with pytest.raises(InputError, match="sample 0: no equilibrium was found beyond"):
        solve(model, Dirichlet(points, 40 * b, u))
