"""Gradients: equal to those of plain sweeps and to differences, on any number of threads."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
import warp as wp

from tests.support.clouds import cloud, periodic_cloud
from tests.support.problems import (
    GRADIENT,
    KERNELS,
    LAM,
    MU,
    difference,
    kernel,
    lattice,
    noise,
    periodic,
)
from warp_peri import InputError
from warp_peri.launch import set_threads, threads
from warp_peri.materials.lps_bonds import Bonds
from warp_peri.materials.lps_force import lps_force
from warp_peri.methods import Solid

PLAIN = 1e-12
DIFFERENCES = 1e-8
HORIZON = 3.0
STEPS = {"u": (1.0, 2), "lam": (1.0, 2), "mu": (1.0, 2), "alpha": (0.005, 8), "D": (0.002, 8)}


def cut(points):
    return points.x[:, 0] > points.x[points.interior, 0].mean()


def body(points):
    """The interior without the half that is cut away."""
    outside = cut(points)
    return replace(points, interior=points.interior & ~outside, outside=outside)


def bonds_of(kind):
    if "periodic" in kind:
        points, _ = periodic((7, 8)) if "lattice" in kind else periodic_cloud(7)
        return Bonds(points, HORIZON), points
    points = lattice(2, HORIZON) if "lattice" in kind else cloud(2, HORIZON)
    if "cut" in kind:
        points = body(points)
        return Bonds(points, HORIZON), points
    return Bonds(points, HORIZON), points


RICH = ("sign-changing", "positive")
KINDS = ("lattice", "periodic lattice", "cloud", "periodic cloud", "cut lattice", "cut cloud")


class Problem:
    """A scalar of L u, of first and second order, as a function of everything."""

    def __init__(self, name, kind, samples=2):
        self.bonds, points = bonds_of(kind)
        self.u = noise(points, samples)
        self.seed = noise(points, samples, seed=4)[:, points.interior]
        values = {"u": self.u, "lam": LAM, "mu": MU, **KERNELS[name]}
        self.leaves = {part: np.atleast_1d(leaf).astype(float) for part, leaf in values.items()}

    def scalar(self, *leaves):
        Lu = lps_force(self.bonds, leaves[0], Solid(*leaves[1:]))
        return (torch.from_numpy(self.seed) * Lu).sum() + (Lu**2).sum() / 100

    def tensors(self):
        return [torch.tensor(leaf, requires_grad=True) for leaf in self.leaves.values()]

    def gathered(self):
        given = self.tensors()
        gradients = torch.autograd.grad(self.scalar(*given), given)
        return {part: by.numpy() for part, by in zip(self.leaves, gradients)}

    def value(self, part, leaf):
        leaves = self.leaves | {part: leaf.reshape(self.leaves[part].shape)}
        with torch.no_grad():
            return self.scalar(*map(torch.from_numpy, leaves.values())).item()


def error(value, expected):
    return np.abs(value - expected).max() / np.abs(expected).max()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", RICH)
def test_is_that_of_plain_sweeps(name, kind, monkeypatch):
    """As other devices than the processor run them, bond by bond in Warp's own words."""
    swept = Problem(name, kind)
    assert swept.bonds.layout.in_rows == (kind in ("lattice", "periodic lattice"))
    gradients = swept.gathered()
    monkeypatch.setattr("warp_peri.materials.lps_bonds.DEVICE", "elsewhere")
    expected = Problem(name, kind).gathered()
    for part, by in gradients.items():
        assert error(by, expected[part]) <= PLAIN, part


@pytest.mark.parametrize(
    ("name", "kind"),
    [(name, kind) for name in KERNELS for kind in (KINDS if name in RICH else KINDS[:2])],
)
def test_is_the_difference_quotient(name, kind):
    problem = Problem(name, kind, samples=1)
    random = np.random.default_rng(0)
    for part, by in problem.gathered().items():
        leaf = problem.leaves[part]
        if part == "u":  # along 20 directions, the components being many
            ways = random.normal(size=(20, leaf.size))

            def along(t, ways=ways, leaf=leaf):
                return problem.value("u", leaf.ravel() + t @ ways)

            expected = difference(along, np.zeros(20), *STEPS["u"])
            assert error(ways @ by.ravel(), expected) <= DIFFERENCES
            continue
        expected = difference(partial(problem.value, part), leaf, *STEPS[part])
        if part == "D" and leaf.size == 1:  # the scale of K has no effect
            size = abs(problem.value("D", leaf))
            assert max(np.abs(by), np.abs(expected)) < 1e-9 * size
            continue
        assert error(by, expected) <= DIFFERENCES, part
        if part.startswith("D") and name in RICH and kind == "lattice":  # each D_k by itself
            np.testing.assert_allclose(by, expected, rtol=GRADIENT)


