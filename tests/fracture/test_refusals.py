"""What cracks refuse: calls, and the words that name what is wrong."""

import dataclasses
from functools import partial

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
    SofteningMaterial,
    crack_opening_volume,
    energy_release,
    j_integral,
    lattice_body,
    point_force,
    rectangle_nodes,
)  # fmt: skip
from warp_peri.fracture.adjoint import SoftBody
from warp_peri.fracture.body import cracked, crossing_bonds
from warp_peri.fracture.bonds import bond_weights, check_breakable
from warp_peri.fracture.dynamics import BreakingBody
from warp_peri.fracture.growth import grow
from warp_peri.fracture.run import CrackRun
from warp_peri.fracture.statics import CutSolid
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


def growing(**given):
    return lambda: grow(MODEL, BODY, **{"held": EDGE, "u": X, "events": 1} | given)


def bonds_softly(**given):
    return lambda: SoftBody(MODEL, BODY, SOFT, **{"held": HELD} | given)


def softly(u=X, loads=(0.1,), line=LINE, **given):
    return lambda: SoftBody(MODEL, BODY, SOFT, HELD).pull(u, loads=loads, line=line, **given)


def in_steps(**given):
    body = pulled()
    return lambda: CrackRun(body, **{"step": 0.4 * body.longest_step} | given)


def around(tip=(0.0, 0.0), radii=(2.0, 4.0), material=MODEL):
    problem = Cracked(Points(X, EDGE == 0, 1.0))
    return lambda: j_integral(solve(material, problem), tip, radii)


def released(*ends, **given):
    lengths = [[[(-9, 0), (d, 0)]] for d in ends]
    return lambda: energy_release(MODEL, PROBLEM, lengths, **given)


def crossing(*corners):
    return lambda: crossing_bonds(plate(*[4] * len(corners[0])), corners)


def injected(halves, points=POINTS, material=None, **given):
    made = partial(Injected, points, halves, **given)
    return made if material is None else lambda: simulate(material, made())


