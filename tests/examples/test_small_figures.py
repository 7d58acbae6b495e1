"""A figure of a capability's page from less data, so that every `make test` holds it.

Cracks stand in tests/statics/test_mixed.py (Sneddon's opening), the network in test_neural.py, the
channel's walls in test_paper_rows.py; what takes minutes is slow.
"""

import argparse

import numpy as np
import pytest

pytest.importorskip("skfem")

import warp_peri as wp
from examples import hgo_square, neural_operator, neural_sets
from tools import make_leaflet as leaflet
from tools.make_hgo import make_hgo
from warp_peri.neural.material import load
from warp_peri.tissue import hyperelastic_errors, material_terms, read_material, with_corners

WITHIN = 1.3


@pytest.mark.slow
def test_a_sheet_with_fibres(tmp_path):
    """Tissue on the papers' pages, linear elements, read out, from 30 squares for 200."""
    sets = make_hgo(tmp_path, counts=(30, 0, 8, 1), jobs=1, progress=False)
    train = sets["train"]
    read = read_material(train, stiffness=hgo_square.STIFFNESS)
    solid = wp.fit(train, with_corners(read.dictionary), positive=True).material.sparse
    (fibre,) = (c for term, c in material_terms(solid) if term.kind == "fibre_exponential")
    assert fibre > 0
    assert 100 * wp.evaluate(solid, sets["test"])["E_res"] < 2.9
    disk = hyperelastic_errors(solid, sets["disks"])
    assert 100 * disk["E_u"] < 0.15
    assert disk["not_solved"] == 0


def test_a_leaflet_by_the_shipped_network(tmp_path):
    """docs/papers/jafarzadeh_2024.md, frames: two of a protocol for twenty of seven."""
    u, _ = leaflet.protocol(tmp_path, leaflet.Leaflet(), 3, levels=2)
    steps = np.argwhere(np.ones(2 * [leaflet.NODES]))
    deep = (
        np.abs(steps - leaflet.NODES // 2).max(axis=1) <= leaflet.NODES // 2 - 2 * neural_sets.REACH
    )
    material = load(neural_operator.WEIGHTS / "leaflet.json")
    x = leaflet.SPACING * (steps - leaflet.NODES // 2)
    points = wp.Points(x, deep, leaflet.SPACING, units=material.units)
    given = argparse.Namespace(json=True, solved=None)
    errors = neural_operator.errors_of(material, {"test": wp.Samples(points, u)}, given, solve=True)
    assert errors["converged"]["test"] == 1
    assert 100 * errors["E_u"]["test"] < WITHIN * 0.64
