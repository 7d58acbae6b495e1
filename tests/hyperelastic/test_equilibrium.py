"""Equilibria at large deformation: found, stable, the same by factors and by gradients."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.linalg import eigvalsh

from tests.support import near, parametrize, refused, shared, sup, warned
from tests.support.problems import lattice as nodes
from tests.support.problems import normal, on_interior
from tests.support.sheets import dictionary_of, sheet_on, square, waves
from warp_peri import Newton, Samples, evaluate
from warp_peri.hyperelastic import NoEquilibriumError
from warp_peri.materials.hyperelastic import lattice
from warp_peri.solvers.equilibria import Descent

COEFFICIENTS = np.array([0.2] * 4 + [0.07, 0.08, 0.2])


@shared
def manufactured():
    """A field and the load that it is in equilibrium with."""
    op = sheet_on(square(6), c=COEFFICIENTS)
    u = waves(op.points, 0.25)
    return op, u, op.on_all(op.force(u))


def test_a_known_equilibrium_is_found(manufactured, monkeypatch):
    op, u, b = manufactured
    for direct in (0, 10**6):
        monkeypatch.setattr(lattice, "DIRECT", direct)
        answer = sheet_on(op.points, c=COEFFICIENTS).solve(b, u)
        near(answer.u, u, 1e-6)
        (record,) = answer.details
        assert (record.followed, record.unique) == (True, False)  # found, but nothing is proven
        assert record.residual < 1e-8
        assert record.eigenvalue > 0


def test_the_smallest_eigenvalue_is_below_zero_where_the_tangent_is():
    """The eigenvalue nearest to zero is positive here: it is not the one to tell."""
    op = sheet_on(square(5), c=[0.05] * 4 + [1.0, 1.0, 0.0])
    u = op.points.x * [-0.2, 0.0]
    values = eigvalsh(op.interior_tangent(u).toarray())
    assert values[0] < -100
    assert values[np.abs(values).argmin()] > 0
    near(op.smallest_eigenvalue(u), values[0], 1e-6)
    near(op.smallest_eigenvalue(0 * u), eigvalsh(op.interior_tangent(0 * u).toarray())[0], 1e-2)


def test_continuation_leads_where_one_step_does(manufactured):
    op, u, b = manufactured
    far = on_interior(op.points, 9 * u, u)  # folded: nothing is found from there
    found, record = Descent(op).find(b[op.interior], u, 1e-8, far)
    assert (record.followed, record.method) == (True, "parts")
    near(found, u, 1e-6)


def test_what_is_left_of_a_branch_or_not_stable_is_said_or_not_given(manufactured, monkeypatch):
    """Compression to a third: the branch ends; what comes back says that it left it, or nothing."""
    op, wave, b = manufactured
    u = -0.66 * op.points.x + 1e-3 * waves(op.points)
    soft = op.at({"coefficients": COEFFICIENTS * ([0.01] * 4 + [1] * 3)})
    found, record = Descent(soft).find(0 * b[op.interior], u, 1e-8)
    if record.converged:
        assert not record.followed
        assert soft.smallest_eigenvalue(found) > 0
        with warned("perhaps one of many"):
            soft.solve(None, u)
    none = sheet_on(square(2), c=-COEFFICIENTS)
    for op, edge in ((none, waves(none.points)), *([] if record.converged else [(soft, u)])):
        with pytest.raises(NoEquilibriumError, match="no stable equilibrium found"):
            op.solve(None, edge)
    with refused("equilibrium found .*; to 1e-08 there is one: rounding may be above the tol"):
        manufactured[0].solve(None, wave, Newton(1e-16))
    monkeypatch.setattr(type(op), "smallest_eigenvalue", lambda *_: -1.0)
    with refused("sample 0: .* unstable: eigenvalue -1"):
        manufactured[0].solve(b, wave)


def test_a_collar_that_is_folded_far_out_does_not_stop_a_solve():
    """Nothing that the interior cannot move belongs to the energy, or to the scale of forces."""
    op = sheet_on(square(3), c=COEFFICIENTS)
    x, u, h = op.points.x, waves(op.points, 0.1), op.points.spacing
    even = op.solve(None, u).u
    corner = np.flatnonzero((x < 1.5 * h).all(1))
    u[corner] += 1.5 * h * normal((len(corner), 2), 2)
    near(op.solve(None, u).u[op.interior], even[op.interior], 1e-10, 1)


def test_a_corner_that_is_turned_over_is_no_equilibrium():
    corners = ((kind, 0.0, 0.0, True) for kind in ("neo_hookean", "volumetric"))
    op = sheet_on(square(3), dictionary_of(*corners, deviations=()), [0.07, 0.08])
    u, none = np.zeros_like(op.points.x), np.zeros((9, 2))
    assert op.folds(u) == 0
    u[op.interior[4]] = [-1.2 * op.points.spacing, 0.0]  # beyond its neighbour
    assert 0 < op.folds(u)
    found, record = Descent(op).find(none, 0 * u, 1e-8, u)
    assert not record.converged or op.folds(found) == 0
    assert sup(op.solve(None, 0 * u).u) < 1e-12


def test_stretches_beyond_the_training_data_warn(manufactured):
    op, u, b = manufactured
    reached = op.largest_stretch(u)
    assert reached > 1.05
    samples = Samples(op.points, np.array([u, u]), np.array([b, 0 * b]))
    known = replace(op.model, stretch=reached)
    errors = evaluate(known, samples)
    assert errors["E_u_samples"][0] < 1e-6
    assert errors["E_res_samples"][1] is None
    with warned(f"stretch: the fields reach {reached:.4g}, the training data 1.02"):
        evaluate(replace(op.model, stretch=1.02), samples)
    samples.u[1] = 0
    assert evaluate(known, samples)["E_u_samples"][1] is None


@parametrize("sides", [(7, 40), (40, 7)])
def test_factors_have_a_band_as_wide_as_the_shorter_side_and_are_of_what_is_definite(sides):
    op = sheet_on(replace(nodes(np.ones(sides, bool), 3.0), axis=None))
    u, y = 0.01 * waves(op.points), normal(2 * np.prod(sides))
    inverse, stable = op.factors(u)
    assert stable
    assert len(inverse.args[0]) <= 2 * (6 * 7 + 7)
    near(op.interior_tangent(u) @ inverse(y), y, 1e-10, 1)
    other = op.at({"coefficients": -op.model.coefficients})
    assert other.factors(u) == op.factors(np.nan * u) == (None, False)
    shifted, stable = other.factors(u, shifts=True)
    assert not stable
    assert y @ shifted(y) > 0
