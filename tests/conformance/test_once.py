"""A second derivative to numbers is refused where torch would drop terms."""

import numpy as np
import pytest
import torch

import warp_peri as wp
from tests.support.problems import lattice
from warp_peri.materials.lps_force import Bonds
from warp_peri.materials.lps_operator import lps_force
from warp_peri.methods import LPSParameters

SOLID = {"lam": 0.4, "mu": 0.5, "alpha": 1.0, "D": [1.0, 0.7, 0.4]}


def numbers():
    return [torch.tensor(v, dtype=torch.float64).requires_grad_() for v in SOLID.values()]


def at_rest(method):
    """An energy of where a body rests, of its numbers."""
    points = lattice(15, 3.0)
    b = torch.from_numpy(1e-3 * np.sin(points.x))

    solver = wp.Direct() if method == "lu" else wp.CG(method)
    operator = wp.LPSMaterial(**SOLID, horizon=3.0, certified_on=(1.0,)).on(points)

    def energy(*values):
        u = operator.solve(b, torch.zeros_like(b), solver, parameters=dict(zip(SOLID, values))).u
        return (u * b).sum() + sum(value.square().sum() for value in values)

    return energy


def of_numbers():
    """An energy of a force, of the numbers of its solid."""
    bonds = Bonds(lattice(15, 3.0), 3.0)
    u = torch.from_numpy(0.01 * np.cos(lattice(15, 3.0).x))

    def energy(*values):
        return lps_force(bonds, u, *values).square().sum() + sum(
            value.square().sum() for value in values
        )

    return energy


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


NONE = (
    (1j, "expected (float|real)"),
    (np.ma.masked_array([0.5], [True]), "expected (values|float)"),
    (np.nan, "expected finite"),
    ("0.5", "expected float"),
    (None, "expected float"),
    (True, "expected float"),
)


@pytest.mark.parametrize("name", SOLID)
def test_what_is_no_number_is_refused_by_a_solid(name):
    for value, words in NONE:
        with pytest.raises(wp.InputError, match=f"{name}: {words}"):
            LPSParameters(**SOLID | {name: value})


@pytest.mark.parametrize("value", ["3", None, 1j, np.nan, 0.0, -1.0, np.inf, [3.0]])
def test_a_horizon_is_a_length(value):
    with pytest.raises(wp.InputError, match="horizon: expected a"):
        wp.LPS(value)


def test_an_influence_function_has_coefficients_and_an_exponent_below_three():
    for change, words in (({"alpha": 3.0}, "less than 3"), ({"D": []}, "at least one coefficient")):
        with pytest.raises(wp.InputError, match=words):
            LPSParameters(**SOLID | change)


@pytest.mark.parametrize("name", ["lam", "mu", "alpha"])
def test_a_homogeneous_solid_has_one_number_each(name):
    with pytest.raises(wp.InputError, match=rf"{name}: expected one number .* got shape \[225\]"):
        LPSParameters(**SOLID | {name: torch.full((225,), 0.5)})