ONE = lambda x: np.ones(x.shape[:-1])
MIXED = Mixed(3.0, lambda x: 2 * ONE(x), ONE)
REFUSED = {
    "polyline": (crossing((0, 0)), "crack: expected corners of shape"),
    "no length": (crossing((0, 0), (0, 0)), "crack: expected segments with a length"),
    "polygon": (crossing((0, 0, 0), (1, 0, 0)), "corners of shape"),
    "no area": (crossing((0, 0, 0), (1, 0, 0), (2, 0, 0)), "with an area"),
    "bent": (crossing((0, 0, 0), (3, 0, 0), (3, 3, 0), (0, 3, 1)), "flat"),
    "hollow": (crossing((0, 0, 0), (3, 0, 0), (1, 1, 0), (0, 3, 0)), "convex"),
    "words": (lambda: cracked(BODY, [[("a", 0), (1, 0)]]), "crack: expected float values"),
    "twice": (lambda: lattice_body([*X, X[0]], 1.0, 2.0), "1 duplicates"),
    "off": (lambda: lattice_body([*X, (0.2, 0.0)], 1.0, 2.0), "square lattice of spacing"),
    "sides": (lambda: rectangle_nodes(4.5, 4, 1.0), "sides: expected multiples"),
    "place": (lambda: point_force(X, 1.0, (9, 9), (1, 1)), "span the space within 2 spacings"),
    "loose": (growing(held=EDGE & False), "against 0 of its 3 rigid motions"),
    "in two": (at_rest(u=X, cracks=[[(-9, 0), (9, 0)]], free=~HELD | (X[:, 1:] > 0)), "72 nodes,"),
    "no_fail": (growing(no_fail=EDGE.astype(int)), "no_fail: expected bool values, got int"),
    "sign": (
        lambda: check_breakable(WILD, bond_classes(1.0, 4.0)),
        f"changes sign .* from {bond_weights(WILD, bond_classes(1.0, 4.0)).min():.4g} to",
    ),
    "options": (lambda: solve(MODEL, PROBLEM, transfer=False), "options among none, got transfer"),
    "steps": (lambda: simulate(solid(), PROBLEM, step=1.0), "expected steps too"),
    "every": (lambda: simulate(solid(), PROBLEM, events=2, every=3), "among events, .* got every"),
    "loads": (
        lambda: simulate(solid(), PROBLEM, loads=[1.0], line=LINE),
        "a SofteningMaterial for loads",
    ),
    "brittle": (lambda: simulate(MODEL, PROBLEM, **STEP), "a BrittleMaterial for steps"),
    "b": (lambda: simulate(solid(), Cracked(POINTS, X), events=2), "b: slow growth and pulls"),
    "free": (at_rest(free=~EDGE), "free: expected shape"),
    "scattered": (lambda: solve(MODEL, Cracked(Points(X, ~EDGE, 0.0))), "is for lattices"),
    "units": (
        lambda: solve(MODEL, Cracked(Points(X, ~EDGE, 1.0, units=("m", "Pa")))),
        "units: the model is in",
    ),
    "nothing": (lambda: solve(None, PROBLEM), "expected a solid with a linear part"),
    "shape": (at_rest(u=X[:, 0]), r"u: expected shape \[144, 2\]"),
    "finite": (at_rest(u=X + np.nan), "u: expected finite values"),
    "solver": (
        lambda: CutSolid(WILD, BODY, EDGE, solver=CG()),
        r"solver: expected CG\(\) for one material",
    ),
    "sine": (at_rest(u=X, solver=CG("sine")), r"solver: expected CG\(\) for one material"),
    "stress": (at_rest(cracks=CRACK, pressure=[[0, 1], [0, 0]]), "stress: expected a symmetric"),
    "pressure": (at_rest(cracks=CRACK, pressure=np.eye(3)), "pressure: expected shape"),
    "moves": (
        lambda: simulate(solid(), Cracked(POINTS, pressure=np.eye(2)), **STEP),
        "under pressure is solved at rest",
    ),
    "mixed": (
        lambda: solve(MIXED, Cracked(POINTS, pressure=np.eye(2))),
        "pressure: expected one mat",
    ),
    "normal": (
        lambda: crack_opening_volume(solve(MODEL, Cracked(POINTS, cracks=CRACK)), (0.7, 0.7)),
        "normal: expected one along an axis",
    ),
    "halves": (injected([3.0, 2.0]), "half lengths that rise"),
    "short": (injected([1.0]), "half lengths that rise"),
    "none": (injected([]), "half lengths that rise"),
    "beyond": (injected([2.0, 5.0]), "crack: expected .* half lengths up to"),
    "apart": (
        injected([2.0], dataclasses.replace(POINTS, x=X + np.array([0, 100]))),
        "expected a body on both sides of its plane y = 0",
    ),
    "leak": (injected([2.0], leak=-1.0), "leak: expected a number ≥ 0"),
    "no toughness": (injected([2.0], material=solid()), "expected a BrittleMaterial with a tough"),
    "radii": (around(radii=(4.0, 4.0)), "smaller < larger by a spacing of 1"),
    "room": (around(tip=(4.0, 0.0)), "more than from the tip to the edge"),
    "J mixed": (around(material=MIXED), "expected that of a Cracked, of one material"),
    "lengths": (released(0), "two lengths or more"),
    "three": (released(-1, 1, shift=0.1), "three lengths or more"),
    "no pull": (
        lambda: energy_release(MODEL, Cracked(POINTS), [CRACK, CRACK]),
        "nothing pulls at it",
    ),
    "grip": (lambda: BreakingBody(solid(), BODY, grip=X), "grip: expected held components"),
    "criterion": (lambda: solid(toughness=1.0, critical_stretch=0.1), "criterion: expected one of"),
    "step": (in_steps(step=1e3), "step: expected at most .*whatever breaks"),
    "region": (in_steps(regions={"far": np.zeros(384, bool)}), "region far: expected one node"),
    "few": (in_steps(regions={"few": np.ones(3, bool)}), "region few: expected shape"),
    "far": (in_steps(sections={"far": [(-9, 99), (9, 99)]}), "section far: expected a line"),
    "crooked": (in_steps(sections={"a": [(-9, 0), (0, 0), (9, 8)]}), "section: expected two ends"),
    "tensor": (
        lambda: simulate(solid(), Cracked(POINTS, LEAF), **STEP),
        "expected tensors without a gradient",
    ),
    "parameters": (
        lambda: simulate(solid(), PROBLEM, parameters={"mu": 1.0}, **STEP),
        "expected tensors without a gradient",
    ),
    "corrected loads": (
        lambda: simulate(solid(), CORRECTED, loads=[1.0], line=LINE),
        "corrected: expected slow growth",
    ),
    "corrected sections": (
        lambda: simulate(solid(), CORRECTED, sections={"across": LINE}, **STEP),
        "corrected: .* without sections",
    ),
    "corrected energy": (
        lambda: simulate(BY_ENERGY, CORRECTED, **STEP),
        "corrected: .* whose bonds break at a stretch",
    ),
    "waves": (
        lambda: simulate(WILD, PROBLEM, density=1e3, **STEP),
        "simulate: expected one material with",
    ),
    "dilatation": (lambda: SofteningMaterial(solid(0.5).model, SOFT), "expected λ = μ"),
    "softness": (lambda: BondLaw(-1.0), "softness: expected a number ≥ 0"),
    "stretch": (lambda: BondLaw(1.0, 0.0), "stretch: expected a number > 0"),
    "tail": (lambda: BondLaw(1.0, 0.1, np.inf), "tail: expected a number ≥ 0"),
    "at_horizon": (lambda: BondLaw(1.0).at_horizon(2.0), "at_horizon: expected"),
    "soft loose": (bonds_softly(held=HELD & False), "against 0 of its 3 rigid motions"),
    "soft no_fail": (bonds_softly(no_fail=np.ones(3, bool)), "no_fail: expected shape"),
    "no loads": (softly(loads=[]), "one factor or more"),
    "falling": (softly(loads=[0.2, 0.1]), "factors that rise"),
    "u": (softly(X[:, 0]), "u: expected shape"),
    "nan": (softly(X * np.nan), "u: expected finite"),
    "no bond": (softly(line=[(-7, 40), (7, 40)]), "no bond of the body crosses it"),
    "two ends": (softly(line=[(-7, 0.1), (0, 0.1), (7, 2)]), "line: expected two ends, got 3"),
    "numbers": (softly(parameters={"mu": 1.0}), "parameters: expected softness, stretch, tail"),
    "no tail": (softly(parameters={"tail": 0.0}), "tail: expected > 0 for a gradient"),
    "two": (softly(parameters={"softness": torch.ones(2)}), "softness: expected one number, got"),
}


@pytest.mark.filterwarnings("ignore:crack")
@pytest.mark.parametrize(("call", "words"), REFUSED.values(), ids=REFUSED)
def test_is_refused_by_name(call, words):
    with pytest.raises(InputError, match=words):
        call()
