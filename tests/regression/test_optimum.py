"""SLSQP on the reduced loss: what it asks for is worked out once."""

import numpy as np
from scipy.optimize import minimize

from tests.support.problems import kernel, lattice, manufactured
from warp_peri.lps.symbol import symbol, zone_wedge
from warp_peri.regression import optimum
from warp_peri.regression.conditions import Conditions, LatticeConditions
from warp_peri.regression.losses import reduce, sample_weights
from warp_peri.regression.parameters import Parameters

HORIZON = 3.0


def test_a_point_is_worked_out_once_for_the_loss_the_conditions_and_their_slopes(monkeypatch):
    points = manufactured(kernel("sign-changing", HORIZON), lattice(4, HORIZON), 2)
    reduced = reduce(points, HORIZON, sample_weights([points], normalise=False)[0])
    start = Parameters(0.3, 0.5, 1.0, np.ones(4))
    coordinates = optimum.coordinates_of([reduced.classes], start, two_functions=False)
    asked = [LatticeConditions(reduced.classes, Conditions(zeta=0.01))]
    problem = optimum.ConstrainedProblem([reduced], asked, coordinates, (0.2, 0.6))
    counts = {"point": 0, "slopes": 0}
    results = []

    def counted(name, function):
        def call(*arguments):
            counts[name] += 1
            return function(*arguments)

        return call

    def watched(*arguments, **options):
        counts.update(point=0, slopes=0)
        results.append((minimize(*arguments, **options), dict(counts)))
        return results[-1][0]

    monkeypatch.setattr(optimum, "minimize", watched)
    coordinates.point = counted("point", coordinates.point)
    problem.slopes = counted("slopes", problem.slopes)
    problem.solve(coordinates.start(start), [symbol(reduced.classes, zone_wedge(1.0, 6))])
    ((result, during),) = results
    assert result.nfev > result.njev > 5
    assert during["slopes"] == result.njev
    assert during["point"] <= result.nfev + 1
