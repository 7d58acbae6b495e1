"""Answers on every second node, held to the rich member's own on all of them."""

from dataclasses import replace

import numpy as np
import pytest

import warp_peri as wp
from tests.prediction.test_predict import family, far  # noqa: F401 (a fixture)
from tests.support.problems import lattice, smooth
from warp_peri.points.every_second import EverySecond
from warp_peri.prediction.hidden import Hidden
from warp_peri.prediction.learning import moved_where_held
from warp_peri.prediction.spectrum import Record

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


def test_short_waves_do_not_pose_as_long_ones(both):
    points, u, b = problem(both, 0.01, 3.0)  # 2.1 spacings
    given = wp.Dirichlet(points, b, np.where(points.interior[:, None], 0, u))
    alone = wp.predict(replace(both, coarse=None), given, None)
    answer = wp.predict(both, given, None)
    assert far(answer.u, alone.u, points) < 0.01
    assert not wp.predict(both, given, 0.1).why.startswith("on every second node")


def test_bodies_between_the_coarse_nodes_are_answered(both):
    points, u, b = problem(both, 0.01, 0.12)
    middle = np.abs(points.x - points.x.mean(axis=0))[:, 0] < 0.5
    thin = replace(points, interior=points.interior & middle)
    answer = wp.predict(both, wp.Dirichlet(thin, b, u), 0.1)
    assert answer.why.startswith("linear")
    assert far(answer.u, u, thin) < 0.1


def test_a_screen_spares_the_correction(both, monkeypatch):
    told = replace(both, carried=Record(np.array([2.0, 4.0, 8.0]), np.array([0.05, 0.02, 0.01])))
    points, u, b = problem(told, 0.05, 0.12)
    given = wp.Dirichlet(points, b, np.where(points.interior[:, None], 0, u))
    placed = told.with_doubts(points)

    def refused(*_):
        raise AssertionError("the rich member was asked")

    first = placed.coarse.start(b, given.u, 1e-3)
    nodes, chosen = placed.coarse.nodes.nodes, placed.coarse.nodes.chosen
    there = wp.solve(told.coarse, wp.Dirichlet(nodes, b[chosen], given.u[chosen]))
    missing = far(first[chosen], there.u, nodes)
    assert placed.coarse.own(b, first) == pytest.approx(missing, rel=0.15)
    monkeypatch.setattr(placed, "rich", refused)
    monkeypatch.setattr(placed, "load", lambda b: b[points.interior])
    loose = wp.predict(placed, given, 0.2)
    assert loose.corrections == 0
    assert loose.why.startswith("on every second node, linear;")
    assert far(loose.u, u, points) < loose.error < 0.2
    with pytest.raises(AssertionError, match="was asked"):
        wp.predict(placed, given, 0.01)
    known = told.factors.left * missing, told.carried.error.min()
    assert loose.parts["left"] >= 0.85 * np.hypot(*known)  # solves to 3 % come from below


def test_waves_that_hide_between_coarse_nodes_are_seen():
    points = lattice(30, 4.0)
    found = Hidden(points, 0.5)
    for number, shown in ((3.0, True), (2.2, True), (0.5, False)):
        k = number * np.array([np.cos(0.3), np.sin(0.3)])
        u = np.cos(points.x @ k)[:, None] * np.ones(2)
        b = 0.5 * number**2 * u
        size = np.linalg.norm(u[points.interior])
        load, collar = found.of_load(b[points.interior]) / size, found.of_collar(u) / size
        assert (load > 1) == shown
        assert (collar > 0.3) == shown
        assert max(load, collar) < 0.05 or shown
    assert found.of_load(np.zeros((points.interior.sum(), 2))) == found.of_collar(0 * u) == 0


def test_clamped_bodies_bend_at_their_edge(both):
    """Data go on smoothly into the collar; a clamped field does not, and moves where it is held."""
    told = replace(both, carried=Record(np.array([2.0, 4.0, 8.0]), np.array([0.05, 0.02, 0.01])))
    bare = replace(told, factors=replace(told.factors, edge=1.0))
    edge = moved_where_held(bare, lattice(9, WIDE))
    assert moved_where_held(told, lattice(9, WIDE)) == pytest.approx(edge)  # whatever it was before
    told = replace(told, factors=replace(told.factors, edge=edge))
    points, smoothly, _ = problem(told, 0.05, 0.12, interior=30)
    b = np.zeros_like(points.x)
    b[points.interior, 0] = 1e-3
    clamped = wp.Dirichlet(points, b, 0 * b)
    truth = wp.solve(told.rich, clamped).u
    coarse = told.with_doubts(points).coarse
    assert coarse.bent(smoothly) < 0.01
    first = coarse.start(b, 0 * b, 1e-3)
    off = far(first, truth, points)
    assert 0.05 < off < coarse.bent(first) < 2 * off
    for tolerance in (0.02, 0.05, 0.1):
        answer = wp.predict(told, clamped, tolerance)
        assert far(answer.u, truth, points) < answer.error < tolerance
