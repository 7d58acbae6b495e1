"""Nonlinear models on other lattices."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from tests.support.nonlinear import FORMS, solid
from tests.support.problems import lattice
from warp_peri.points.families import bond_classes
from warp_peri.proofs import uniqueness

LAM = {"energy": -0.1, "filtered": -0.2}
"""A transfer is said once of a linear solid: each form has its own."""


def proven(form, horizon=3.0):
    model = solid(form, horizon, lam=LAM[form])
    linear = replace(model.linear, alpha=1.0, D=[1.0], D_dilatation=[1.0])
    model = replace(model, linear=linear)
    return replace(model, proven={"1": uniqueness(model, spacing=1.0).figures()})


@pytest.mark.parametrize("form", FORMS)
def test_constants_go_along_and_the_guarantee_is_proven_anew(form):
    model = proven(form)
    assert model.at(lattice(2, 3.0)) is model
    fine = lattice(3, 2.5, spacing=0.8)
    with pytest.warns(UserWarning, match="transferred from 1 Å to 0.8 Å"):
        transferred = model.at(fine)
    assert transferred.linear.certified_on == (0.8,)
    assert np.array_equal(transferred.numbers[2:], model.numbers[2:])
    assert transferred.smoothing == model.smoothing
    assert list(transferred.proven) == ["0.8"]
    assert 0 < transferred.proven_strain(0.8) != model.proven_strain(1.0)
    again = model.at(fine)
    assert again.proven == transferred.proven


def response(model, spacing, size):
    """|h(k)| / |k| of the gradient for long and short waves in one direction."""
    classes = bond_classes(spacing, model.horizon)
    p, _ = model.weights(classes)
    k = np.outer(size, (np.cos(0.3), np.sin(0.3)))
    h = 2 * np.sin(k @ classes.xi.T) @ (p[classes.bond_class][:, None] * classes.xi)
    return np.linalg.norm(h, axis=1) / size


def test_the_energy_form_keeps_the_gradient_of_long_waves_and_takes_little_of_short_ones():
    model = proven("energy")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="transferred")
        transferred = model.at(lattice(5, 3.0, spacing=0.7))
    plain = replace(transferred, gradient=None)
    long, short = np.linspace(0.1, 1.0, 8), np.linspace(2.5, 4.4, 20)
    at_home = response(model, 1.0, long)
    assert np.abs(response(transferred, 0.7, long) / at_home - 1).max() < 0.04
    assert response(transferred, 0.7, short).max() < 0.1 < 0.4 < response(plain, 0.7, short).max()
    assert transferred.proven_strain(0.7) > 2 * uniqueness(plain, spacing=0.7).strain


@pytest.mark.slow
def test_a_third_lattice_takes_the_gradient_of_the_second_one():
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="transferred")
        finest = proven("energy").at(lattice(5, 3.0, spacing=0.6))
        third = finest.at(lattice(5, 3.0, spacing=0.7))
    plain = uniqueness(replace(third, gradient=None), spacing=0.7).strain
    assert third.proven_strain(0.7) > 1.5 * plain > 0
