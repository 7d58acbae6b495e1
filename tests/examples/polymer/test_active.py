"""A law that learns while it flows: asked where it has no data, better afterwards."""

import numpy as np
import pytest

from examples.polymer.active import LearningClosure, replayed
from examples.polymer.closure import Closure, CoupledDumbbells
from examples.polymer.dumbbells import Dumbbells, held, simulate
from examples.polymer.laws import elongation, shear
from examples.polymer.plane import PlaneFlow, run_plane
from examples.polymer.springs import learn_spring
from warp_peri import InputError

FLOW, B = PlaneFlow(1.0, 1.0, 12, force=lambda t: 12.0), 50.0


def run(fluid):
    return run_plane(FLOW, fluid, until=2.5, dt=0.0125, every=20).u


def learn(records):
    return learn_spring(records, points=80, outside="allow")


@pytest.fixture(scope="module")
def weak():
    K = np.concatenate([shear(np.array([0.5, 1.0])), elongation(np.array([0.25, 0.5]))])
    return simulate(Dumbbells(4, 1000, b=B, seed=1), held(K, 50), 0.1, steps=5)


def test_dumbbells_go_along_where_the_flow_leaves_the_data(weak):
    dumbbells = Dumbbells(12, 1500, b=B, seed=5, common=True, matched=True)
    truth = run(CoupledDumbbells(dumbbells, 1.0))
    fluid = LearningClosure([weak], learn, replayed(1000, B, 100), 1.0, 12, check_every=20)
    error = lambda u: np.linalg.norm(u - truth) / np.linalg.norm(truth)
    before, while_learning = error(run(Closure(learn([weak]), 1.0, 12))), error(run(fluid))
    assert 1 <= len(fluid.asked) <= 8
    assert len(fluid.records) == 1 + len(fluid.asked)
    assert min(row[2] for row in fluid.asked) > 1.5  # gaps of the data
    assert while_learning < 0.4 * before
    assert error(run(Closure(fluid.law, 1.0, 12))) < 0.4 * before
    with pytest.raises(InputError, match="no checkpoint"):
        fluid.state()


def test_nothing_is_asked_inside_the_data(weak):
    slow = PlaneFlow(1.0, 1.0, 12, force=lambda t: 0.5)
    fluid = LearningClosure([weak], learn, replayed(1000, B, 100), 1.0, 12)
    law = fluid.law
    run_plane(slow, fluid, until=1.0, dt=0.0125)
    assert not fluid.asked
    assert fluid.law is law
