"""Rows of bonds that turn off at tips: beside straight ones, mirrored, and what is refused."""

import numpy as np
import pytest

from examples.cracks.cohesive_zone import CubicEnergy, HeldCracks, RowLaw
from examples.cracks.kinked_cracks import KinkedCracks
from warp_peri import InputError

LAM, MU, HALF = 1.0, 0.8, (16.0, 14.0)
SHEET = CubicEnergy((LAM + MU, MU), -0.7, -6.0, 1.1)
SEPARATION = np.linspace(0, 1, 41)
LAW = RowLaw(0.2 * SEPARATION, SEPARATION * np.exp(-4 * SEPARATION))
STRAIGHT = np.array([[(-5.0, 1.0), (4.0, 1.0)]])
SLANTED = np.array([[(-5.0, -2.0), (3.0, 3.0)]])


def test_rows_that_go_straight_on_are_those_of_cracks_along_rows():
    straight = HeldCracks(LAM, MU, HALF, STRAIGHT, 0.5, cubic=SHEET, height=0.9)
    pieces = KinkedCracks(LAM, MU, HALF, STRAIGHT, 0.5, cubic=SHEET, height=0.9)
    assert pieces.kinks == pytest.approx(np.zeros((1, 2)), abs=1e-9)
    order = np.argsort(pieces.bonds[:, 0])
    both = np.append(order, 8 + order)
    assert pieces.bonds[order] == pytest.approx(straight.bonds)
    assert pieces.drive[order[1:7]] == pytest.approx(straight.drive[1:7], rel=0.04)
    size = np.abs(straight.compliance).max()
    off = pieces.compliance[np.ix_(both, both)] - straight.compliance
    assert np.abs(off).max() < 0.08 * size
    strains = [held.critical_strain(LAW) for held in (pieces, straight)]
    assert strains[0] == pytest.approx(strains[1], rel=5e-3)


def test_a_tip_turns_into_the_row_that_opens_most():
    held = KinkedCracks(LAM, MU, HALF, SLANTED, 0.5)
    assert np.degrees(held.kinks) == pytest.approx(np.full((1, 2), -np.degrees(np.arctan2(5, 8))))
    right = held.bonds[4:] - SLANTED[0, 1]
    assert right == pytest.approx(np.outer(0.5 * np.arange(4) + 0.25, (1, 0)), abs=1e-9)
    off = held.compliance - held.compliance.T  # Betti, to what constant pieces leave
    assert np.abs(off).max() < 0.08 * np.abs(held.compliance).max()
    assert np.linalg.eigvalsh(held.compliance + held.compliance.T).min() > 0


def test_mirrored_cracks_open_at_one_strain_and_a_sheet_has_no_units():
    given = {"cells": 2, "cubic": SHEET, "height": 0.9}
    strain = KinkedCracks(LAM, MU, HALF, SLANTED, 1.0, **given).critical_strain(LAW)
    other = KinkedCracks(LAM, MU, HALF, SLANTED * (1, -1), 1.0, **given).critical_strain(LAW)
    assert other == pytest.approx(strain, rel=1e-6)
    wide, law = (32.0, 28.0), RowLaw(2 * LAW.separation, LAW.traction)
    given["height"] = 1.8
    double = KinkedCracks(LAM, MU, wide, 2 * SLANTED, 2.0, **given).critical_strain(law)
    assert double == pytest.approx(strain, rel=1e-6)
    linear = KinkedCracks(LAM, MU, HALF, SLANTED, 1.0, cells=2).critical_strain(LAW)
    assert linear != pytest.approx(strain, rel=0.01)


@pytest.mark.parametrize(
    ("cracks", "step", "message"),
    [
        (SLANTED, 0.0, "step: expected a number > 0"),
        ([[(8.0, 0.0), (13.0, 2.0)]], 1.0, "the rim is nearer"),
        ([[(-5.0, 0.0), (0.0, 1.0)], [(1.0, 0.5), (5.0, 3.0)]], 0.5, "1's meet another's"),
    ],
)
def test_rows_without_room_are_refused(cracks, step, message):
    with pytest.raises(InputError, match=message):
        KinkedCracks(LAM, MU, HALF, cracks, step)
