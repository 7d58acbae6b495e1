"""The lattice of a body's bulk, chosen by loads and outline."""

import dataclasses

import numpy as np

from tests.support.plates import plate
from warp_peri import Model
from warp_peri.fe_coupling.body import solve_body
from warp_peri.fe_coupling.lattice_interior import bulk_lattice

MODEL = Model(
    lam=0.3, mu=0.8, alpha=1.0, D=[0.4, 0.6, -0.3, 0.6, -0.2], horizon=3.0, certified_on=(1.0,)
)
MESH = plate(8.0, 32.0, 10, 48)


def wave(length):
    return lambda x: np.stack([np.sin(2 * np.pi * x[:, 1] / length), 0 * x[:, 0]], axis=1)


def test_the_body_asks_for_a_finer_lattice_and_so_do_short_waves():
    wide, tried = bulk_lattice(MODEL, plate(30.0, 120.0, 10, 48), None, None)
    assert tried[-1].spacing == 2.0
    assert tried[-1].verdict == "taken"
    assert wide.is_certified_on(2.0)
    same, tried = bulk_lattice(MODEL, MESH, None, None)
    assert same is MODEL
    assert [a.spacing for a in tried] == [2.0, 1.5, 1.0]
    assert "of the body is two horizons inside" in tried[0].verdict
    assert tried[-1].share >= 0.5
    _, tried = bulk_lattice(MODEL, plate(30.0, 120.0, 10, 48), wave(9.0), None)
    assert tried[-1].spacing == 1.5
    assert tried[0].verdict == "the waves of the load are not resolved"
    assert tried[0].wave_error > 0.005


def test_a_solution_tells_what_was_tried():
    solution = solve_body(MODEL, MESH, displacement={"sides": lambda x: 0.01 * x})
    assert solution.spacing == solution.tried[-1].spacing == 1.0
    bare = dataclasses.replace(MODEL, certified_on=())  # it is proven there and then
    again = solve_body(bare, MESH, displacement={"sides": lambda x: 0.01 * x})
    np.testing.assert_allclose(again.on_corners()[0], solution.on_corners()[0], atol=1e-8)
