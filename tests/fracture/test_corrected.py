"""Bodies whose missing bonds take the mean gradient of those that are left (theory, C26, C27)."""

import numpy as np
from numpy.linalg import eigvalsh, norm
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from tests.gradients.cases import assert_slopes, given, loss
from tests.support import approx, in_plane_and_space, near, parametrize
from tests.support.bodies import plate, random_breaking, solid
from tests.support.problems import everywhere, noise, normal, within
from warp_peri import CG, Cracked, Points, simulate, solve
from warp_peri.fracture import bonds, box_nodes, penny_corners, point_force, rectangle_nodes
from warp_peri.fracture.bonds import bond_matrix, bonds_of, largest_stiffness
from warp_peri.fracture.dynamics import SPREAD, BreakingBody


def matrix(model, body, table, corrected=True):
    return bond_matrix(body, table, bonds_of(model, body.classes), corrected=corrected)


def stiff(model, corrected):
    """Force of a strip under unit strain along it over E: what it counts for as wide."""
    x = rectangle_nodes(13, 40, 1.0)
    grips, held = np.abs(x[:, 1]) > 20 - model.horizon, np.zeros(x.shape, bool)
    held[grips, 1] = held[np.argmin(np.abs(x).sum(1)), 0] = True
    problem = Cracked(everywhere(x), u=x * (0, 1), free=~held, corrected=corrected)
    u = (solution := solve(model, problem)).u
    pull = solution.operator.times(u[None])[0, grips & (x[:, 1] > 0), 1].sum()
    middle = np.abs(x[:, 1]) < 6
    return pull / np.polyfit(x[middle, 1], u[middle, 1], 1)[0] / model.E


@parametrize(("horizon", "cut", "off", "lam"), [(2.0, 0.15, 1e-4, 1.0), (3.0, 0.4, 0.01, 0.3)])
def test_a_strip_is_as_stiff_as_it_is_wide(horizon, cut, off, lam):
    model = solid(lam, horizon=horizon).model
    assert stiff(model, False) < 13 - cut
    assert stiff(model, True) == approx(13, abs=off)


@parametrize(
    ("sides", "lam", "share"), [((9, 8), 3.0, 0.0), ((9, 8), -0.3, 0.3), ((5, 4, 5), -0.3, 0.7)]
)
def test_no_breaking_makes_an_energy_negative(sides, lam, share):
    body, model = plate(*sides, horizon=2.0), solid(lam, horizon=2.0, dimension=len(sides)).model
    table = random_breaking(body, default_rng(1), share)
    L = matrix(model, body, table)
    assert abs(L - L.T).max() < 1e-13
    corrected, cut = (eigvalsh(one.toarray()) for one in (L, matrix(model, body, table, False)))
    assert corrected[0] > -1e-12 * corrected[-1]
    assert np.sum(corrected < 1e-9 * corrected[-1]) <= np.sum(cut < 1e-9 * cut[-1])


@parametrize(("d", "share"), [(2, 0.6), (3, 0.3)])
def test_in_motion_force_and_energy_are_those_of_the_matrix(d, share, monkeypatch):
    monkeypatch.setattr(bonds, "SPANNED", SPREAD)
    body = plate(*(8, 7, 6)[-d:], horizon=2.0)
    brittle = solid(0.4, horizon=2.0, dimension=d)
    table = random_breaking(body, default_rng(1), share)
    moving = BreakingBody(brittle, body, corrected=True)
    u = noise(body, seed=2)
    state = moving.start()
    state.links, state.correction = moving.operator.links(table), moving.correction(table >= 0)
    state.u.numpy()[:] = u
    moving.operator.sweep(*state.swept)
    moving.correct(state)
    L = matrix(brittle.model, body, table)
    force, energy = state.force.numpy(), state.energy.numpy()
    near(force, -(L @ u.ravel()).reshape(u.shape), 1e-12)
    near(energy.sum(), u.ravel() @ L @ u.ravel() / 2, 1e-12)
    stiffest = eigvalsh(L.toarray())[-1]
    assert stiffest < 1.05 * largest_stiffness(brittle.model, body.classes)
    assert moving.longest_step < 2 * np.sqrt(brittle.inertia / stiffest)


