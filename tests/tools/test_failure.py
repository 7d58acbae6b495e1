"""Atoms under a load that grows to where they fail."""

from dataclasses import replace

import numpy as np
import pytest

from tools.failure import LAST_STEP, TOLERANCE, to_failure
from tools.graphene import THICKNESS, area_per_atom
from tools.loads import WaveLoad, atom_force
from tools.make_graphene import graphene_bodies
from tools.make_strained import strained
from tools.samples import _statics
from tools.statics import ConvergenceError


@pytest.fixture(scope="module")
def failing():
    """A small sheet under a wave along y, at 20 % strain and from there to its last equilibrium."""
    body, load = replace(graphene_bodies()[0], cells=(4, 6)), WaveLoad(1, (0, 1))
    statics = _statics(body)
    start = strained(body, statics, load, 0.2)
    return body, load, statics, start, to_failure(body, load, start)


@pytest.mark.slow
def test_the_last_equilibrium_is_at_the_largest_load(failing):
    _, _, _, start, path = failing
    loads = np.array([sample.amplitude for sample in (start, *path)])
    strains = np.array([sample.max_bond_strain for sample in (start, *path)])
    steps = loads[1:] / loads[:-1] - 1
    assert (steps > 0).all()
    assert steps[-1] < 4 * LAST_STEP
    assert (np.diff(strains) > 0).all()
    assert strains[-1] == pytest.approx(0.27, abs=0.03)
    # at the fold strain grows without end beside the load
    stiffness = np.diff(loads) / np.diff(strains)
    assert stiffness[-1] < 0.2 * stiffness[0]


def test_forces_below_the_stock_cut_off_are_those_of_the_stock_potential(failing):
    body, load, statics, _, path = failing
    unit = atom_force(load.shape(statics.reference, body.box), area_per_atom(body.bond), THICKNESS)
    sample = next(s for s in path if s.max_bond_strain < 0.22)
    stock = statics.equilibrium(
        sample.amplitude * unit, name="stock", guess=sample.displacement, tolerance=TOLERANCE
    )
    assert stock.steps == 0
    assert np.abs(stock.force - sample.force).max() <= 1e-12


def test_no_equilibrium_to_begin_with(failing):
    body, load, _, start, path = failing
    beyond = replace(start, amplitude=3 * path[-1].amplitude)
    with pytest.raises(ConvergenceError, match="load 'start'"):
        to_failure(body, load, beyond)
    with pytest.raises(ValueError, match="start: expected one under a load"):
        to_failure(body, load, replace(start, amplitude=0.0))
