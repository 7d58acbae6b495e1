"""Gradients where parameters coincide or are zero, and at fields that are, of every verb."""

from dataclasses import replace

import numpy as np
import torch
from numpy.random import default_rng
from torch.autograd import grad

import warp_peri as wp
from tests.gradients.cases import assert_slopes, given, loss, solver_of
from tests.support import filterwarnings, parametrize, refused
from tests.support.fields import double, field, seeded, tensor, tensors
from tests.support.materials import CRACK, FLOWS, KINKED, LAWS, OPERATORS, operator
from tests.support.problems import lattice

pytestmark = filterwarnings("ignore::UserWarning")
DIFFERENCES = 1e-6
D = np.array([1.0, 0.5, 0.8])
MODULI = {"lam": 0.3, "mu": 0.8}
SOLID = MODULI | {"alpha": 0.7, "D": D}
GRADED = SOLID | {name: one * np.linspace(1, 2, 121) for name, one in MODULI.items()}
EQUAL = {"λ = μ": SOLID | {"lam": 0.8}}
SOLIDS = EQUAL | {
    "λ = α = 0": SOLID | {"lam": 0.0, "alpha": 0.0},
    "α = 1, no D but one": SOLID | {"alpha": 1.0, "D": np.array([0.0, 1.0, 0.0])},
    "all equal": {"lam": 1.0, "mu": 1.0, "alpha": 1.0, "D": np.ones(3)},
}
HEAT = {"alpha": 0.0, "D": D[:2], "kappa": 1.3}
BOTH = EQUAL["λ = μ"] | {"coupling": 0.4} | {f"conductor_{name}": HEAT[name] for name in HEAT}
solid = lambda numbers, horizon=2.0: wp.LPSMaterial(**numbers, horizon=horizon, certified_on=(1.0,))
of_torn = lambda numbers: solid(numbers, 3.0).on(operator("LPS, broken bonds").points)
of_uneven = lambda n: solid(n | MODULI).on(lattice(3, 2.0), lam=n["lam"], mu=n["mu"])
of_cubic = lambda n: replace(LAWS["third order, energy"].material(), **n).on(lattice(2, 3.0))


def of_conductor(numbers):
    law = wp.diffusion.DiffusionMaterial(2.0, numbers["kappa"], numbers["alpha"], numbers["D"])
    return law.on(lattice(3, 1.0))


def of_coupled(numbers):
    model = solid({name: numbers[name] for name in SOLID})
    law = of_conductor({name: numbers[f"conductor_{name}"] for name in HEAT}).model
    return wp.diffusion.ThermoelasticMaterial(model, law, numbers["coupling"]).on(lattice(2, 2.0))


KINDS = {
    "LPS": (lambda numbers: solid(numbers).on(lattice(3, 2.0)), SOLIDS),
    "LPS, broken bonds": (of_torn, EQUAL),
    "LPS, fields": (of_uneven, {"graded": GRADED}),
    "conductor": (of_conductor, {"α = 0": HEAT}),
    "coupled": (of_coupled, {"λ = μ": BOTH}),
    "crystal, third order": (of_cubic, {"none": {"t3": 0.0, "tq2": 0.0, "q3": 0.0}}),
}
CELLS = [
    (verb, kind, case)
    for kind, (_, cases) in KINDS.items()
    for case in cases
    for verb in ("force", "solve", "simulate")
    if verb != "simulate" or kind != "crystal, third order"
]


def gradient(value, start, *names):
    leaves = {name: start[name].clone().requires_grad_() for name in names}
    return grad(value(start | leaves), [*leaves.values()])


def check(value, numbers):
    """Its gradient to each number is that of differences, and the same alone as with the others."""
    start = {n: double(v) for n, v in numbers.items()}
    assert_slopes(value, start, 0.2, DIFFERENCES, least=0.1)
    for name, expected in zip(start, gradient(value, start, *start)):
        (alone,) = gradient(value, start, name)
        assert (alone - expected).abs().max() <= DIFFERENCES * expected.abs().max(), name


def general(numbers):
    """Numbers near, none of which is special."""
    shift = default_rng(5).uniform(0.01, 0.02, 20)
    return {n: v + shift[k] * (1 + np.arange(np.size(v))).reshape(np.shape(v))
            for k, (n, v) in enumerate(numbers.items())}  # fmt: skip


def value_of(verb, kind, op):
    """A number of what a verb gives, of the operator's numbers."""
    b, u = tensors(op)
    problem, solver = wp.Dirichlet(op.points, 0.1 * b, u), solver_of(kind, op)
    if verb == "force":
        return lambda of: seeded(op.force_with_parameters(u[None], of))
    if verb == "solve":
        return lambda of: seeded(wp.solve(op, problem, solver=solver, parameters=of).u)
    if kind in FLOWS:
        how = {"step": 0.3, "steps": 2}
        return lambda of: seeded(wp.simulate(op, problem, parameters=of, **how)["u"])
    fields, options = given(op)
    return lambda of: loss(op, fields, options | {"steps": 4, "every": 2}, of)


@parametrize(("verb", "kind", "case"), CELLS)
def test_special_numbers_have_the_gradient_of_differences(verb, kind, case):
    """Whether they are the material's own or are given as parameters."""
    make, numbers = KINDS[kind][0], KINDS[kind][1][case]
    elsewhere = kind in ("LPS", "LPS, broken bonds") and verb != "simulate"
    for op in [make(numbers), *([make(general(numbers))] if elsewhere else [])]:
        check(value_of(verb, kind, op), numbers)
        assert op.learnable.keys() == numbers.keys()


@parametrize("case", ["λ = μ", "λ = α = 0"])
def test_cracked_bodies_have_the_gradient_of_differences(case):
    points, numbers = lattice(4, 2.0), SOLIDS[case]
    b, u = (field(solid(numbers).on(points), seed=n) for n in (0, 1))
    problem = wp.Cracked(points, b=b, u=u, cracks=CRACK, pressure=np.diag([0.01, 0.3]))
    for own in (numbers, general(numbers)):
        model = solid(own)
        check(lambda of, m=model: seeded(wp.solve(m, problem, parameters=of).u), numbers)
        body = replace(problem, pressure=None).waves(model)
        fields, options = given(body)
        how = options | {"steps": 4, "every": 2}
        check(lambda of, op=body, f=fields, how=how: loss(op, f, how, of), numbers)


@parametrize("name", [name for name in OPERATORS if name not in KINKED and "scattered" not in name])
def test_fields_of_zero_and_of_equal_eigenvalues_have_the_gradient_of_differences(name):
    op = operator(name)
    x = torch.tensor(op.points.x)
    for stretch in (0.0, 0.01):
        u = stretch * (x if x.shape == op.shape else torch.ones(op.shape, dtype=x.dtype))
        value = lambda of: seeded(op(of["u"]))
        assert_slopes(value, {"u": u}, 0.1, DIFFERENCES, least=op.points.spacing)


def test_bonds_of_half_the_collar_say_what_a_gradient_needs():
    """λ = μ on a collar of δ has derivatives to all but λ and μ."""
    points, numbers = lattice(3, 1.0), SOLIDS["λ = μ"]
    op = solid(numbers).on(points)
    u = tensor(op)
    problem = wp.Dirichlet(points, 0 * u, u)
    value = lambda of: seeded(wp.solve(op, problem, parameters=of).u)
    check(value, {name: numbers[name] for name in ("alpha", "D")})
    for name in ("lam", "mu"):
        leaf = double(0.8).requires_grad_()
        with refused("expected equal values without a gradient"):
            value({name: leaf}).backward()
