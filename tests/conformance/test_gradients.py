"""Torch through every material: gradients, second ones, tangents, batches, precisions, copies."""

from copy import copy, deepcopy
from dataclasses import replace
from pickle import dumps, loads
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import warp
from torch.autograd import forward_ad, functional, grad, gradgradcheck

import warp_peri as wp
from tests.support import filterwarnings, masked, near, parametrize
from tests.support.fields import double, field, seeded, tensor, tensors
from tests.support.materials import CRACK, LAWS, LINEAR, OPERATORS, operator
from tests.support.problems import kernel, lattice, normal
from tests.support.solving import solve
from tests.support.told import all_refused, assert_refused, refused
from warp_peri.errors import ALONE

pytestmark = filterwarnings("ignore::UserWarning")
OTHERS = [name for name in OPERATORS if name not in LINEAR]
SOLID = {"lam", "mu", "alpha", "D"}
HEAT = {"kappa", "alpha", "D"}
MODULES = {
    **dict.fromkeys(("LPS", "LPS, bond-based", "LPS in space", "scattered, own weights"), SOLID),
    "third order, filtered": {"t3", "tq2", "q3"},
    "crystal": {"tensors"},
    "density": {"lam", "mu"},
    "hyperelastic": {"coefficients"},
    "conductor": HEAT,
    "cut": SOLID,
    "coupled": SOLID | {"coupling"} | {f"conductor_{name}" for name in HEAT},
}


@pytest.fixture
def op(name):
    return operator(name)


@parametrize("name", LINEAR)
def test_second_derivatives_of_a_linear_force(op):
    u, v = tensors(op)
    assert gradgradcheck(op, (u.clone().requires_grad_(),), fast_mode=True)
    energy = lambda u: (op(u) ** 2).sum() / 2
    expected = op.vjp(u.numpy(), op(v.numpy()))
    for second in (functional.hvp, functional.vhp):
        near(second(energy, u, v)[1], expected, 1e-12)


def test_a_gradient_beside_a_tape_of_the_user():
    op = operator("LPS, broken bonds")
    u = tensor(op).requires_grad_()
    expected = grad(op(u).sum(), u)[0]
    with warp.Tape():
        assert torch.equal(grad(op(u).sum(), u)[0], expected)


def test_networks_that_learn_have_second_derivatives():
    op = operator("neural operator")
    u = tensor(op).requires_grad_()
    v = torch.from_numpy(normal(u.shape))
    slope = lambda u, **how: grad(op(u).square().sum(), u, **how)[0]
    (second,) = grad((slope(u, create_graph=True) * v).sum(), u)
    there, back = (slope((u + s * v).detach().requires_grad_()) for s in (1e-6, -1e-6))
    near(second, (there - back) / 2e-6, 1e-6)


@parametrize("name", [name for name in OTHERS if name != "neural operator"])
def test_second_derivatives_of_others_are_refused(op, name):
    u = tensor(op).requires_grad_()
    v = torch.ones_like(u)
    penalised = lambda u: op(u).square().sum() + u.pow(4).sum()
    (first,) = grad(penalised(u), u, create_graph=True)
    (plain,) = grad(penalised(u), u)
    assert torch.equal(first, plain)
    assert_refused({"second derivative": (
        lambda: grad(first.square().sum(), u, retain_graph=True),
        lambda: first.square().sum().backward(),
        lambda: functional.hvp(penalised, u.detach(), v),
        lambda: functional.vhp(penalised, u.detach(), v),
    )})  # fmt: skip
    if not hasattr(op, "solve") or "filtered" in name:
        return
    held = (0.01 * u).detach().requires_grad_()
    answer = solve(op, op.points, 0 * held.detach(), held)
    (first,) = grad(answer.square().sum(), held, create_graph=True)
    with refused("second derivative"):
        first.sum().backward()


@parametrize("name", OPERATORS)
def test_batches_and_precisions(op):
    u = tensor(op, 2, 3).requires_grad_()
    force = op(u)
    assert force.shape[:2] == (2, 3)
    (by_u,) = grad(force.square().sum(), u)
    whole, one = force.detach(), u[1, 2].detach().requires_grad_()
    size = whole.abs().max()
    alone = op(one)
    near(alone.detach(), whole[1, 2], 1e-13, size)
    (by_one,) = grad(alone.square().sum(), one)
    near(by_one, by_u[1, 2], 1e-12, by_u.abs().max())
    near(op(u[0].detach().numpy()), whole[0], 1e-13, size)
    single = u.detach().float().requires_grad_()
    lower = op(single)
    assert lower.dtype == torch.float32
    assert torch.equal(lower, op(single.double()).float())
    (by_single,) = grad(lower.square().sum(), single)
    assert by_single.dtype == torch.float32
    near(by_single, by_u, 1e-3)
    assert torch.equal(op(u.detach().movedim(0, -1).contiguous().movedim(-1, 0)), force)
    short = u[..., :-1, :] if len(op.shape) == 2 else u[..., :-1]
    wrong = short, u[0, 0, 0], u[:0], u.detach().long()
    all_refused(op, "u: expected float64 of shape", wrong)
    all_refused(op, "expected", [one.detach().numpy()[:, 0] for one in (short, u[:0])])


