"""Gradients where parameters coincide or are zero, and at fields that are, of every verb."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import warp_peri as wp
from tests.conformance.test_gradients import KINKED, OPERATORS, field, torn
from tests.conformance.test_laws import third_order
from tests.gradients.cases import FLOWS, WAVES, seeded, solver_of
from tests.solvers.test_adjoint import given, loss
from tests.support.problems import difference, lattice

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")
DIFFERENCES = 1e-6
D = np.array([1.0, 0.5, 0.8])
SOLIDS = {
    "λ = μ": {"lam": 0.8, "mu": 0.8, "alpha": 0.7, "D": D},
    "λ = 0": {"lam": 0.0, "mu": 0.8, "alpha": 0.7, "D": D},
    "α = 0": {"lam": 0.3, "mu": 0.8, "alpha": 0.0, "D": D},
    "α = 1": {"lam": 0.3, "mu": 0.8, "alpha": 1.0, "D": D},
    "no D but one": {"lam": 0.3, "mu": 0.8, "alpha": 0.7, "D": np.array([0.0, 1.0, 0.0])},
    "all equal": {"lam": 1.0, "mu": 1.0, "alpha": 1.0, "D": np.ones(3)},
}
CUBIC = {"none": {"t3": 0.0, "tq2": 0.0, "q3": 0.0}}
FLOWING = {"α = 0": {"alpha": 0.0, "D": D[:2], "kappa": 1.3}}


def solid(numbers, horizon=2.0, **kept):
    return wp.LPSMaterial(**numbers, horizon=horizon, certified_on=(1.0,), **kept)


def in_the_plane(numbers):
    return solid(numbers).on(lattice(3, 2.0))


def of_broken(numbers):
    return solid(numbers, 3.0).on(torn().points)


def of_conductor(numbers):
    law = wp.diffusion.DiffusionMaterial(2.0, numbers["kappa"], numbers["alpha"], numbers["D"])
    return law.on(lattice(3, 1.0))


def of_third_order(numbers):
    return replace(third_order("energy")(), **numbers).on(lattice(3, 3.0))


KINDS = {
    "LPS": (in_the_plane, SOLIDS),
    "LPS, broken bonds": (of_broken, {"λ = μ": SOLIDS["λ = μ"]}),
    "conductor": (of_conductor, FLOWING),
    "crystal, third order": (of_third_order, CUBIC),
}
CELLS = [
    (verb, kind, case)
    for kind, (_, cases) in KINDS.items()
    for case in cases
    for verb in ("force", "solve", "simulate")
    if verb != "simulate" or kind in WAVES + FLOWS
]


def check(value, numbers):
    """Its gradient to each number, alone and with the others, is that of differences."""
    start = {n: torch.tensor(v, dtype=torch.float64) for n, v in numbers.items()}
    leaves = {name: one.clone().requires_grad_() for name, one in start.items()}
    total = value(leaves)
    together = torch.autograd.grad(total, list(leaves.values()))
    for (name, one), whole in zip(start.items(), together):
        leaf = one.clone().requires_grad_()
        (alone,) = torch.autograd.grad(value(start | {name: leaf}), leaf)
        way = torch.from_numpy(np.random.default_rng(7).normal(size=one.shape))
        step = 2e-3 * max(float(one.abs().max()), 0.1)

        def along(t, name=name, one=one, way=way):
            with torch.no_grad():
                return float(value(start | {name: one + t[0] * way}))

        slope = difference(along, [0.0], step)[0]
        size = float(whole.norm() * way.norm()) / way.numel() ** 0.5
        size = max(size, 1e-4 * abs(float(total.detach())))
        for gradient in (whole, alone):
            assert abs(float((gradient * way).sum()) - slope) <= DIFFERENCES * size, name


def general(numbers):
    """Numbers near, none of which is special."""
    shift = np.random.default_rng(5).uniform(0.01, 0.02, 20)
    return {n: v + shift[k] * (1 + np.arange(np.size(v))).reshape(np.shape(v))
            for k, (n, v) in enumerate(numbers.items())}  # fmt: skip


def value_of(verb, kind, op):
    """A number of what a verb gives, of the operator's numbers."""
    b, u = (torch.from_numpy(field(op, seed=n)) for n in (0, 1))
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


