"""Atoms with free edges: a small plate with a hole, and the stiffness of edges."""

import numpy as np
import pytest

from tools.graphene import bond_length
from tools.holed_sheet import EndsPulled, Plate, Wave, edge_constants, held_samples, loads_of

PLATE = Plate((30.0, 30.0), 5.0)


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    cache = tmp_path_factory.mktemp("holes")
    return cache, held_samples(cache, plates=(PLATE,), tension=0.002, progress=False)[PLATE]


def test_a_plate_at_rest_is_pulled_and_kept(samples):
    cache, made = samples
    pulled = made[0]
    assert pulled.residual < 1e-8
    assert np.hypot(*pulled.reference.T).min() > 4.5
    ends = np.abs(pulled.reference[:, 0]) > 20
    assert (pulled.displacement[ends, 0] * pulled.reference[ends, 0] > 0).all()
    files = {file: file.stat().st_mtime_ns for file in cache.glob("*.npz")}
    assert len(files) == len(loads_of(PLATE))
    next(iter(files)).unlink()
    again = held_samples(cache, plates=(PLATE,), tension=0.002, progress=False)[PLATE]
    for a, b in zip(made, again):
        np.testing.assert_allclose(a.displacement, b.displacement, atol=1e-9)
    kept = [file for file, time in files.items() if file.stat().st_mtime_ns == time]
    assert len(kept) == len(files) - 1


def test_waves_push_nothing_as_a_whole_and_long_ones_no_edge():
    plate = Plate((60.0, 60.0), 10.0)
    x = plate.positions(bond_length())
    b = Wave(0).density(plate, x)
    turn = np.stack([-x[:, 1], x[:, 0]], axis=1)
    assert np.abs(b.sum(axis=0)).max() < 1e-12
    assert abs(np.vdot(turn, b)) < 1e-9
    assert (b[plate.edge_distance(x) < 10] == 0).all()
    assert np.abs(b).max() > 1e-5
    short = Wave(2).density(plate, x)
    assert np.abs(short.sum(axis=0)).max() < 1e-12
    assert abs(np.vdot(turn, short)) < 1e-9
    assert np.abs(short[plate.edge_distance(x) < 5]).max() > np.abs(short).max() / 2
    pull = EndsPulled(1).density(plate, x)
    assert (pull[np.abs(x[:, 1]) < 50] == 0).all()


def test_a_hole_is_as_large_as_what_is_missing():
    bond = bond_length()
    assert Plate((60.0, 60.0), 25.0).effective_radius(bond) == pytest.approx(25.0, abs=0.5)
    assert Plate((60.0, 50.0)).effective_height(bond) == pytest.approx(50.0, abs=1.0)


def test_strips_of_two_widths_tell_the_sheet_from_its_edges():
    edge = edge_constants(armchair=False)
    assert edge["E"] == pytest.approx(1.2163, rel=1e-3)  # that of the periodic sheet
    assert abs(edge["stiffness"]) < 0.5
    assert edge["tension"] < 0  # the edges of this potential want to be longer