class Forces(list):
    """Forces of operators by their names, which a worker works out."""

    def __getitem__(self, number):
        op = operator(super().__getitem__(number))
        with torch.no_grad():
            force = op(tensor(op).requires_grad_())
        return force, force.requires_grad


def test_workers_of_a_loader_have_the_forces_of_this_process():
    forces = Forces(OPERATORS)
    loader = torch.utils.data.DataLoader(forces, batch_size=None, num_workers=1, timeout=100)
    for number, (there, learns) in enumerate(loader):
        assert torch.equal(there, forces[number][0])
        assert not learns


@parametrize("name", ["crystal", "third order, energy"])
def test_torch_compile_leaves_a_force_as_it_is(op):
    value, u = lambda u: op(2 * u).square().sum(), tensor(op).requires_grad_()
    torch.compiler.reset()
    whole = torch.compile(value, backend="eager")(u)
    assert torch.equal(*(grad(one, u)[0] for one in (whole, value(u))))


@parametrize("name", OPERATORS)
def test_a_solve_changes_nothing_and_copies_are_made_anew(op):
    before = op(u := field(op))
    closed = op.points.interior.all()
    given = 0 * u, 0.01 * u
    wp.solve(op, wp.Periodic(op.points, before) if closed else wp.Dirichlet(op.points, *given))
    assert np.array_equal(op(u), before)
    for other in (copy(op), deepcopy(op), loads(dumps(op))):
        assert type(other) is type(op)
        assert other is not op
        near(other(u), op(u), 0)
        near(other.points.x, op.points.x, 0)


def test_a_copy_keeps_neither_samples_nor_what_was_changed_since():
    law, points = OPERATORS["conductor"]().model, lattice(4, 1.5)
    kappa = np.ones(len(points.x), ">f8")[::-1]  # of any kind of array
    op = law.on(points, kappa=kappa)
    u = field(op)
    kappa[:] = 2.0
    assert not op.learnable["kappa"].flags.writeable
    near(deepcopy(op)(u), op(u), 0)
    points = lattice(4, 3.0)
    samples = wp.Samples(points, np.zeros((100, *points.x.shape)))
    plain, of_samples = (dumps(LAWS["LPS"].material().on(on)) for on in (points, samples))
    assert len(of_samples) == len(plain)


def test_what_is_changed_before_a_backward_pass_is_told():
    op = OPERATORS["hyperelastic"]()
    twice = 2 * tensor(op).requires_grad_()
    value = op(twice).sum()
    twice.detach().add_(1)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        value.backward()


@parametrize("name", [*MODULES, "neural operator"])
def test_a_module_learns_the_numbers_of_its_material_and_is_saved_and_copied(name, tmp_path):
    op = deepcopy(operator(name))
    module, u = wp.TorchModule(op, op.points), tensor(op).requires_grad_()
    if name in MODULES:
        assert {key for key, _ in module.named_parameters()} == MODULES[name]
    force = op(u)
    near(module(u).detach(), force.detach(), 1e-12)
    by_u, *_ = grad(seeded(module(u)), [u, *module.parameters()])
    near(by_u, grad(seeded(force), u)[0], 1e-10)
    with torch.no_grad():
        for number in module.parameters():
            number.mul_(1.01)
    other, u = wp.TorchModule(deepcopy(operator(name)), op.points), u.detach()
    other.load_state_dict(module.state_dict())
    torch.save(module, tmp_path / "m.pt")
    for one in (other, deepcopy(module), torch.load(tmp_path / "m.pt", weights_only=False)):
        assert torch.equal(one(u), module(u))
    assert torch.equal(torch.as_tensor(module(u.numpy())), module(u))
    near(module.float()(u.float()).detach(), other(u).detach(), 1e-5)


@parametrize("name", ["LPS", "crystal", "conductor"])
def test_what_a_solve_takes_and_tells(op, name):
    b, u = tensors(op, 2)
    solution = lambda b, u: wp.solve(op, wp.Dirichlet(op.points, b, u))
    wrong = (b, u[0]), (b[0], u), (b[:, :-1], u[:, :-1]), (b + 0j, u), (b, u + 0j)
    all_refused(solution, "[bu]: expected", wrong)
    plain, whole = solution(b.numpy(), 0 * u.numpy()), solution(b, torch.zeros(u.shape).long())
    near(whole.u, plain.u, 1e-9)
    told = solution(b.requires_grad_(), 0 * u)
    near(told.energy(), plain.energy(), 1e-7)
    assert "residual" in repr(told)
    if name != "conductor":
        near(told.stress(), plain.stress(), 1e-8, 1)
        assert told.plot().get_title()


