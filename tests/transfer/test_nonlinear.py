"""Nonlinear models on other lattices."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.nonlinear import solid
from tests.support.problems import lattice
from warp_peri import uniqueness
from warp_peri.transfer.nonlinear import nonlinear_for


def test_constants_go_along_and_the_guarantee_is_proven_anew():
    model = solid("filtered")
    linear = replace(model.linear, alpha=1.0, D=[1.0], D_dilatation=[1.0])
    model = replace(model, linear=linear)
    model = replace(model, proven={"1": uniqueness(model, spacing=1.0).figures()})
    assert nonlinear_for(model, lattice(2, 3.0)) is model
    fine = lattice(3, 2.5, spacing=0.8)
    with pytest.warns(UserWarning, match="transferred from 1 Å to 0.8 Å"):
        transferred = nonlinear_for(model, fine)
    assert transferred.linear.certified_on == (0.8,)
    assert np.array_equal(transferred.numbers[2:], model.numbers[2:])
    assert transferred.smoothing == model.smoothing
    assert list(transferred.proven) == ["0.8"]
    assert 0 < transferred.proven_strain(0.8) != model.proven_strain(1.0)
    again = nonlinear_for(model, fine)
    assert again.proven == transferred.proven
