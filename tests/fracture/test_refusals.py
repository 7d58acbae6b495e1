"""What cracks refuse: calls, and the words that name what is wrong."""

from dataclasses import replace

import numpy as np
from numpy.linalg import inv

from examples.inclusion import Mixed
from tests.support import assert_refused, filterwarnings, warned
from tests.support.bodies import plate, solid
from tests.support.fields import double
from tests.support.problems import kernel, lattice
from warp_peri import CG, Dirichlet, Points, fracture, simulate, solve
from warp_peri.fracture import BondLaw, Cracked, Injected, j_integral, point_force, rectangle_nodes
from warp_peri.fracture.adjoint import SoftBody
from warp_peri.fracture.body import crossing_bonds
from warp_peri.fracture.dynamics import BreakingBody

X = rectangle_nodes(12.0, 12.0, 1.0)
EDGE, ENDS = np.abs(X).max(1) > 5, np.abs(X[:, 1]) > 4
POINTS, MODEL, BODY = Points(X, ~EDGE, 1.0), solid().model, plate(12, 12)
PROBLEM, LINE = Cracked(POINTS, u=X), [(-7, 0.1), (7, 0.1)]
CORRECTED = replace(PROBLEM, corrected=True)
TORN, OPEN = (replace(PROBLEM, cracks=[[(-7, 0), (end, 0)]]) for end in (7, 0))
SOFT = BondLaw(2.0, 0.05, 0.02)
SMALL = lattice(3, 2.0)
FREE, PUSHED, LATE = Cracked(POINTS), Cracked(POINTS, X), lambda t: 1 / (t < 5e-6)
HELD = np.repeat(ENDS[:, None], 2, axis=1)
at_rest = lambda solver=None, **given: lambda: solve(MODEL, Cracked(POINTS, **given), solver=solver)
softly = lambda u=X, loads=(0.1,), line=LINE, **given: (
    lambda: SoftBody(MODEL, BODY, SOFT, HELD).pull(u, loads=loads, line=line, **given)
)
crossing = lambda *corners: lambda: crossing_bonds(plate(*[4] * len(corners[0])), corners)
moving = lambda material, problem, **how: (
    lambda: simulate(material, problem, **how or {"step": 1e-6, "steps": 1})
)
j_at = lambda tip, far, material=MODEL, problem=PROBLEM: (
    lambda: j_integral(solve(material, problem), tip, (2, far))
)
released = lambda *cracks, u=X: (
    lambda: fracture.energy_release(MODEL, Cracked(POINTS, u=u), cracks, shift=0.1)
)
EVEN = lambda x: np.ones(x.shape[:-1])
MIXED, PRESSED = Mixed(3.0, lambda x: 2 * EVEN(x), EVEN), Cracked(POINTS, pressure=np.eye(2))
ONE, TWO = ([[(-9, 0), (tip, 0)]] for tip in (0, 1))


@filterwarnings("ignore:crack")
def test_what_cracks_do_not_take_is_refused_by_name():
    assert_refused({
        "with an area": crossing((0, 0, 0), (1, 0, 0), (2, 0, 0)),
        "flat": crossing((0, 0, 0), (3, 0, 0), (3, 3, 0), (0, 3, 1)),
        "convex": crossing((0, 0, 0), (3, 0, 0), (1, 1, 0), (0, 3, 0)),
        "its 0 nodes within 2 spacings span": lambda: point_force(X, 1.0, (9, 9), (1, 1)),
        "72 nodes,": at_rest(u=X, cracks=[[(-9, 0), (9, 0)]], free=~HELD | (X[:, 1:] > 0)),
        "free: expected shape": at_rest(free=~EDGE),
        "is for lattices": lambda: solve(MODEL, Cracked(Points(X, ~EDGE, 0.0))),
        r"solver: expected CG\(\) for one material": at_rest(u=X, solver=CG("sine")),
        "under pressure is solved at rest": moving(solid(), PRESSED),
        "pressure: expected one material": lambda: solve(MIXED, PRESSED),
        "half lengths that rise": lambda: Injected(POINTS, [3.0, 2.0]),
        "a BrittleMaterial with a tough": lambda: simulate(solid(), Injected(POINTS, [2.0])),
        "expected that of a Cracked, of one material": j_at((0, 0), 4, MIXED, Cracked(POINTS)),
        "tip: expected the end of a crack along an axis, got": j_at((0, 0), 4, problem=TORN),
        r"tip: .*, got \[-2.0, 0.0\]": j_at((-2, 0), 3, problem=OPEN),
        "three lengths or more a bond apart": released(ONE, TWO, [[(-9, 0), (0.95, 0)]]),
        "two lengths or more": lambda: fracture.energy_release(
            MODEL, PROBLEM, [[[(-9, 0), (tip, 0)]] for tip in (0.45, 0.55)]),
        "the same number of polylines": released(ONE, TWO, [*TWO, LINE]),
        "0 ≤ smaller < larger by a spacing of 1 or more, up to 5.5": j_at((0, 0), 9),
        "grip: expected held components": lambda: BreakingBody(solid(), BODY, grip=X),
        "corrected: expected slow growth": moving(solid(), CORRECTED, loads=[1.0], line=LINE),
        "solution: expected that of a Cracked, got": lambda: fracture.crack_opening_volume(
            solve(kernel("positive", 2.0), Dirichlet(SMALL, None, SMALL.x))),
        "factors that rise": softly(loads=[0.2, 0.1]),
        "no bond of the body crosses it": softly(line=[(-7, 40), (7, 40)]),
        "line: expected two ends, got 3": softly(line=[(-7, 0.1), (0, 0.1), (7, 2)]),
        "tail: expected > 0 for a gradient": softly(parameters={"tail": 0.0}),
        "half lengths a bond apart":
            lambda: simulate(solid(toughness=1.0), Injected(POINTS, [2.01, 2.02])),
        "nothing may break": moving(MODEL, PROBLEM, events=1, no_fail=EDGE | True),
        "u: nothing pulls": moving(fracture.SofteningMaterial(MODEL, SOFT), FREE, loads=[1.0]),
        "ramp at": moving(solid(), PUSHED, step=1e-6, steps=9, ramp=LATE, every=1, watch={"": inv}),
        "not its operator": moving(kernel("positive", 2.0).on(SMALL), Cracked(SMALL)),
        "values without a gradient": released(u=double(X).requires_grad_()),
        "cells: expected at least 2": lambda: fracture.apparent_toughness(MODEL, 1.0, cells=1),
        "of some steps": lambda: moving(solid(), FREE, step=1e-6, steps=0)().plot(),
    })  # fmt: skip
    with warned("there is no crack"):
        solve(MODEL, PRESSED)
