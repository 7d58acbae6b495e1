"""Answers on every second node, held to the rich member's own on all of them."""

from dataclasses import replace

import numpy as np
import pytest

import warp_peri as wp
from tests.prediction.test_predict import family, far  # noqa: F401 (a fixture)
from tests.support.problems import lattice, smooth
from warp_peri.points.every_second import EverySecond
from warp_peri.prediction.learning import short_where_held
from warp_peri.prediction.placed import ErrorSpectrum

pytestmark = pytest.mark.filterwarnings("ignore:strain:UserWarning")
WIDE = 6.0


@pytest.fixture(scope="module")
def both(family):  # noqa: F811
    """The family with K = 1/r at twice the spacing, which is the same solid on long waves."""
    rich = family.rich
    linear = replace(rich.linear, horizon=WIDE, certified_on=(2.0,), certificate={}, provenance={})
    linear = replace(linear, certificate={"2": wp.certify(linear, spacing=2.0).figures()})
    return replace(family, coarse=replace(rich, linear=linear, proven={}))


def problem(family, size, wave, interior=21):  # noqa: F811
    """Nodes with a wide collar, a field, and the load that holds the rich member there."""
    points = lattice(interior, WIDE)
    u = size * smooth(points.x, 1, 0, wave_number=wave)[0]
    b = np.zeros_like(u)
    b[points.interior] = family.on(points)(u)
    return points, u, b


def test_splines_and_means_keep_what_is_smooth():
    points = lattice(17, 5.0)
    nodes = EverySecond(points)
    assert nodes.nodes.spacing == 2
    u = smooth(points.x, 1, 3, wave_number=0.2)[0]
    found = nodes.spread(u[nodes.chosen])
    assert np.abs(found - u[points.interior]).max() < 1e-3 * np.abs(u).max()
    one = np.ones((points.interior.sum(), 2))
    np.testing.assert_allclose(nodes.gathered(one).max(axis=0), 1.0)


def test_a_loose_tolerance_is_answered_on_every_second_node(both):
    points, u, b = problem(both, 0.05, 0.12)
    given = wp.Dirichlet(points, b, np.where(points.interior[:, None], 0, u))
    loose, best = wp.predict(both, given, 0.1), wp.predict(both, given, None)
    assert loose.why.startswith("on every second node, linear")
    assert loose.kept
    assert 0.75 * far(loose.u, u, points) < loose.error < 0.1
    assert best.why.startswith("from every second node")
    assert far(best.u, u, points) < 0.1 * far(loose.u, u, points)
    assert loose.map()[points.interior].max() > 0


@pytest.mark.parametrize(("tolerance", "where"), [(0.02, "on"), (0.01, "from")])
def test_how_corrections_shrink_there_is_known_on_all_nodes_too(both, tolerance, where):
    """c|H| knows nothing here: the part of strain is what the second has of the first."""
    told = replace(both, factors=replace(both.factors, screen=1e-6))
    points, u, b = problem(told, 0.3, 0.12)
    held = np.where(points.interior[:, None], 0, u)
    placed = told.with_doubts(points)
    coarse, load, inside = placed.coarse, placed.load(b), points.interior
    found = coarse.start(b, held, 1e-3)
    bent = far(found, u, points)
    first, _ = coarse.correction(load - placed.rich(found))
    found[inside] += coarse.spread(first)
    second, _ = coarse.correction(load - placed.rich(found))
    slowed = np.linalg.norm(second) / np.linalg.norm(first)
    answer = wp.predict(placed, wp.Dirichlet(points, b, held), tolerance)
    assert answer.why.startswith(f"{where} every second node")
    assert answer.kept
    assert answer.parts["strain"] == pytest.approx(told.factors.floor * slowed * bent, rel=0.15)


def test_for_many_loads_at_once_small_bodies_are_factorised(both):
    points, u, b = problem(both, 0.05, 0.12)
    held = np.where(points.interior[:, None], 0, u)
    placed, count = both.with_doubts(points), 30
    many = wp.predict(placed, wp.Dirichlet(points, [b] * count, [held] * count), 0.1)
    alone = wp.predict(both, wp.Dirichlet(points, b, held), 0.1)
    assert far(many[0].u, alone.u, points) < 0.03
    assert many[-1].error == pytest.approx(alone.error, rel=0.2)
    assert far(many[0].u, u, points) < many[0].error
    coarse = placed.coarse
    few = coarse.operator.load(b[coarse.nodes.chosen])
    for who, nodes, right in ((placed, points, placed.load(b)), (coarse, coarse.nodes.nodes, few)):
        found = np.zeros_like(nodes.x)
        found[nodes.interior] = who.inverse(right, 0.5)  # exact, however loosely it is asked
        assert np.abs(who.straight(found) - right).max() < 1e-8 * np.abs(right).max()


