"""Torch through every material: gradients, second ones, tangents, batches, precisions, copies."""

import copy
import pickle
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import warp
from torch.autograd import forward_ad, functional, gradgradcheck

import warp_peri as wp
from tests.conformance.test_laws import LAWS, network
from tests.points.test_interpolation import cloud
from tests.support import cubes
from tests.support.problems import kernel, lattice
from warp_peri.crystals import crystal_from_lps
from warp_peri.files.checkpoint import ALONE
from warp_peri.fracture import lattice_body
from warp_peri.fracture.statics import CutSolid

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")
KINKED = ("neural operator",)
"""Of which a step of differences is short."""
NONLINEAR = ("third order", "neural", "hyperelastic", "density")


def scattered():
    x = cloud(11, 0.45, seed=3).x
    points = wp.Points(x, np.abs(x).max(axis=1) <= 2.0, 0.0)
    return kernel("1/r", 3.0).on(points, allow_uncertified=True)


def torn():
    """An LPS whose bonds to nodes outside of the body are broken."""
    points = lattice(5, 3.0)
    outside = points.x[:, 0] > 2.5
    model = kernel("sign-changing", 3.0)
    return model.on(replace(points, outside=outside, interior=points.interior & ~outside))


def conductor():
    points = lattice(4, 1.5)
    law = wp.diffusion.DiffusionMaterial(3.0, 1.3, 0.7, np.array([1.0, 0.4]))
    return law.on(points, kappa=np.exp(0.3 * np.sin(points.x[:, 0])))


def coupled():
    model = wp.LPSMaterial(1.0, 0.8, 1.0, [1.0, 0.6], horizon=3.0)
    conductor = wp.diffusion.DiffusionMaterial(3.0, D=np.array([1.0, 0.4]))
    law = wp.diffusion.ThermoelasticMaterial(model, conductor, 0.4, 1.0)
    return law.on(lattice(4, 3.0))


def cut():
    """A cracked body, one node of which is held along one axis."""
    points, model = lattice(4, 3.0), wp.LPSMaterial(0.9, 0.4, 1.0, [1.0, 0.6, 0.3], horizon=3.0)
    held = np.repeat(~points.interior[:, None], 2, axis=1)
    held[np.flatnonzero(points.interior)[3], 0] = True
    crack = [[(-2.0, 0.1), (1.0, 0.1)]]
    return CutSolid(model, lattice_body(points.x, 1.0, 3.0), held, cracks=crack)


def frozen():
    """A network of single precision whose numbers ask for no gradient."""
    return network().requires_grad_(False).on(LAWS["neural operator"].points(4))


def in_space(of=lambda model: model):
    model = replace(cubes.solid(2.0, 0.5, 0.8, D=[1.0, 0.6, 1.4]), certified_on=(1.0,))
    return of(model).on(cubes.cube(2, 2.0))


OPERATORS = {
    name: lambda law=law: law.material().on(law.points(4)) for name, law in LAWS.items()
} | {
    "crystal, periodic": lambda: LAWS["crystal"].material().on(LAWS["crystal"].sheet()),
    "neural operator, frozen": frozen,
    "scattered, own weights": scattered,
    "LPS, broken bonds": torn,
    "LPS in space": in_space,
    "crystal in space": lambda: in_space(lambda model: crystal_from_lps(model, 1.0)),
    "conductor": conductor,
    "coupled": coupled,
    "cut": cut,
}
LINEAR = [name for name in OPERATORS if not any(word in name for word in NONLINEAR)]
OTHERS = [name for name in OPERATORS if name not in LINEAR]


@pytest.fixture(scope="module")
def made():
    """Every operator once."""
    kept = {}
    return lambda name: kept.setdefault(name, OPERATORS[name]())


def test_the_operators_are_what_they_are_called(made):
    assert len(made("LPS, broken bonds").bonds.families.cut) > 0
    assert not made("coupled").is_symmetric


def field(op, *lead, seed=0):
    """Fields with gradients of some percent, rough and smooth."""
    size = 0.01 * getattr(op.points, "spacing", 0) or 0.01
    u = size * np.random.default_rng(seed).normal(size=(*lead, *op.shape))
    return u + 2 * size * np.sin(op.points.x[:, 0]).reshape(-1, *[1] * (len(op.shape) - 1))