@pytest.mark.parametrize("kind", ["lattice", "cloud"])
def test_of_bond_based_forces(kind):
    points = lattice(3, HORIZON) if kind == "lattice" else cloud(3, HORIZON)
    bonds = Bonds(points, HORIZON, bond_based=True)
    u = noise(points)
    leaves = [u, 0.7, 0.7, 1.3, [1.0, 0.5, -0.2]]
    given = [torch.tensor(leaf, dtype=torch.float64) for leaf in leaves]
    for n in (0, 3, 4):
        given[n].requires_grad_()
    Lu = lps_force(bonds, given[0], Solid(*given[1:]))
    whole = lps_force(Bonds(points, HORIZON), given[0], Solid(*given[1:]))
    torch.testing.assert_close(Lu, whole, rtol=0, atol=1e-12)
    of = [given[n] for n in (0, 3, 4)]
    gradients = torch.autograd.grad((Lu**3).sum(), of)
    expected = torch.autograd.grad((whole**3).sum(), of)
    for gradient, one in zip(gradients, expected):
        assert error(gradient.numpy(), one.numpy()) < 1e-11
    asked = torch.tensor(0.7, requires_grad=True)
    for pair in ((asked, 0.7), (0.7, asked)):
        with pytest.raises(InputError, match="lambda, mu: expected equal values without a gr"):
            lps_force(bonds, given[0], Solid(*pair, *leaves[3:]))
    for field in (given[0], given[0].detach()):
        with pytest.raises(InputError, match="lambda, mu: expected equal values without a gr"):
            lps_force(bonds, field, Solid(0.1, 0.7, 1.3, [1.0]))


def test_bond_based_forces_need_half_the_collar():
    points = lattice(3, HORIZON / 2)
    with pytest.raises(InputError, match="out to twice the horizon"):
        Bonds(points, HORIZON)
    Bonds(points, HORIZON, bond_based=True)
    with pytest.raises(InputError, match="interior nodes need complete families: "):
        Bonds(lattice(3, 1.0), HORIZON, bond_based=True)


@pytest.mark.parametrize("kind", ["periodic lattice", "periodic cloud"])
def test_threads_change_no_bit(kind, monkeypatch):
    monkeypatch.setattr("warp_peri.launch.SLICE", 3)
    problem = Problem("sign-changing", kind, samples=3)
    before = threads()
    try:
        results = []
        for count in (1, 2, 3, 7):
            set_threads(count)
            results.append(problem.gathered())
    finally:
        set_threads(before)
    for other in results[1:]:
        assert all(np.array_equal(results[0][part], other[part]) for part in other)


@pytest.mark.parametrize("kind", KINDS)
def test_four_python_threads_on_one_set_of_bonds_change_no_bit(kind):
    problem = Problem("sign-changing", kind)
    jobs = [{part: (1 + 0.1 * n) * leaf for part, leaf in problem.leaves.items()} for n in range(4)]

    def found(leaves):
        given = [torch.tensor(leaf, requires_grad=True) for leaf in leaves.values()]
        with torch.no_grad():
            alone = problem.scalar(*given)
        return [alone, *torch.autograd.grad(problem.scalar(*given), given)]

    expected = [found(job) for job in jobs]
    with ThreadPoolExecutor(4) as pool:
        for number, value in enumerate(pool.map(found, 8 * jobs)):
            assert all(map(torch.equal, value, expected[number % 4]))


@pytest.mark.parametrize("count", [0, -1, 1.5, True, "2"])
def test_a_number_of_threads_that_is_none_is_refused(count):
    with pytest.raises(InputError, match="threads: expected a whole number"):
        set_threads(count)


def test_single_precision_is_double_precision_rounded():
    points, _ = periodic_cloud(7)
    results = {}
    for precision in ("float64", "float32"):
        bonds = Bonds(points, HORIZON, precision=precision)
        dtype = getattr(torch, precision)
        values = (noise(points), LAM, MU, 1.6, [1.0, 0.4, -0.3])
        given = [torch.tensor(v, dtype=dtype, requires_grad=True) for v in values]
        Lu = lps_force(bonds, given[0], Solid(*given[1:]))
        results[precision] = [Lu.detach(), *torch.autograd.grad(Lu.sum() + (Lu**2).sum(), given)]
    for double, single in zip(*results.values()):
        assert error(single.double().numpy(), double.numpy()) < 2e-4
    with pytest.raises(InputError, match="u: expected float32 of shape"):
        lps_force(bonds, torch.from_numpy(noise(points)), Solid(LAM, MU, 1.6, [1.0]))
    with pytest.raises(InputError, match="precision: expected one of"):
        Bonds(points, HORIZON, precision="float16")


@wp.kernel
def squared(Lu: wp.array2d[wp.vec2d], seed: wp.array2d[wp.vec2d], loss: wp.array[wp.float64]):
    s, i = wp.tid()
    weight = seed[s, i] + Lu[s, i] * wp.float64(0.3)
    wp.atomic_add(loss, 0, wp.dot(weight, Lu[s, i]))


def arrays_of(model, u):
    given = map(np.atleast_1d, model.solid.values())
    return wp.array(u, dtype=wp.vec2d, requires_grad=True), [
        wp.array(value, dtype=wp.float64, requires_grad=True) for value in given
    ]


