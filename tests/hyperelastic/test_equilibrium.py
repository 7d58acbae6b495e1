"""Equilibria at large deformation: found, stable, the same by factors and by gradients."""

from dataclasses import replace

import numpy as np
import pytest

from tests.conformance.test_laws import hyperelastic, tissue
from tests.support.sheets import hgo_dictionary, square, waves
from warp_peri import Dirichlet, InputError, Points, Samples, solve
from warp_peri.materials.hyperelastic.energies import EnergyTerm, Hyperelastic, HyperelasticMaterial
from warp_peri.materials.hyperelastic.equilibrium import NoEquilibriumError, Sheet, StaticProblem
from warp_peri.materials.hyperelastic.operator import HyperelasticOperator
from warp_peri.materials.hyperelastic.placed import evaluate_hyperelastic, largest_stretch
from warp_peri.solvers.equilibria import stable_way

COEFFICIENTS = np.array([0.2] * 4 + [0.07, 0.08, 0.2])
CORNERED = (EnergyTerm("neo_hookean", corner=True), EnergyTerm("volumetric", corner=True))


@pytest.fixture(scope="module")
def manufactured():
    """A field and the load that it is in equilibrium with."""
    points = square(6)
    op = HyperelasticOperator(hgo_dictionary(), points)
    u = waves(points, 0.25)
    b = np.zeros_like(u)
    b[op.interior] = op.force(u, COEFFICIENTS)
    return op, u, b


@pytest.mark.parametrize("direct", [0, 10**6])
def test_a_known_equilibrium_is_found(manufactured, direct):
    op, u, b = manufactured
    problem = StaticProblem(op, direct=direct)
    answer = problem.solve(COEFFICIENTS, b, u)
    assert np.abs(answer.u - u).max() < 1e-6 * np.abs(u).max()
    assert answer.followed
    assert answer.residual < 1e-8
    assert answer.smallest_eigenvalue > 0


@pytest.mark.parametrize("stretch", [0.9, 0.8])
def test_the_smallest_eigenvalue_is_below_zero_where_the_tangent_is(stretch):
    """The eigenvalue nearest to zero is positive here: it is not the one to tell."""
    points = square(5)
    op = HyperelasticOperator(hgo_dictionary(), points)
    problem = StaticProblem(op)
    c = np.array([0.05] * 4 + [1.0, 1.0, 0.0])
    u = points.x * [stretch - 1, 0.0]
    values = np.linalg.eigvalsh(problem.pattern.matrix(problem.op, u, c).toarray())
    assert values[0] < -100
    assert values[np.abs(values).argmin()] > 0
    assert problem.smallest_eigenvalue(c, u) == pytest.approx(values[0], rel=1e-6)
    dense = np.linalg.eigvalsh(problem.pattern.matrix(problem.op, 0 * u, c).toarray())[0]
    assert problem.smallest_eigenvalue(c, 0 * u) == pytest.approx(dense, rel=1e-2)


def test_continuation_leads_where_one_step_does(manufactured):
    op, u, b = manufactured
    collar = np.where(op.points.interior[:, None], 0.0, u)
    sheet = Sheet(StaticProblem(op), COEFFICIENTS, b[op.interior], collar)
    far = np.where(op.points.interior[:, None], 9 * u, u)  # folded: nothing is found from there
    found, _, parts, followed = stable_way(sheet, far, None, 1e-8)
    assert followed
    assert parts > 1
    np.testing.assert_allclose(found, u, atol=1e-6 * np.abs(u).max())


def test_a_sheet_pushed_together_is_stable_or_refused(manufactured):
    """Compression to a third: the branch ends; what comes back says that it left it, or nothing."""
    op, _, _ = manufactured
    u = -0.66 * op.points.x + 1e-3 * waves(op.points)
    problem = StaticProblem(op)
    soft = COEFFICIENTS * ([0.01] * 4 + [1] * 3)
    answer = problem.find(soft, None, u)
    assert answer is None or not answer.followed
    if answer is None:
        with pytest.raises(NoEquilibriumError, match="no stable equilibrium"):
            problem.solve(soft, None, u)
    else:
        assert problem.smallest_eigenvalue(soft, answer.u) > 0
        with pytest.warns(UserWarning, match="perhaps one of many"):
            problem.solve(soft, None, u)


def test_a_solid_without_stiffness_is_refused(manufactured):
    op, u, b = manufactured
    solid = HyperelasticMaterial(op.dictionary, -COEFFICIENTS, op.points.spacing)
    with pytest.raises(NoEquilibriumError, match="no stable equilibrium found"):
        solve(solid, Dirichlet(op.points, b, u))
    with pytest.raises(InputError, match="b: expected finite values"):
        solve(solid, Dirichlet(op.points, np.full_like(b, np.nan), u))


