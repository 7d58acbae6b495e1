"""A sheet's third-order energy on the fields of linear cracks: fields, derivatives, softening."""

from dataclasses import replace

import numpy as np
import pytest

from examples.cracks.cohesive_zone import CubicEnergy, HeldCracks, RowLaw, squares
from examples.cracks.straight_cracks import CrackedRectangle
from warp_peri import InputError

LAM, MU, HALF = 1.0, 0.8, (16.0, 14.0)
SHEET = CubicEnergy((LAM + MU, MU), -0.7, -6.0, 1.1)
TURNED = replace(SHEET, axis=0.4)
SLANTED = np.array([[(-4.0, -2.0), (3.0, 1.0)], [(5.0, 6.0), (9.0, 7.0)]])
PULL = np.array([[0.1, 0.3], [0.2, 1.0]])


def test_gradients_are_those_of_the_rim_and_of_a_tip():
    solid = CrackedRectangle(LAM, MU, HALF, SLANTED)
    x = solid.solve(PULL)
    edge = np.linspace(-12, 12, 7)
    by_z, by_conjugate = solid.gradients(x, edge + 1j * HALF[1])
    assert by_z + by_conjugate == pytest.approx(np.full((7, 1), 0.1 + 0.2j), abs=2e-2)
    by_z, by_conjugate = solid.gradients(x, HALF[0] + 1j * edge)
    assert 1j * (by_z - by_conjugate) == pytest.approx(np.full((7, 1), 0.3 + 1j), abs=2e-2)
    along = np.subtract(*SLANTED[0, ::-1]) @ (1, 1j)
    along, r = along / abs(along), 1e-4
    by_z, by_conjugate = solid.gradients(x, np.array([SLANTED[0, 1] @ (1, 1j) + r * along]))
    mean, turned = 2 * (LAM + MU) * by_z.real, 2 * MU * by_conjugate / along**2
    traction = (mean - turned.real)[0, 0], turned.imag[0, 0]
    K = solid.intensities(x[:, 0])[0, 1] / np.sqrt(2 * np.pi * r)
    assert traction == pytest.approx(K, rel=0.01)


def test_third_derivatives_are_those_of_the_energy():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 5, 3)) + 1j * rng.normal(size=(2, 5, 3))
    area = rng.uniform(1, 2, 5)
    tensor = TURNED.between(a, b, area)
    for held in rng.normal(size=(3, 3)):
        cubic = np.einsum("ijk,i,j,k", tensor, held, held, held) / 6
        assert cubic == pytest.approx(area @ TURNED.density(a @ held, b @ held), rel=1e-12)
    assert tensor == pytest.approx(tensor.transpose(1, 2, 0), rel=1e-12)


def test_density_is_the_third_order_of_green_strains():
    """Against λ/2 t² + μ E:E of finite strains along the axes, and the three constants."""
    for first, second in ((1.0, 0.0), (0.0, 1.0), (0.7, -0.4)):
        cubic, a = [], 1e-3
        for sign in (1, -1):
            E = (
                sign
                * a
                * np.array([first, second])
                * (1 + sign * a * np.array([first, second]) / 2)
            )
            t, q = E.sum(), (E[0] - E[1]) / 2
            finite = LAM / 2 * t**2 + MU * (E**2).sum()
            third = SHEET.t3 * t**3 + SHEET.tq2 * t * q**2 + SHEET.q3 * q**3
            cubic.append(sign * (finite + third) / a**3 / 2)
        by_z, by_conjugate = (
            np.array((first + second) / 2 + 0j),
            np.array((first - second) / 2 + 0j),
        )
        assert SHEET.density(by_z, by_conjugate) == pytest.approx(sum(cubic), rel=1e-4)
    turned = SHEET.density(np.array(0.3j), np.array(0j))
    assert turned == 0  # a rotation stores nothing


def test_a_sheet_with_a_small_crack_softens_as_a_whole_one():
    crack = np.array([[(-0.5, 0.0), (0.5, 0.0)]])
    held = HeldCracks(LAM, MU, HALF, crack, 0.25, cells=1, terms=24, cubic=SHEET, height=0.2)
    area = 4 * HALF[0] * HALF[1]
    third = area * SHEET.density(np.array(0.5 + 0j), np.array(-0.5 + 0j))
    assert held.bent[0, 0, 0] * 0.25 / 6 == pytest.approx(third, rel=0.02)


def test_a_sheet_that_softens_gives_way_earlier_and_a_stiffening_one_later():
    crack = np.array([[(-3.0, 0.0), (3.0, 0.0)]])
    law = RowLaw(
        0.2 * np.linspace(0, 1, 41), np.linspace(0, 1, 41) * np.exp(-4 * np.linspace(0, 1, 41))
    )
    strains = []
    for size in (-1.0, 0.0, 1.0):
        softer = CubicEnergy((0.0, 0.0), size, 0.0, 0.0)
        held = HeldCracks(LAM, MU, HALF, crack, 0.5, cells=2, terms=40, cubic=softer, height=0.4)
        strains.append(held.critical_strain(law))
    plain = HeldCracks(LAM, MU, HALF, crack, 0.5, cells=2, terms=40).critical_strain(law)
    assert strains[1] == plain
    assert strains[0] != plain
    assert (strains[0] - plain) * (strains[2] - plain) < 0


def test_rows_have_a_height_where_the_sheet_is_not_linear():
    with pytest.raises(InputError, match="height: expected a number > 0, got 0"):
        HeldCracks(LAM, MU, HALF, SLANTED[:1], 0.5, cubic=SHEET)
    z, area = squares(HALF, (0.5, 0.3))
    assert area.sum() == pytest.approx(4 * HALF[0] * HALF[1])
    assert abs(z.sum()) < 1e-9
