"""Another material than graphene, by dumps and the command alone."""

import numpy as np
import pytest

from tools.graphene import sheet
from tools.lammps_session import LammpsSession
from tools.statics import find_bonds


def test_bonds_join_even_and_odd_atoms():
    """So that two elements in turn are the two sublattices."""
    positions, box = sheet(1.45, cells=(4, 3))
    bonds = find_bonds(positions, box)
    assert len(bonds) == 1.5 * len(positions)
    assert (np.ptp(bonds % 2, axis=1) == 1).all()


def test_elements_must_be_elements():
    with pytest.raises(ValueError, match="chemical symbols"):
        LammpsSession(np.zeros((1, 2)), box=None, elements=("C; shell ls",))


def test_a_dump_cannot_smuggle_commands(tmp_path):
    with (
        LammpsSession(np.array([[0.0, 0.0], [1.46, 0.0]]), box=None) as session,
        pytest.raises(ValueError, match="LAMMPS would interpret"),
    ):
        session.write_dump(tmp_path / 'a" b.dump')