def test_a_collar_that_is_folded_far_out_does_not_stop_a_solve():
    points = square(3)
    op = HyperelasticOperator(hgo_dictionary(), points)
    c = np.array([0.1] * 4 + [0.07, 0.08, 0.2])
    u = waves(points, 0.1)
    even = StaticProblem(op).solve(c, None, u)
    corner = np.flatnonzero((points.x < 1.5 * points.spacing).all(axis=1))
    u[corner] += 1.5 * points.spacing * np.random.default_rng(2).normal(size=(len(corner), 2))
    assert not np.isfinite(op.energy(u, c))
    answer = StaticProblem(op).solve(c, None, u)
    inner = points.interior
    np.testing.assert_allclose(answer.u[inner], even.u[inner], atol=1e-10)


def test_a_folded_corner_of_the_collar_hides_no_residual():
    """Nothing that the interior cannot move belongs to the scale of the forces."""
    points, c = square(5), np.array([0.07, 0.08])
    op = HyperelasticOperator(Hyperelastic(3.0, terms=CORNERED), points)
    u = waves(points)
    expected = StaticProblem(op).solve(c, None, u).u[points.interior]
    u[0] = u[1] + points.x[1] - points.x[0]
    problem = StaticProblem(op)
    answer = problem.solve(c, None, u)
    np.testing.assert_allclose(answer.u[points.interior], expected, atol=1e-12)
    np.testing.assert_array_equal(problem.op.force(u, c), op.force(u, c))


def test_a_corner_that_is_turned_over_is_no_equilibrium():
    points = square(3)
    op = HyperelasticOperator(Hyperelastic(3.0, terms=CORNERED), points)
    u = np.zeros_like(points.x)
    assert op.folded(u) == 0
    u[op.interior[4]] = [-2.4 * points.spacing, 0.0]  # through its neighbour, to the other side
    assert op.folded(u) > 0
    problem = StaticProblem(op)
    c = np.array([0.07, 0.08])
    answer = problem.find(c, None, np.zeros_like(u), start=u)
    assert answer is None or op.folded(answer.u) == 0
    assert np.abs(problem.solve(c, None, np.zeros_like(u)).u).max() < 1e-12


def test_stretches_beyond_the_training_data_warn(manufactured):
    op, u, b = manufactured
    reached = largest_stretch(op, u)
    assert reached > 1.05
    samples = Samples(op.points, u[None], b[None])
    known = HyperelasticMaterial(hgo_dictionary(), COEFFICIENTS, op.points.spacing, reached)
    assert np.allclose(solve(known, Dirichlet(op.points, b, u)).u, u)
    evaluate_hyperelastic(known, samples)
    less = replace(known, stretch=1.02)
    said = f"stretch: the fields reach {reached:.4g}, the training data 1.02"
    with pytest.warns(UserWarning, match=said):
        solve(less, Dirichlet(op.points, b, u))
    with pytest.warns(UserWarning, match=said):
        evaluate_hyperelastic(less, samples)


@pytest.mark.parametrize("size", [1e-5, 1e-11, 1e-200])
def test_very_small_loads_and_collars_have_answers_in_proportion(size):
    """Rounding of forces, which are differences of products near one, ended in no equilibrium."""
    solid, points = hyperelastic(), tissue(9)
    b = 1e-3 * np.sin(points.x) * points.interior[:, None]
    for load, collar in ((b, 0 * b), (0 * b, np.cos(points.x))):
        known = solve(solid, Dirichlet(points, 1e-2 * load, 1e-5 * collar)).u / 1e-5
        found = solve(solid, Dirichlet(points, 1e3 * size * load, size * collar))
        near = 1e-4 * np.abs(known).max()  # of second order in the strain
        np.testing.assert_allclose(found.u / size, known, atol=near, rtol=0)
        assert found.residual < 1e-8


def test_lattices_have_a_band_as_wide_as_their_shorter_side_and_rough_factors_half_the_bits():
    for sides in ((7, 40), (40, 7)):
        steps = np.argwhere(np.ones(np.add(sides, 12), bool))
        inside = ((steps >= 6) & (steps < np.add(sides, 6))).all(axis=1)
        points = Points(steps, inside, 1.0)
        problem = StaticProblem(HyperelasticOperator(hgo_dictionary(), points))
        assert problem.pattern.width <= 2 * (6 * 7 + 7)
        u, c = 0.01 * waves(points), np.ones(7)
        K = problem.pattern.matrix(problem.op, u, c)
        factors, stable = problem.factors(c, u)
        assert stable
        y = np.random.default_rng(0).normal(size=(K.shape[0], 2))
        np.testing.assert_allclose(K @ factors.solve(y), y, atol=1e-10)
        half = factors.rough()
        np.testing.assert_allclose(half.solve(y), factors.solve(y), rtol=1e-2, atol=1e-3)
        assert half.band.dtype == np.float32
    assert problem.factors(-c, u) == problem.factors(c, np.nan * u) == (None, False)
    shifted, stable = problem.factors(-c, u, shifts=True)
    assert not stable
    assert (y[:, 0] @ shifted.solve(y[:, 0])) > 0
