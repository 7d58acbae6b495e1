"""The example that cleaves crystals."""

import json

import numpy as np
import pytest

from examples import cleavage
from warp_peri.points.families import bond_classes


def test_silicon_is_cheapest_and_weakest_across_111():
    solid, shown = cleavage.CASES["Si {111}"].solid()
    assert min(shown, key=shown.get) == "γ 111"
    assert shown["γ 111"] == pytest.approx(1.36, rel=1e-3)  # J/m², of a bond an atom
    assert solid.toughness == pytest.approx(solid.energies.min())
    h = solid.horizon / cleavage.REACH
    stretches, xi = solid.stretches(bond_classes(h, solid.horizon)), bond_classes(h, 4 * h).xi
    across, along = (np.abs(xi[:, axis]) < 1e-9 * h for axis in (0, 1))
    assert stretches[across].max() < stretches[along].min()


@pytest.mark.slow
def test_tungsten_cleaves_at_griffiths_load(monkeypatch, capsys):
    monkeypatch.setattr(cleavage, "CELLS", (16,))
    assert cleavage.main(["--json", "--only", "W {100}"]) == 0
    found = json.loads(capsys.readouterr().out)["W {100}"]
    assert found["load over Griffith's, 16 spacings"] == pytest.approx(1, abs=0.03)
    assert found["load over Griffith's, 16 spacings, continuum"] == pytest.approx(1, abs=0.06)
    assert (found["run at 0.9"] < 0.2, found["run at 1.05"]) == (True, 1.0)
    assert found["missing work"] < 5e-3
