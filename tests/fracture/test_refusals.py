"""What cracks refuse: calls, and the words that name what is wrong."""

import dataclasses

import numpy as np
import pytest
import torch

from examples.inclusion import Mixed
from tests.support.bodies import plate, pulled, solid
from tests.support.problems import kernel
from warp_peri import CG, InputError, Points, simulate, solve
from warp_peri.fracture import (
    BondLaw,
    Cracked,
    Injected,
    j_integral,
    point_force,
    rectangle_nodes,
)  # fmt: skip
from warp_peri.fracture.adjoint import SoftBody
from warp_peri.fracture.body import crossing_bonds
from warp_peri.fracture.bonds import bond_weights, check_breakable
from warp_peri.fracture.dynamics import BreakingBody, CrackRun
from warp_peri.points.families import bond_classes

X = rectangle_nodes(12.0, 12.0, 1.0)
EDGE, ENDS = np.abs(X).max(axis=1) > 5, np.abs(X[:, 1]) > 4
POINTS, MODEL, BODY = Points(X, ~EDGE, 1.0), solid().model, plate(12, 12)
PROBLEM, CRACK, LINE = Cracked(POINTS, u=X), [[(-3, 0), (3, 0)]], [(-7, 0.1), (7, 0.1)]
CORRECTED, STEP = dataclasses.replace(PROBLEM, corrected=True), {"step": 1e-6, "steps": 1}
BY_ENERGY = dataclasses.replace(solid(), critical_stretch=None, critical_energy=1.0)
WILD, SOFT = kernel("sign-changing", 3.0), BondLaw(2.0, 0.05, 0.02)
HELD = np.repeat(ENDS[:, None], 2, axis=1)
DIAGONAL, LEAF = np.eye(2)[0] + [0, 1], torch.zeros(X.shape).double().requires_grad_()


def at_rest(solver=None, **given):
    return lambda: solve(MODEL, Cracked(POINTS, **given), solver=solver)


def softly(u=X, loads=(0.1,), line=LINE, **given):
    return lambda: SoftBody(MODEL, BODY, SOFT, HELD).pull(u, loads=loads, line=line, **given)


def crossing(*corners):
    return lambda: crossing_bonds(plate(*[4] * len(corners[0])), corners)


ONE = lambda x: np.ones(x.shape[:-1])
MIXED = Mixed(3.0, lambda x: 2 * ONE(x), ONE)
REFUSED = {
    "polyline": (crossing((0, 0)), "crack: expected corners of shape"),
    "no area": (crossing((0, 0, 0), (1, 0, 0), (2, 0, 0)), "with an area"),
    "bent": (crossing((0, 0, 0), (3, 0, 0), (3, 3, 0), (0, 3, 1)), "flat"),
    "hollow": (crossing((0, 0, 0), (3, 0, 0), (1, 1, 0), (0, 3, 0)), "convex"),
    "place": (
        lambda: point_force(X, 1.0, (9, 9), (1, 1)),
        "its 0 nodes within 2 spacings span no space",
    ),
    "in two": (at_rest(u=X, cracks=[[(-9, 0), (9, 0)]], free=~HELD | (X[:, 1:] > 0)), "72 nodes,"),
    "sign": (
        lambda: check_breakable(WILD, bond_classes(1.0, 4.0)),
        f"changes sign .* from {bond_weights(WILD, bond_classes(1.0, 4.0)).min():.4g} to",
    ),
    "free": (at_rest(free=~EDGE), "free: expected shape"),
    "scattered": (lambda: solve(MODEL, Cracked(Points(X, ~EDGE, 0.0))), "is for lattices"),
    "sine": (at_rest(u=X, solver=CG("sine")), r"solver: expected CG\(\) for one material"),
    "stress": (at_rest(cracks=CRACK, pressure=[[0, 1], [0, 0]]), "stress: expected a symmetric"),
    "moves": (
        lambda: simulate(solid(), Cracked(POINTS, pressure=np.eye(2)), **STEP),
        "under pressure is solved at rest",
    ),
    "mixed": (
        lambda: solve(MIXED, Cracked(POINTS, pressure=np.eye(2))),
        "pressure: expected one mat",
    ),
    "halves": (lambda: Injected(POINTS, [3.0, 2.0]), "half lengths that rise"),
    "no toughness": (
        lambda: simulate(solid(), Injected(POINTS, [2.0])),
        "expected a BrittleMaterial with a tough",
    ),
    "J mixed": (
        lambda: j_integral(solve(MIXED, Cracked(POINTS)), (0, 0), (2, 4)),
        "expected that of a Cracked, of one material",
    ),
    "J at no tip": (
        lambda: j_integral(solve(MODEL, PROBLEM), (0, 0), (2, 4)),
        "tip: expected the end of a crack along an axis",
    ),
    "J too large": (
        lambda: j_integral(solve(MODEL, PROBLEM), (0, 0), (2, 9)),
        "radii: expected 0 ≤ smaller < larger by a spacing of 1 or more, up to 5.5",
    ),
    "grip": (lambda: BreakingBody(solid(), BODY, grip=X), "grip: expected held components"),
    "far": (
        lambda: CrackRun(pulled(), step=1e-6, sections={"far": [(-9, 99), (9, 99)]}),
        "section far: expected nodes, or a line that bonds cross",
    ),
    "tensor": (
        lambda: simulate(solid(), Cracked(POINTS, LEAF), **STEP),
        "expected tensors without a gradient",
    ),
    "corrected loads": (
        lambda: simulate(solid(), CORRECTED, loads=[1.0], line=LINE),
        "corrected: expected slow growth",
    ),
    "corrected energy": (
        lambda: simulate(BY_ENERGY, CORRECTED, **STEP),
        "corrected: .* whose bonds break at a stretch",
    ),
    "at_horizon": (lambda: BondLaw(1.0).at_horizon(2.0), "at_horizon: expected"),
    "falling": (softly(loads=[0.2, 0.1]), "factors that rise"),
    "no bond": (softly(line=[(-7, 40), (7, 40)]), "no bond of the body crosses it"),
    "two ends": (softly(line=[(-7, 0.1), (0, 0.1), (7, 2)]), "line: expected two ends, got 3"),
    "no tail": (softly(parameters={"tail": 0.0}), "tail: expected > 0 for a gradient"),
}


@pytest.mark.filterwarnings("ignore:crack")
@pytest.mark.parametrize(("call", "words"), REFUSED.values(), ids=REFUSED)
def test_is_refused_by_name(call, words):
    with pytest.raises(InputError, match=words):
        call()