def test_short_waves_do_not_pose_as_long_ones(both):
    points, u, b = problem(both, 0.01, 3.0)  # 2.1 spacings
    given = wp.Dirichlet(points, b, np.where(points.interior[:, None], 0, u))
    alone = wp.predict(replace(both, coarse=None), given, None)
    answer = wp.predict(both, given, None)
    assert far(answer.u, alone.u, points) < 0.01
    assert not wp.predict(both, given, 0.1).why.startswith("on every second node")


def test_a_load_between_the_coarse_nodes_is_not_lost(both):
    points = lattice(21, WIDE)
    b, nodes = np.zeros_like(points.x), EverySecond(points)
    free = np.setdiff1d(np.flatnonzero(points.interior), nodes.chosen)
    b[free[len(free) // 2], 1] = 1e-3
    held = wp.Dirichlet(points, b, 0 * b)
    answer = wp.predict(both, held, 0.1)
    assert answer.why.startswith("linear")
    assert far(answer.u, wp.solve(both.rich, held).u, points) < answer.error < 0.1
    nothing = wp.predict(both, wp.Dirichlet(points, 0 * b, 0 * b), 0.1)
    assert nothing.kept
    assert nothing.error == np.abs(nothing.u).max() == 0


def test_bodies_between_the_coarse_nodes_are_answered(both):
    points, u, b = problem(both, 0.01, 0.12)
    middle = np.abs(points.x - points.x.mean(axis=0))[:, 0] < 0.5
    thin = replace(points, interior=points.interior & middle)
    answer = wp.predict(both, wp.Dirichlet(thin, b, u), 0.1)
    assert answer.why.startswith("linear")
    assert far(answer.u, u, thin) < 0.1


@pytest.mark.parametrize(("wave", "most"), [(0.12, 1.2), (0.6, 1.5), (2.2, 1.5), (3.0, 3.0)])
def test_a_first_answer_tells_how_far_it_is(both, wave, most):
    """By one evaluation on all nodes, short waves that pose as long ones between them included."""
    points, u, b = problem(both, 0.03, wave)
    placed, given = both.with_doubts(points), np.where(points.interior[:, None], 0, u)
    coarse = placed.coarse
    first = coarse.start(b, given, 1e-3)
    left, missed = coarse.correction(placed.load(b) - placed.rich(first))
    off = np.linalg.norm((first - u)[points.interior])
    assert coarse.norm(left) == pytest.approx(np.linalg.norm(coarse.spread(left)), rel=0.1)
    assert off < coarse.norm(left) < np.hypot(coarse.norm(left), missed) < most * off


def test_clamped_bodies_are_held_elsewhere_on_every_second_node(both):
    """Data go on smoothly into the collar; a clamped field does not, and moves where it is held."""
    told = replace(both, record=ErrorSpectrum(np.array([2.0, 4.0, 8.0]), np.full(3, 1e-4)))
    nodes = lattice(9, WIDE)
    short = short_where_held(told, told.coarse.horizon, told.factors.left, nodes)
    other = replace(told, factors=replace(told.factors, short=7.0))
    assert (
        short_where_held(other, other.coarse.horizon, told.factors.left, nodes) == short
    )  # whatever it was before
    told = replace(told, factors=replace(told.factors, short=short))
    for interior in (30, 31):
        points = lattice(interior, WIDE)
        b = np.zeros_like(points.x)
        b[points.interior, 0] = 1e-3
        clamped = wp.Dirichlet(points, b, 0 * b)
        truth = wp.solve(told.rich, clamped).u
        coarse = told.with_doubts(points).coarse
        first = coarse.start(b, 0 * b, 1e-3)
        assert 0.02 < far(first, truth, points) < 0.2
        for tolerance in (0.02, 0.05, 0.1, 0.3):
            answer = wp.predict(told, clamped, tolerance)
            assert far(answer.u, truth, points) < answer.error < tolerance