@pytest.mark.parametrize("name", ["sign-changing", "broken bonds"])
def test_on_a_tape_of_the_user(name):
    """Loss and gradients are those of torch; a second pass gives them again."""
    points, model = lattice(5, HORIZON), kernel(name.replace("broken bonds", "positive"), HORIZON)
    if name == "broken bonds":
        points = replace(points, outside=~points.interior & (points.x[:, 0] > 3.5))
    operator = model.on(points)
    assert (len(operator.bonds.families.cut) > 0) == (name == "broken bonds")
    u, seed = noise(points, 2), noise(points, 2, seed=1)[:, points.interior]
    field, numbers = arrays_of(model, u)
    out = wp.zeros((2, len(seed[0])), dtype=wp.vec2d, requires_grad=True)
    loss, weight = wp.zeros(1, dtype=wp.float64, requires_grad=True), wp.array(seed, dtype=wp.vec2d)
    with wp.Tape() as tape:
        operator.launch(field, out, Solid(*numbers))
        wp.launch(squared, out.shape, inputs=[out, weight], outputs=[loss])
    tape.backward(loss)
    leaves = [torch.tensor(u, requires_grad=True)]
    leaves += [torch.tensor(one.numpy(), requires_grad=True) for one in numbers]
    Lu = lps_force(operator.bonds, leaves[0], Solid(*leaves[1:]))
    value = ((torch.from_numpy(seed) + 0.3 * Lu) * Lu).sum()
    assert float(loss.numpy()[0]) == pytest.approx(float(value.detach()), rel=1e-14)
    gradients = torch.autograd.grad(value, leaves)
    for array, expected in zip([field, *numbers], gradients):
        assert error(array.grad.numpy(), expected.numpy()) <= 1e-14
    first = field.grad.numpy().copy()
    tape.zero()
    assert not field.grad.numpy().any()
    tape.backward(loss)
    assert np.array_equal(field.grad.numpy(), first)
    operator.launch(field, out)  # no tape: the force alone, of the model's own numbers
    assert np.array_equal(out.numpy(), operator(u))


def test_what_a_launch_refuses():
    points = lattice(5, HORIZON)
    model = kernel("positive", HORIZON)
    operator, (field, numbers) = model.on(points), arrays_of(model, noise(points, 2))
    out = wp.zeros((2, 25), dtype=wp.vec2d)
    wide = wp.zeros((4, 25), dtype=wp.vec2d)
    for wrong in (out[:, :-1], wide[::2], out.numpy(), wp.zeros((2, 25), dtype=wp.vec2f)):
        with pytest.raises(InputError, match=r"out: expected a contiguous .* \[2, 25\]"):
            operator.launch(field, wrong)
    for wrong in (field[:, :-1], field[:0], field[0], field.numpy()):
        with pytest.raises(InputError, match="u: expected a contiguous array of Warp of shape"):
            operator.launch(wrong, out)
    longer = wp.zeros(len(model.D) + 1, dtype=wp.float64)
    with pytest.raises(InputError, match="D: expected .* numbers, as the model has"):
        operator.launch(field, out, Solid(*numbers[:3], longer))
    near = lattice(5, HORIZON / 2)
    alone = kernel("positive", HORIZON, lam=0.8).on(near)
    field, _ = arrays_of(model, noise(near, 2))
    with pytest.raises(InputError, match="expected equal values without a gradient"):
        alone.launch(field, out, Solid(*numbers))


def test_a_launch_takes_other_numbers_than_equal_ones():
    points = lattice(5, HORIZON)
    model, equal = (kernel("positive", HORIZON, lam=lam) for lam in (LAM, 0.8))
    field, numbers = arrays_of(model, noise(points, 2))
    out = wp.zeros((2, 25), dtype=wp.vec2d)
    equal.on(points).launch(field, out, Solid(*numbers))
    assert np.array_equal(out.numpy(), model.on(points)(noise(points, 2)))


def test_gradient_of_a_model_is_the_transposed_operator():
    points, _ = periodic((7, 8))
    operator = kernel("sign-changing", HORIZON).on(points)
    u = torch.from_numpy(noise(points)).requires_grad_()
    v = noise(points, seed=9)
    gradient = torch.autograd.grad(operator(u), u, torch.from_numpy(v))[0].numpy()
    np.testing.assert_allclose(gradient, operator(v), rtol=0, atol=1e-12 * np.abs(gradient).max())


def test_a_second_backward_pass_through_the_same_graph_is_equal():
    problem = Problem("positive", "lattice")
    given = problem.tensors()
    value = problem.scalar(*given)
    first, second = (torch.autograd.grad(value, given, retain_graph=True) for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(first, second))


def test_what_torch_cannot_know_is_an_error_and_not_a_wrong_number():
    problem = Problem("positive", "lattice")
    u, *parameters = problem.tensors()
    value = problem.scalar(u.detach().clone().requires_grad_(), *parameters)
    (first,) = torch.autograd.grad(value, parameters[-1], create_graph=True)
    with pytest.raises(InputError, match="second derivative"):
        (first**2).sum().backward()
    changed = u.detach().clone()
    value = problem.scalar(changed, *parameters)
    changed.zero_()  # the field that the gradient needs
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        value.backward()