def test_a_corrected_plate_breaks_with_its_ledger_and_goes_on_with_the_same_bits(tmp_path):
    x, brittle = rectangle_nodes(12, 10, 1.0), solid(1.0)
    rim, missing = np.abs(x[:, 1]) > 4, []
    problem = Cracked(Points(x, ~rim, 1.0), cracks=[[(-6, 0), (-2, 0)]], corrected=True)
    longest = BreakingBody(brittle, plate(6, 6), corrected=True).longest_step
    for finer in (1, 4):
        how = {"step": 0.5 * longest / finer, "every": 20 * finer, "no_fail": rim}
        how["grip"] = np.outer(rim * np.sign(x[:, 1]), (0, 8e-4 / longest))
        run = simulate(brittle, problem, **how, steps=140 * finer)
        missing.append(run.missing)
        assert run["dissipated"][-1] > 0
        assert (np.diff(run["dissipated"]) >= 0).all()
    assert missing[0] < 0.02
    assert missing[1] < missing[0] / 3  # of second order, while bonds break one by one
    how |= {"checkpoint": tmp_path / "run.h5", "checkpoint_every": 1, "series": tmp_path}
    part = [simulate(brittle, problem, **how, steps=360).time[-1] for _ in range(2)]
    again = simulate(brittle, problem, **how, steps=560)
    assert_array_equal(again.u, run.u)
    assert_array_equal(again.details.damage, run.details.damage)
    assert part[0] == part[1]
    assert_array_equal(again["work"], run["work"])
    assert_array_equal(again.time, run.time)
    assert (tmp_path / "motion.pvd").read_text().count("timestep=") == len(run.time)


def test_waves_with_free_edges_have_the_derivatives_of_differences():
    """Of a cracked plate, held at one end, to all that moves it."""
    x = rectangle_nodes(10, 8, 1.0)
    problem = Cracked(Points(x, x[:, 0] > -4, 1.0), cracks=[[(0, 0), (5, 0)]], corrected=True)
    cut = problem.waves(solid(0.4).model)
    assert cut.max_symbol_eigenvalue() >= eigvalsh(cut.matrix.toarray())[-1]
    fields, options = given(cut)
    assert_slopes(lambda of: loss(cut, of, options), fields, 10.0, 1e-8)


@in_plane_and_space
def test_a_force_on_an_edge_does_its_work_in_any_affine_displacement(d):
    x, h = 0.5 * box_nodes((8,) * d, 1.0), 0.5
    place, force = np.array([0.3, 2.0, 0.1][:d]), np.array([1.0, -3.0, 2.0][:d])
    b = point_force(x, h, place, force)
    assert_allclose(h**d * b.sum(0), force, atol=1e-12)
    assert_allclose(h**d * x.T @ b, np.outer(place, force), atol=1e-12)
    assert norm(x[np.abs(b).sum(1) > 0] - place, axis=1).max() < 2 * h


def test_conjugate_gradients_find_what_factors_find():
    x = box_nodes((8, 8, 8), 1.0)
    model = solid(0.4, horizon=2.0, dimension=3).model
    u, b = (normal(x.shape, n) for n in (0, 1))
    problem = Cracked(within(x, 3), b, u, cracks=[penny_corners(2.0)], corrected=True)
    solvers = None, CG(tolerance=1e-10)
    by_factors, by_search = (solve(model, problem, solver=one) for one in solvers)
    assert (by_factors.method, by_search.method) == ("lu", "cg")
    assert_allclose(by_search.u, by_factors.u, atol=1e-7)
    assert by_search.residual < 1e-10
