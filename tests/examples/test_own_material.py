"""Another material than graphene, by dumps and the command alone."""

import json

import numpy as np
import pytest

from examples import own_material
from tools.graphene import sheet
from tools.lammps_session import LammpsSession
from tools.statics import find_bonds
from warp_peri.materials.lps import Model


@pytest.mark.slow
def test_boron_nitride_has_its_own_constants(tmp_path, capsys):
    assert own_material.main(["--out", str(tmp_path)]) == 0
    rows, E_u = (json.loads((tmp_path / f"{n}.json").read_text()) for n in ("constants", "errors"))
    learned, true = rows["learned"], rows["lattice statics"]
    assert true["mu"] < 0.4  # not graphene's 0.72
    for key in ("lambda", "mu", "E", "nu"):
        assert learned[key] == pytest.approx(true[key], rel=0.005), key
    assert E_u["linear solid"]["val"] < E_u["local elasticity, true moduli"]["val"]
    assert Model.load(tmp_path / "model" / "model.json").certified_on == (5.0,)
    assert "exactly one solution" in capsys.readouterr().out


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
