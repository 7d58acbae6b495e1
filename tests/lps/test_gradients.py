"""Gradients of the whole forward pass to every parameter, against differences of float64."""

from functools import partial

import numpy as np
import pytest
import torch

from tests.support.problems import GRADIENT, KERNELS, LAM, MU, difference, lattice, noise
from tests.support.problems import kernel as model_of
from tests.support.problems import periodic as periodic_lattice
from warp_peri.errors import InputError
from warp_peri.lps.bonds import Bonds
from warp_peri.lps.operator import lps_force
from warp_peri.methods import Solid
from warp_peri.transfer.operator import LPSOperator

HORIZON = 2.5


class Problem:
    """A scalar of L u, of first and second order, as a function of one vector of everything."""

    def __init__(self, name, *, periodic=False):
        points, _ = periodic_lattice((6, 6)) if periodic else (lattice(2, HORIZON), None)
        self.bonds = Bonds(points, HORIZON)
        random = np.random.default_rng(5)
        self.u = noise(points, 2)
        self.seed = torch.from_numpy(random.normal(size=(2, points.interior.sum(), 2)))
        kernel = {"u": self.u.ravel(), "lam": LAM, "mu": MU, **KERNELS[name]}
        self.leaves = {part: np.atleast_1d(leaf).astype(float) for part, leaf in kernel.items()}

    def scalar(self, u, *parameters):
        Lu = lps_force(self.bonds, u.reshape(self.u.shape), Solid(*parameters))
        return (self.seed * Lu).sum() + (Lu**2).sum() / 100

    def value(self, part, leaf):
        """The scalar with another value of one part."""
        with torch.no_grad():
            return self.scalar(*map(torch.from_numpy, (self.leaves | {part: leaf}).values())).item()

    def tensors(self):
        """All parts as torch leaves."""
        return [torch.tensor(leaf, requires_grad=True) for leaf in self.leaves.values()]

    def gradients(self):
        given = self.tensors()
        parts = torch.autograd.grad(self.scalar(*given), given)
        return {part: gradient.numpy() for part, gradient in zip(self.leaves, parts)}

    def differences(self, part):
        return difference(partial(self.value, part), self.leaves[part], *STEPS[part])


STEPS = {"u": (1.0, 2), "lam": (1.0, 2), "mu": (1.0, 2), "alpha": (0.005, 8), "D": (0.002, 8)}
STEPS["D_dilatation"] = STEPS["D"]
"""Step and order of the differences; second order is exact in u, λ and μ, which enter squared."""


@pytest.mark.parametrize("periodic", [False, True], ids=["collar", "periodic"])
@pytest.mark.parametrize("name", KERNELS)
def test_every_parameter(name, periodic):
    problem = Problem(name, periodic=periodic)
    for part, gradient in problem.gradients().items():
        expected = problem.differences(part)
        size = np.abs(expected).max()
        if part == "D" and len(gradient) == 1:  # the scale of K has no effect
            value = abs(problem.value("D", problem.leaves["D"]))
            assert size < 1e-9 * value
            size = value
        error = np.abs(gradient - expected).max() / size
        assert error <= GRADIENT, f"{part}: {error:.1e}"


@pytest.mark.parametrize(
    ("name", "part"), [("sign-changing", "D"), ("two functions", "D_dilatation")]
)
def test_every_coefficient_has_its_own_gradient(name, part):
    """Each D_k by itself to the tolerance, not only the largest."""
    problem = Problem(name)
    expected = problem.differences(part)
    np.testing.assert_allclose(problem.gradients()[part], expected, rtol=GRADIENT)


def test_gradient_of_a_model_is_the_transposed_operator():
    points, _ = periodic_lattice((6, 7))
    operator = LPSOperator(model_of("sign-changing", HORIZON), points)
    u = torch.from_numpy(noise(points)).requires_grad_()
    v = noise(points, seed=9)
    gradient = torch.autograd.grad(operator(u), u, torch.from_numpy(v))[0].numpy()
    np.testing.assert_allclose(gradient, operator(v), rtol=0, atol=1e-12 * np.abs(gradient).max())


def test_a_second_backward_pass_through_the_same_graph_is_equal():
    problem = Problem("positive")
    given = problem.tensors()
    value = problem.scalar(*given)
    first, second = (torch.autograd.grad(value, given, retain_graph=True) for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(first, second))


def test_what_torch_cannot_know_is_an_error_and_not_a_wrong_number():
    problem = Problem("positive")
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