@parametrize("solver", [wp.Direct(), wp.CG("sine"), None])
def test_a_second_derivative_to_numbers_is_refused(solver):
    """Where torch would drop terms; of the force without a solver."""
    op, name = operator("LPS"), ["lam", "mu", "alpha", "D"]
    b, u = tensors(op)

    def energy(*values):
        of = dict(zip(name, values))
        if solver is None:
            found = op.force_with_parameters(u[None], of)
        else:
            found = solve(op, op.points, b, u, solver=solver, parameters=of)
        return found.square().sum() + sum(value.square().sum() for value in values)

    values = [torch.as_tensor(op.learnable[n]).double() for n in name]
    with refused("second derivative"):
        functional.hessian(energy, tuple(values))
    leaves = [value.requires_grad_() for value in values]
    first = grad(energy(*leaves), leaves, create_graph=True)
    again = lambda one: grad(one.sum(), leaves, retain_graph=True, allow_unused=True)
    all_refused(again, "second derivative", first)


def along(call, x):
    """What a call makes of a tensor with a tangent of forward mode."""
    with forward_ad.dual_level():
        return call(forward_ad.make_dual(x, torch.ones_like(x)))


def test_what_would_lose_a_gradient_says_so():
    op, network, heat = map(operator, ("LPS", "neural operator", "conductor"))
    points = op.points
    u, phi = (tensor(one) for one in (op, heat))
    number = double(0.5)
    leaf, learns = u.clone().requires_grad_(), number.clone().requires_grad_()
    module, on = wp.TorchModule(op, points), lambda u: wp.Dirichlet(points, None, u)
    broken = wp.TorchModule(deepcopy(op), points)
    with torch.no_grad():
        broken.mu.fill_(-1.0)
    cut, solid = wp.Cracked(points, u=leaf, cracks=CRACK), kernel("1/r", 3.0)
    waves, steps = {"density": 2000.0, "step": 1e-6, "steps": 2}, {"step": 1.0, "steps": 2}
    hidden = masked(u.numpy())
    forces, many = module(leaf), module(torch.stack([u, u]))
    rest = lambda u, **how: wp.solve(op, on(u), **how).u
    of_mu = lambda mu: rest(u, parameters={"mu": mu})
    moved = lambda u, **how: wp.simulate(op, on(u), **waves, **how).u
    slope, plain = (lambda f, x: torch.func.grad(lambda x: f(x).sum())(x)), r"torch\.func: expected"
    assert_refused({
        plain: (
            lambda: slope(module, u), lambda: slope(network, tensor(network)),
            lambda: slope(moved, u), lambda: slope(of_mu, number),
            lambda: slope(
                lambda phi: wp.simulate(heat, wp.Dirichlet(heat.points, None, phi), **steps).u,
                phi,
            ),
            lambda: grad(forces, leaf, many, is_grads_batched=True),
            lambda: torch.func.vmap(lambda v: grad(forces, leaf, v))(many),
        ),
        "tangents of forward mode": (
            lambda: along(op, u), lambda: along(rest, u), lambda: along(moved, u),
            lambda: along(of_mu, number),
        ),
        "gradient": (
            lambda: wp.Samples(points, leaf),
            lambda: wp.simulate(op, on(0 * u), **waves | {"density": learns}),
            lambda: op.energy(leaf), lambda: op.rhs(leaf), lambda: op.jvp(leaf, leaf),
            lambda: op.stress(leaf),
            lambda: wp.simulate(op, wp.Dirichlet(SimpleNamespace(comm=ALONE), leaf, leaf)),
        ),
        "expected tensors without a gradient": lambda: wp.simulate(solid, cut, events=1),
        "parameters: expected .* among lam .*, got kappa":
            lambda: wp.solve(solid, cut, parameters={"kappa": 1.0}),
        "among none, which corrected": lambda: wp.solve(
            solid, replace(cut, corrected=True), parameters={"mu": 1.0}
        ),
        "u: expected float values, got masked": lambda: module(hidden),
        "u: expected a dense": (lambda: op(u.to_sparse()), lambda: op(u.to("meta"))),
        "mu": lambda: broken(u),
        "expected one on the points of the problem": lambda: wp.TorchModule(op, heat.points),
        "Module: expected a material": lambda: wp.TorchModule("graphene", points),
    })  # fmt: skip
    assert module(u.tolist()).dtype == torch.float64


def test_lists_and_numbers_keep_all_their_digits():
    """Of which torch makes single precision; and what is masked or none is no number."""
    op = operator("LPS")
    b, u = tensors(op)
    mu, leaf = 1.1 * float(op.learnable["mu"]), b.clone().requires_grad_()
    solved = lambda u, mu: solve(op, op.points, leaf, u, parameters={"mu": mu})
    exact = solved(u, double(mu))
    assert torch.equal(solved(u.tolist(), mu), exact)
    hidden = masked(u.numpy())
    for wrong, said in ((None, "got None"), ("u", "got str"), (hidden, "finite")):
        with refused(f"u: expected .*{said}"):
            solved(wrong, mu)
    step = {"density": 2000.0, "step": 1e-3, "steps": 3}
    ends = [wp.simulate(op, wp.Dirichlet(op.points, b, one), **step).u for one in (u, u.tolist())]
    assert torch.equal(*ends)