def loss(op, u):
    """A number of a force, with a field of seeds so that nothing cancels."""
    force = op(u)
    seed = torch.from_numpy(np.random.default_rng(1).normal(size=force.shape))
    return ((0.3 * force + seed) * force).sum()


@pytest.mark.parametrize("name", OPERATORS)
def test_product_and_its_transpose_are_one_matrix(name, made):
    op = made(name)
    u, v = field(op, 2), field(op, 2, seed=5)
    rate = op.jvp(u, v)
    w = np.random.default_rng(2).normal(size=rate.shape)
    back = op.vjp(u, w)
    assert back.shape == v.shape
    size = np.linalg.norm(rate) * np.linalg.norm(w)
    assert abs((rate * w).sum() - (v * back).sum()) <= 1e-12 * size
    assert np.allclose(op.vjp(u[0], w[0]), back[0], rtol=1e-10, atol=0)


@pytest.mark.parametrize("name", LINEAR)
def test_second_derivatives_of_a_linear_force(name, made):
    op = made(name)
    u, v = (torch.from_numpy(field(op, seed=n)) for n in (0, 1))
    assert gradgradcheck(op, (u.clone().requires_grad_(),), fast_mode=True)

    def energy(u):
        return (op(u) ** 2).sum() / 2

    _, along = functional.hvp(energy, u, v)
    expected = op.vjp(u.numpy(), op(v.numpy()))
    assert np.allclose(along, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    _, forward = functional.vhp(energy, u, v)
    assert np.allclose(forward, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_a_gradient_beside_a_tape_of_the_user(made):
    op = made("LPS, broken bonds")
    u = torch.from_numpy(field(op)).requires_grad_()
    expected = torch.autograd.grad(op(u).sum(), u)[0]
    with warp.Tape():
        assert torch.equal(torch.autograd.grad(op(u).sum(), u)[0], expected)


@pytest.mark.parametrize("name", ["crystal", "third order, energy"])
def test_torch_func_maps_over_fields(name, made):
    op = made(name)
    u, many = torch.from_numpy(field(op)), torch.from_numpy(field(op, 3))
    for dim in (0, 1):
        assert torch.equal(torch.func.vmap(op, dim)(many.movedim(0, dim)), op(many))
    unit = torch.eye(u.numel(), dtype=u.dtype).reshape(-1, *u.shape).numpy()
    J = op.jvp(np.broadcast_to(u, unit.shape), unit).reshape(len(unit), -1).T
    for jacobian in (torch.func.jacrev, torch.func.jacfwd):
        assert np.allclose(jacobian(op)(u).reshape(J.shape), J, rtol=0, atol=1e-13 * abs(J).max())
    hessian = torch.func.hessian(lambda u: op(u).square().sum() / 2)
    if name in LINEAR:
        found, H = hessian(u).reshape(len(unit), -1), J.T @ J
        assert np.allclose(found, H, rtol=0, atol=1e-12 * abs(H).max())
    else:
        with pytest.raises(wp.InputError, match="second derivative"):
            hessian(u)


def test_torch_func_is_refused_where_it_would_lose_a_gradient(made):
    op, network, heat = map(made, ("LPS", "neural operator", "conductor"))
    u, phi = (torch.from_numpy(field(one)) for one in (op, heat))
    number, module = torch.tensor(0.5, dtype=torch.float64), wp.TorchModule(op, op.points)
    still, held = wp.Dirichlet(op.points, None, u), wp.Dirichlet(op.points, u, u)
    waves, steps = {"density": 2000.0, "step": 1e-6, "steps": 2}, {"step": 1.0, "steps": 2}
    for call, x in (
        (module, u),
        (network, torch.from_numpy(field(network))),
        (lambda u: wp.simulate(op, wp.Dirichlet(op.points, None, u), **waves).u, u),
        (lambda mu: wp.solve(op, held, parameters={"mu": mu}).u, number),
        (lambda mu: wp.simulate(op, still, parameters={"mu": mu}, **waves).u, number),
        (lambda phi: wp.simulate(heat, wp.Dirichlet(heat.points, None, phi), **steps).u, phi),
    ):
        with pytest.raises(wp.InputError, match=r"torch\.func: expected plain tensors"):
            torch.func.grad(lambda x, call=call: call(x).sum())(x)
    with pytest.raises(wp.InputError, match=r"torch\.func: expected plain tensors"):
        torch.func.vmap(network)(torch.from_numpy(field(network, 3)))


def test_networks_that_learn_have_second_derivatives(made):
    op = made("neural operator")
    u = torch.from_numpy(field(op)).requires_grad_()
    v = torch.from_numpy(np.random.default_rng(0).normal(size=u.shape))

    def slope(u, **how):
        return torch.autograd.grad(op(u).square().sum(), u, **how)[0]

    (second,) = torch.autograd.grad((slope(u, create_graph=True) * v).sum(), u)
    there, back = (slope((u + s * v).detach().requires_grad_()) for s in (1e-6, -1e-6))
    assert torch.allclose(second, (there - back) / 2e-6, rtol=1e-6, atol=1e-6 * second.abs().max())


@pytest.mark.parametrize("name", [name for name in OTHERS if name != "neural operator"])
def test_second_derivatives_of_others_are_refused(name, made):
    op = made(name)
    u = torch.from_numpy(field(op)).requires_grad_()
    v = torch.ones_like(u)

    def penalised(u):
        return op(u).square().sum() + u.pow(4).sum()

    (first,) = torch.autograd.grad(penalised(u), u, create_graph=True)
    (plain,) = torch.autograd.grad(penalised(u), u)
    assert torch.equal(first, plain)
    for second in (
        lambda: torch.autograd.grad(first.square().sum(), u, retain_graph=True),
        lambda: first.square().sum().backward(),
        lambda: functional.hvp(penalised, u.detach(), v),
        lambda: functional.vhp(penalised, u.detach(), v),
    ):
        with pytest.raises(wp.InputError, match="second derivative"):
            second()
    for mixed in (forward_over_reverse, reverse_over_forward):
        with pytest.raises(wp.InputError, match=r"second derivative|tangent"):
            mixed(op, u, v)


def forward_over_reverse(op, u, v):
    with forward_ad.dual_level():
        dual = forward_ad.make_dual(u, v)
        torch.autograd.grad(op(dual).square().sum(), dual)


def reverse_over_forward(op, u, v):
    with forward_ad.dual_level():
        along = forward_ad.unpack_dual(op(forward_ad.make_dual(u, v))).tangent
        torch.autograd.grad(along.sum(), u)


@pytest.mark.parametrize("name", [name for name in OPERATORS if name not in KINKED])
def test_a_tangent_is_the_product(name, made):
    op = made(name)
    u, v = (torch.from_numpy(field(op, seed=n)) for n in (0, 1))
    expected = op.jvp(u.numpy(), v.numpy())
    with forward_ad.dual_level():
        dual = op(forward_ad.make_dual(u, v))
        tangent = forward_ad.unpack_dual(dual).tangent
    assert np.allclose(tangent, expected, rtol=0, atol=1e-13 * np.abs(expected).max())
    _, again = torch.func.jvp(op, (u,), (v,))
    assert torch.equal(again, tangent)
    by_u = torch.func.grad(lambda u: loss(op, u))(u)
    leaf = u.clone().requires_grad_()
    assert torch.equal(by_u, torch.autograd.grad(loss(op, leaf), leaf)[0])


@pytest.mark.parametrize("name", OPERATORS)
def test_batches_and_precisions(name, made):
    op = made(name)
    u = torch.from_numpy(field(op, 2, 3)).requires_grad_()
    force = op(u)
    assert force.shape[:2] == (2, 3)
    (by_u,) = torch.autograd.grad(force.square().sum(), u)
    size, one = force.detach().abs().max(), u[1, 2].detach().requires_grad_()
    alone = op(one)
    assert torch.allclose(alone, force[1, 2], rtol=0, atol=1e-13 * size)
    (by_one,) = torch.autograd.grad(alone.square().sum(), one)
    assert torch.allclose(by_one, by_u[1, 2], rtol=0, atol=1e-12 * by_u.abs().max())
    assert np.allclose(op(u[0].detach().numpy()), force[0].detach(), rtol=0, atol=1e-13 * size)
    single = u.detach().float().requires_grad_()
    lower = op(single)
    assert lower.dtype == torch.float32
    assert torch.equal(lower, op(single.double()).float())
    (by_single,) = torch.autograd.grad(lower.square().sum(), single)
    assert by_single.dtype == torch.float32
    assert torch.allclose(by_single.double(), by_u, rtol=0, atol=1e-3 * by_u.abs().max())
    strided = u.detach().movedim(0, -1).contiguous().movedim(-1, 0)
    assert torch.equal(op(strided), force)
    for wrong in (u[..., :-1, :] if len(op.shape) == 2 else u[..., :-1], u[0, 0, 0], u[:0]):
        with pytest.raises(wp.InputError, match="u: expected float64 of shape"):
            op(wrong)
    with pytest.raises(wp.InputError, match="u: expected float64 of shape"):
        op(u.detach().long())
    arrays = u.detach().numpy()[0]
    for wrong in (arrays[0, :-1], arrays[:0]):
        with pytest.raises(wp.InputError, match="expected"):
            op(wrong)


class Forces(torch.utils.data.Dataset):
    """Forces of operators, which a worker works out."""

    def __init__(self, operators):
        self.operators = operators

    def __len__(self):
        return len(self.operators)

    def __getitem__(self, number):
        operator = self.operators[number]
        with torch.no_grad():
            force = operator(torch.from_numpy(field(operator)).requires_grad_())
        return force, force.requires_grad


def test_workers_of_a_loader_have_the_forces_of_this_process(made):
    forces = Forces([made(name) for name in OPERATORS])
    loader = torch.utils.data.DataLoader(forces, batch_size=None, num_workers=1, timeout=100)
    for (there, learns), (here, _) in zip(loader, forces, strict=True):
        assert torch.equal(there, here)
        assert not learns


@pytest.mark.parametrize("name", ["LPS", "crystal", "third order, energy"])
def test_torch_compile_leaves_a_force_as_it_is(name, made):
    op = made(name)
    check_compiled(lambda u: op(2 * u).square().sum(), torch.from_numpy(field(op)))


@pytest.mark.slow
def test_torch_compile_leaves_modules_solves_and_motions_as_they_are(made):
    op = made("crystal")
    module, how = wp.TorchModule(op, op.points), {"density": 2000.0, "step": 1e-6, "steps": 3}
    for call in (
        module,
        lambda u: wp.solve(op, wp.Dirichlet(op.points, u, 2 * u)).u,
        lambda u: wp.simulate(op, wp.Dirichlet(op.points, None, 2 * u), **how).u,
    ):
        check_compiled(lambda u, call=call: call(u).square().sum(), torch.from_numpy(field(op)))


def check_compiled(value, u):
    """The gradient of a compiled number is that of the number."""
    torch.compiler.reset()
    u.requires_grad_()
    whole = torch.compile(value, backend="eager")(u)
    assert torch.equal(*(torch.autograd.grad(one, u)[0] for one in (whole, value(u))))


@pytest.mark.parametrize("name", OPERATORS)
def test_copies_are_made_anew(name, made):
    op = made(name)
    u = field(op)
    for other in (copy.copy(op), copy.deepcopy(op), pickle.loads(pickle.dumps(op))):
        assert type(other) is type(op)
        assert other is not op
        assert np.array_equal(other(u), op(u))
        assert np.array_equal(other.points.x, op.points.x)


def test_a_copy_keeps_neither_samples_nor_what_was_changed_since():
    law, points = OPERATORS["conductor"]().model, lattice(4, 1.5)
    kappa = np.ones(len(points.x))
    op = law.on(points, kappa=kappa)
    u = field(op)
    kappa[:] = 2.0
    assert np.array_equal(copy.deepcopy(op)(u), op(u))
    points = lattice(4, 3.0)
    samples = wp.Samples(points, np.zeros((100, *points.x.shape)))
    plain, of_samples = (pickle.dumps(LAWS["LPS"].material().on(on)) for on in (points, samples))
    assert len(of_samples) == len(plain)


def test_what_is_changed_before_a_backward_pass_is_told():
    op = OPERATORS["hyperelastic"]()
    u = torch.from_numpy(field(op)).requires_grad_()
    twice = 2 * u
    value = op(twice).sum()
    twice.detach().add_(1)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        value.backward()


MODULES = {
    "LPS": {"lam", "mu", "alpha", "D"},
    "LPS, bond-based": {"lam", "mu", "alpha", "D"},
    "LPS in space": {"lam", "mu", "alpha", "D"},
    "scattered, own weights": {"lam", "mu", "alpha", "D"},
    "third order, filtered": {"t3", "tq2", "q3"},
    "crystal": {"tensors"},
    "density": {"lam", "mu"},
    "hyperelastic": {"coefficients"},
    "conductor": {"kappa", "alpha", "D"},
    "cut": {"lam", "mu", "alpha", "D"},
    "coupled": {"lam", "mu", "alpha", "D", "coupling"}
    | {f"conductor_{name}" for name in ("alpha", "D", "kappa")},
}


@pytest.mark.parametrize("name", MODULES)
def test_a_module_learns_the_numbers_of_its_material(name, made):
    op = made(name)
    module = wp.TorchModule(op, op.points)
    assert {key for key, _ in module.named_parameters()} == MODULES[name]
    u = torch.from_numpy(field(op, 2)).requires_grad_()
    size = op(u).detach().abs().max()
    assert torch.allclose(module(u), op(u), rtol=0, atol=1e-12 * size)
    leaves = [u, *module.parameters()]
    gradients = torch.autograd.grad(loss(module, u), leaves)
    assert torch.allclose(gradients[0], torch.autograd.grad(loss(op, u), u)[0], rtol=1e-10)


@pytest.mark.parametrize("name", [*MODULES, "neural operator"])
def test_a_module_is_saved_and_copied(name, made, tmp_path):
    op = copy.deepcopy(made(name))
    module = wp.TorchModule(op, op.points)
    with torch.no_grad():
        for number in module.parameters():
            number.mul_(1.01)
    u = torch.from_numpy(field(op))
    other = wp.TorchModule(made(name), op.points)
    other.load_state_dict(module.state_dict())
    torch.save(module, tmp_path / "m.pt")
    again = torch.load(tmp_path / "m.pt", weights_only=False)
    for one in (other, copy.deepcopy(module), again):
        assert torch.equal(one(u), module(u))
    assert torch.equal(torch.as_tensor(module(u.numpy())), module(u))


def test_a_module_reads_and_learns_what_an_operator_does(made):
    op = made("LPS")
    module, u = wp.TorchModule(op, op.points), field(op)
    assert module(u.tolist()).dtype == torch.float64
    with pytest.raises(wp.InputError, match="u: expected float values, got masked"):
        module(np.ma.masked_array(u, np.arange(u.size).reshape(u.shape) == 0))
    with torch.no_grad():
        module.mu.fill_(-1.0)
    with pytest.raises(wp.InputError, match="mu"):
        module(torch.from_numpy(u))


def test_a_module_refuses_other_points(made):
    with pytest.raises(wp.InputError, match="expected one on the points of the problem"):
        wp.TorchModule(made("LPS"), made("conductor").points)
    with pytest.raises(wp.InputError, match="Module: expected a material"):
        wp.TorchModule("graphene", made("LPS").points)


@pytest.mark.parametrize("name", ["LPS", "crystal", "conductor"])
def test_what_a_solve_takes_and_tells(name, made):
    op = made(name)
    b, u = (torch.from_numpy(field(op, 2, seed=n)) for n in (0, 1))

    def solution(b, u):
        return wp.solve(op, wp.Dirichlet(op.points, b, u))

    for wrong in ((b, u[0]), (b[0], u), (b[:, :-1], u[:, :-1]), (b + 0j, u), (b, u + 0j)):
        with pytest.raises(wp.InputError, match="[bu]: expected"):
            solution(*wrong)
    plain, whole = solution(b.numpy(), 0 * u.numpy()), solution(b, torch.zeros(u.shape).long())
    assert np.allclose(whole.u, plain.u, rtol=0, atol=1e-9 * np.abs(plain.u).max())
    told = solution(b.requires_grad_(), 0 * u)
    assert np.allclose(told.energy(), plain.energy(), rtol=1e-7)
    assert "residual" in repr(told)
    if name != "conductor":
        assert np.allclose(told.stress(), plain.stress(), rtol=0, atol=1e-8)
        assert told.plot().get_title()


@pytest.mark.parametrize(
    "name", ["third order, energy", "density", "hyperelastic", "neural operator"]
)
def test_a_nonlinear_solve_is_differentiated_once(name, made):
    op = made(name)
    b, u = 0 * torch.from_numpy(field(op)), torch.from_numpy(0.01 * field(op)).requires_grad_()
    answer = wp.solve(op, wp.Dirichlet(op.points, b, u)).u
    (first,) = torch.autograd.grad(answer.square().sum(), u, create_graph=True)
    with pytest.raises(wp.InputError, match="second derivative"):
        first.sum().backward()
    fixed = u.detach()
    with forward_ad.dual_level(), pytest.raises(wp.InputError, match="tangent"):
        wp.solve(op, wp.Dirichlet(op.points, b, forward_ad.make_dual(fixed, fixed)))


@pytest.mark.parametrize("name", [name for name in LAWS if name != "neural operator"])
def test_a_tangent_of_a_number_is_not_lost(name, made):
    op = made(name)
    number, own = next(iter(op.learnable.items()))
    value = torch.as_tensor(own, dtype=torch.float64)
    with forward_ad.dual_level(), pytest.raises(wp.InputError, match="tangent"):
        wp.solve(
            op,
            wp.Dirichlet(op.points, None, 0 * field(op)),
            parameters={number: forward_ad.make_dual(value, torch.ones_like(value))},
        )


def test_a_cracked_body_refuses_numbers_of_others_and_gradients_of_its_motion():
    points, model = lattice(6, 3.0), kernel("1/r", 3.0)
    u = torch.zeros(points.x.shape, dtype=torch.float64, requires_grad=True)
    problem = wp.Cracked(points, u=u, cracks=[[(-2.0, 0.1), (1.0, 0.1)]])
    with pytest.raises(wp.InputError, match=r"parameters: expected .* shape lam .*, got kappa"):
        wp.solve(model, problem, parameters={"kappa": 1.0})
    with pytest.raises(wp.InputError, match="simulate: expected tensors without a gradient"):
        wp.simulate(model, problem, events=1)


def test_what_would_lose_a_gradient_says_so(made):
    op = made("LPS")
    leaf = torch.zeros(op.shape, dtype=torch.float64, requires_grad=True)
    number = torch.tensor(0.5, dtype=torch.float64, requires_grad=True)
    points = op.points
    still = wp.Dirichlet(points, None, 0 * points.x)
    for lost in (
        lambda: wp.LPSMaterial(0.3, number, 1.0, [1.0], horizon=3.0),
        lambda: wp.Samples(points, leaf),
        lambda: wp.simulate(op, still, density=number, step=1e-3, steps=1),
        lambda: op.energy(leaf),
        lambda: op.rhs(leaf),
        lambda: op.jvp(leaf, leaf),
        lambda: op.stress(leaf),
        lambda: wp.simulate(op, wp.Dirichlet(SimpleNamespace(comm=ALONE), leaf, leaf)),  # ranks
    ):
        with pytest.raises(wp.InputError, match="gradient"):
            lost()


def test_lists_and_numbers_keep_all_their_digits(made):
    """Of which torch makes single precision; and what is masked or none is no number."""
    op = made("LPS")
    b, u = (torch.from_numpy(field(op, seed=n)) for n in (0, 1))
    mu, leaf = 1.1 * float(op.learnable["mu"]), b.clone().requires_grad_()

    def solved(u, mu):
        return wp.solve(op, wp.Dirichlet(op.points, leaf, u), parameters={"mu": mu}).u

    exact = solved(u, torch.tensor(mu, dtype=torch.float64))
    assert torch.equal(solved(u.tolist(), mu), exact)
    hidden = np.ma.masked_array(u.numpy(), np.arange(u.numel()).reshape(u.shape) == 0)
    for wrong, said in ((None, "numbers, got NoneType"), ("u", "got str"), (hidden, "finite")):
        with pytest.raises(wp.InputError, match=f"u: expected .*{said}"):
            solved(wrong, mu)
    step = {"density": 2000.0, "step": 1e-3, "steps": 3}
    ends = [wp.simulate(op, wp.Dirichlet(op.points, b, one), **step).u for one in (u, u.tolist())]
    assert torch.equal(*ends)
