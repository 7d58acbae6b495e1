"""A second derivative, and a tangent of forward mode, are refused where torch would drop terms."""

import numpy as np
import pytest
import torch
from torch.autograd import forward_ad

import warp_peri as wp
from tests.conformance.test_laws import hyperelastic, linear, third_order, tissue
from tests.support.problems import lattice
from warp_peri.lps.bonds import Bonds
from warp_peri.lps.operator import lps_force
from warp_peri.methods import Solid
from warp_peri.statics.equilibrium import equilibrium

SOLID = {"lam": 0.4, "mu": 0.5, "alpha": 1.0, "D": [1.0, 0.7, 0.4]}


def forces():
    """A force of a displacement by law, on some nodes."""
    plain, axes = lattice(15, 3.0), tissue(13)
    return {
        "linear": (linear("two functions", lam=-0.2)().on(plain), plain),
        "third order": (third_order(None)().on(plain), plain),
        "hyperelastic": (hyperelastic().on(axes), axes),
    }


def numbers():
    return [torch.tensor(v, dtype=torch.float64).requires_grad_() for v in SOLID.values()]


def at_rest(method):
    """An energy of where a body rests, of its numbers."""
    points = lattice(15, 3.0)
    b = torch.from_numpy(1e-3 * np.sin(points.x))

    def energy(*values):
        u = equilibrium(points, b, torch.zeros_like(b), Solid(*values), horizon=3.0, method=method)
        return (u * b).sum() + sum(value.square().sum() for value in values)

    return energy


def of_numbers():
    """An energy of a force, of the numbers of its solid."""
    bonds = Bonds(lattice(15, 3.0), 3.0)
    u = torch.from_numpy(0.01 * np.cos(lattice(15, 3.0).x))

    def energy(*values):
        return lps_force(bonds, u, Solid(*values)).square().sum() + sum(
            value.square().sum() for value in values
        )

    return energy


@pytest.mark.parametrize("law", ["linear", "third order", "hyperelastic"])
def test_of_a_force(law):
    force, points = forces()[law]
    x = 0.01 * np.sin(points.x)

    def penalised(u):
        return force(u).square().sum() + u.pow(4).sum()

    u = torch.from_numpy(x).requires_grad_()
    (first,) = torch.autograd.grad(penalised(u), u, create_graph=True)
    (plain,) = torch.autograd.grad(penalised(u), u)
    assert torch.equal(first, plain)
    with pytest.raises(wp.InputError, match="second derivative"):
        torch.autograd.grad(first.square().sum(), u)
    with pytest.raises(wp.InputError, match="second derivative"):
        torch.autograd.functional.hvp(penalised, u.detach(), torch.ones_like(u))
    with pytest.raises(wp.InputError, match="second derivative"):
        first.square().sum().backward()
    with forward_ad.dual_level(), pytest.raises((wp.InputError, NotImplementedError)):
        force(forward_ad.make_dual(u.detach(), torch.ones_like(u)))


@pytest.mark.parametrize("energy", [at_rest("lu"), at_rest("sine"), of_numbers()])
def test_of_numbers(energy):
    values = tuple(value.detach() for value in numbers())
    with pytest.raises(wp.InputError, match="second derivative"):
        torch.autograd.functional.hessian(energy, values)
    leaves = numbers()
    first = torch.autograd.grad(energy(*leaves), leaves, create_graph=True)
    for one in first:
        with pytest.raises(wp.InputError, match="second derivative"):
            torch.autograd.grad(one.sum(), leaves, retain_graph=True, allow_unused=True)


@pytest.mark.parametrize("name", ["lam", "mu", "alpha"])
def test_a_homogeneous_solid_has_one_number_each(name):
    with pytest.raises(wp.InputError, match=rf"{name}: expected one number .* got shape \[225\]"):
        Solid(**SOLID | {name: torch.full((225,), 0.5)})