@pytest.mark.parametrize(("verb", "kind", "case"), CELLS)
def test_special_numbers_have_the_gradient_of_differences(verb, kind, case):
    """Whether they are the material's own or are given as parameters."""
    make, numbers = KINDS[kind][0], KINDS[kind][1][case]
    elsewhere = kind in ("LPS", "LPS, broken bonds") and verb != "simulate"
    for op in [make(numbers), *([make(general(numbers))] if elsewhere else [])]:
        check(value_of(verb, kind, op), numbers)
        assert op.learnable.keys() == numbers.keys()


@pytest.mark.parametrize("case", ["λ = μ", "α = 0"])
def test_cracked_bodies_have_the_gradient_of_differences(case):
    points, numbers = lattice(4, 2.0), SOLIDS[case]
    b, u = (field(solid(numbers).on(points), seed=n) for n in (0, 1))
    crack = [[(-2.0, 0.1), (1.0, 0.1)]]
    problem = wp.Cracked(points, b=b, u=u, cracks=crack, pressure=np.diag([0.01, 0.3]))
    for own in (numbers, general(numbers)):
        model = solid(own)
        check(lambda of, m=model: seeded(wp.solve(m, problem, parameters=of).u), numbers)


def test_a_number_that_two_share_is_both():
    """λ and μ as one tensor have the sum of both derivatives."""
    numbers = SOLIDS["λ = μ"]
    op = in_the_plane(numbers)
    u = torch.from_numpy(field(op))
    mu = torch.tensor(numbers["mu"], dtype=torch.float64, requires_grad=True)
    pair = [mu.detach().clone().requires_grad_() for _ in range(2)]
    values = [
        seeded(wp.solve(op, wp.Dirichlet(op.points, None, u), parameters=of).u)
        for of in ({"lam": mu, "mu": mu}, dict(zip(("lam", "mu"), pair)))
    ]
    (both,) = torch.autograd.grad(values[0], mu)
    torch.testing.assert_close(both, sum(torch.autograd.grad(values[1], pair)))


SMOOTH = [name for name in OPERATORS if not name.startswith((*KINKED, "scattered"))]


@pytest.mark.parametrize("name", SMOOTH)
@pytest.mark.parametrize("stretch", [0.0, 0.01], ids=["zero", "equal eigenvalues"])
def test_special_fields_have_the_gradient_of_differences(name, stretch):
    op = OPERATORS[name]()
    x = torch.from_numpy(op.points.x)
    u = stretch * (x if x.shape == op.shape else torch.ones(op.shape, dtype=x.dtype))
    leaf = u.clone().requires_grad_()
    seed = torch.from_numpy(np.random.default_rng(1).normal(size=op(u).shape))
    (gradient,) = torch.autograd.grad((seed * op(leaf)).sum(), leaf)
    way = torch.from_numpy(field(op, seed=3))
    slope = difference(lambda t: float((seed * op(u + t[0] * way)).sum()), [0.0], 0.1)[0]
    assert abs(float((gradient * way).sum()) - slope) <= DIFFERENCES * abs(slope)


def test_bonds_of_half_the_collar_say_what_a_gradient_needs():
    """λ = μ on a collar of δ has derivatives to all but λ and μ."""
    points, numbers = lattice(3, 1.0), SOLIDS["λ = μ"]
    op = solid(numbers).on(points)
    u = torch.from_numpy(field(op))
    problem = wp.Dirichlet(points, 0 * u, u)
    value = lambda of: seeded(wp.solve(op, problem, parameters=of).u)
    check(value, {name: numbers[name] for name in ("alpha", "D")})
    for name in ("lam", "mu"):
        leaf = torch.tensor(0.8, dtype=torch.float64, requires_grad=True)
        with pytest.raises(wp.InputError, match="expected equal values without a gradient"):
            value({name: leaf}).backward()
