"""Rows of bonds ahead of tips: their compliance, Griffith's limit, rows in line."""

import numpy as np
import pytest

from examples.cracks.cohesive_zone import HeldCracks, RowLaw
from examples.cracks.straight_cracks import CrackedRectangle
from warp_peri import InputError

LAM, MU, HALF = 1.0, 0.8, (16.0, 14.0)
SEPARATION = np.linspace(0, 1, 41)
TRACTION = SEPARATION * np.exp(-4 * SEPARATION)
PAIR = np.array([[(-7.0, 2.0), (-1.0, 2.0)], [(1.0, -1.0), (6.0, -1.0)]])


def test_unit_tractions_close_as_they_are_closed():
    held = HeldCracks(LAM, MU, HALF, PAIR, 0.5)
    assert held.bonds.shape == (16, 2)
    assert np.allclose(np.unique(held.bonds[:, 1]), (-1, 2))
    off = held.compliance - held.compliance.T  # Betti
    assert np.abs(off).max() < 1e-3 * np.abs(held.compliance).max()
    assert np.linalg.eigvalsh(held.compliance + held.compliance.T).min() > 0


def test_a_zone_much_shorter_than_its_crack_ends_where_griffith_says():
    crack = np.array([[(-5.0, 0.0), (5.0, 0.0)]])
    law = RowLaw(0.05 * SEPARATION, TRACTION)
    elastic = law.traction[-1] ** 2 / law.stiffness / 2
    spent = 0.05 * np.trapezoid(TRACTION, SEPARATION) - elastic
    solid = CrackedRectangle(LAM, MU, HALF, crack)
    release = solid.releases(solid.solve([[0, 0], [0, 1]])[:, 0]).max()
    found = HeldCracks(LAM, MU, HALF, crack, 0.25).critical_strain(law)
    assert found == pytest.approx(np.sqrt(spent / release), rel=0.1)


def test_cracks_of_one_row_share_the_bonds_between_them():
    line = np.array([[(-6.0, 0.0), (-1.0, 0.0)], [(1.0, 0.0), (6.0, 0.0)]])
    held = HeldCracks(LAM, MU, HALF, line, 0.5)
    assert sorted(held.bonds[np.abs(held.bonds[:, 0]) < 1, 0]) == pytest.approx(
        [-0.75, -0.25, 0.25, 0.75]
    )
    assert len(held.bonds) == 12
    law = RowLaw(0.2 * SEPARATION, TRACTION)
    alone = HeldCracks(LAM, MU, HALF, line[1:], 0.5)
    assert held.critical_strain(law) < alone.critical_strain(law)


def test_a_crack_need_not_be_a_whole_number_of_steps_long():
    crack = np.array([[(-3.1, 0.0), (3.1, 0.0)]])
    held = HeldCracks(LAM, MU, HALF, crack, 0.5)
    x = np.sort(held.bonds[:, 0])
    assert x == pytest.approx(-x[::-1])  # as far ahead of either tip
    assert x[4:] == pytest.approx(3.1 + 0.5 * (np.arange(4) + 0.5))
    law = RowLaw(0.2 * SEPARATION, TRACTION)
    strains = [
        HeldCracks(LAM, MU, HALF, crack * scale, 0.5).critical_strain(law)
        for scale in (3.0 / 3.1, 1.0, 3.25 / 3.1)
    ]
    assert strains[0] > strains[1] > strains[2]


def test_a_path_ends_at_the_end_of_the_law_and_balances():
    held = HeldCracks(LAM, MU, HALF, PAIR, 0.5)
    law = RowLaw(0.2 * SEPARATION, TRACTION)
    strains, openings = held.opened(law)
    assert openings[-1].max() == pytest.approx(0.2)
    assert held.critical_strain(law) == strains.max()
    assert held.critical_strain(law.times(1.2)) > 1.05 * strains.max()
    for opening in openings[1:]:
        assert (opening > -1e-3).all()


def test_laws_that_do_not_begin_at_rest_are_refused():
    with pytest.raises(InputError, match="law: expected separations"):
        RowLaw(SEPARATION, TRACTION + 0.1)
    with pytest.raises(InputError, match="law: expected separations"):
        RowLaw(SEPARATION[::-1], TRACTION)
    with pytest.raises(InputError, match="step: expected a number > 0"):
        HeldCracks(LAM, MU, HALF, PAIR, 0.0)
