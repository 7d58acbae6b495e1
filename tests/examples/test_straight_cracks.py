"""Straight cracks in a rectangle: textbook intensities, energies of cut lattices, refusals."""

import numpy as np
import pytest

from examples.cracks.straight_cracks import CrackedRectangle
from warp_peri import InputError, Model, Points
from warp_peri.damage import energy_release
from warp_peri.damage.lattice_body import rectangle
from warp_peri.damage.problems import Cracked

LAM, MU = 1.0, 0.8
PULL = np.array([[0.3, 0.2], [0.0, 1.0]])


def along(angle, half):
    tip = half * np.array([np.cos(angle), np.sin(angle)])
    return np.array([-tip, tip])


def stress(strain):
    both = (strain + strain.T) / 2
    return 2 * MU * both + LAM * np.trace(both) * np.eye(2)


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.0])
def test_a_crack_in_a_wide_sheet_has_the_textbook_intensities(angle):
    sheet = CrackedRectangle(LAM, MU, (60.0, 50.0), [along(angle, 1.0)])
    found = sheet.intensities(sheet.solve(PULL)[:, 0])
    normal, ahead = np.array([-np.sin(angle), np.cos(angle)]), along(angle, 1.0)[1]
    pull = stress(PULL) @ normal * np.sqrt(np.pi)
    assert found[0, 1] == pytest.approx([pull @ normal, pull @ ahead], rel=2e-3)
    assert found[0, 0] == pytest.approx(found[0, 1], rel=2e-3)


CROWD = np.array(
    [[(-9, 5), (-2, 3)], [(-7, -4), (1, -4)], [(6, -5), (6, 6)], [(8, 3), (12, -4)]], float
)


def energy_lost(cracks):
    """Half the work of the whole sheet's stress on the openings: what cracks take at one rim."""
    sheet = CrackedRectangle(LAM, MU, (16.0, 10.0), cracks)
    x = sheet.solve(PULL)[:, 0]
    angle = (np.arange(400) + 0.5) * np.pi / 400
    lost = 0.0
    for k, (start, end) in enumerate(cracks):
        ahead = (end - start) / np.hypot(*(end - start))
        pull = stress(PULL) @ (-ahead[1], ahead[0])
        gap = sheet.opening(x, k, np.cos(angle))
        work = gap.real * (pull @ (-ahead[1], ahead[0])) + gap.imag * (pull @ ahead)
        lost += (work * np.sin(angle)).sum() * np.pi / 400 * sheet.length[k] / 2
    return lost


@pytest.mark.parametrize(("crack", "tip"), list(np.ndindex(4, 2)))
def test_each_tip_of_any_cracks_releases_what_its_growth_takes(crack, tip):
    out = CROWD[crack, tip] - CROWD[crack, 1 - tip]
    out = 0.01 * out / np.hypot(*out)
    longer, shorter = CROWD.copy(), CROWD.copy()
    longer[crack, tip] += out
    shorter[crack, tip] -= out
    sheet = CrackedRectangle(LAM, MU, (16.0, 10.0), CROWD)
    released = sheet.releases(sheet.solve(PULL)[:, 0])[crack, tip]
    assert (energy_lost(longer) - energy_lost(shorter)) / 0.02 == pytest.approx(released, rel=4e-3)


def test_stacked_cracks_release_what_a_cut_lattice_does():
    cracks = np.array([[(-8, 4), (4, 4)], [(-4, -4), (8, -4)]], float)
    model = Model(lam=LAM, mu=MU, alpha=1.0, D=np.ones(1), horizon=3.0)
    x = rectangle(46, 42, 1.0)
    half = (20.5, 18.5)  # the first nodes that are held
    free = (np.abs(x) < np.array(half) - 0.1).all(axis=1)
    problem = Cracked(Points(x, free, 1.0), u=x * (0.0, 1.0))
    sheet = CrackedRectangle(LAM, MU, half, cracks)
    expected = sheet.releases(sheet.solve([[0, 0], [0, 1]])[:, 0])[0]
    found = []
    for tip, out in enumerate((-1, 1)):
        sets = [cracks.copy(), cracks.copy()]
        sets[0][0, tip, 0] += out
        sets[1][0, tip, 0] -= out
        found.append(energy_release(model, problem, [list(one) for one in sets]))
    assert found == pytest.approx(expected, rel=0.03)
    assert abs(expected[0] / expected[1] - 1) > 0.06  # tips that differ by more than is allowed


def test_cracks_and_rectangle_turned_together_release_the_same():
    cracks = np.array([[(-5.0, 2.0), (3.0, 4.0)], [(-2.0, -3.0), (6.0, -2.0)]])
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    straight = CrackedRectangle(LAM, MU, (12.0, 8.0), cracks)
    turned = CrackedRectangle(LAM, MU, (8.0, 12.0), cracks @ quarter.T)
    first = straight.releases(straight.solve(PULL)[:, 0])
    second = turned.releases(turned.solve(quarter @ PULL @ quarter.T)[:, 0])
    assert second == pytest.approx(first, rel=1e-4)


@pytest.mark.parametrize(
    ("cracks", "word"),
    [
        ([[(-2, 0), (9, 0)]], "within"),
        ([[(1, 1), (1, 1)]], "a length"),
        ([[(-2, 0), (2, 0)], [(0, -1), (0, 1)]], "meets another"),
        ([[(-2, 0), (2, 0)], [(1, 0), (3, 0)]], "meets another"),
        ([(-2, 0), (2, 0)], "shape"),
        ([[(-2, 0), (np.nan, 0)]], "finite"),
    ],
)
def test_cracks_that_leave_meet_or_vanish_are_refused(cracks, word):
    with pytest.raises(InputError, match=word):
        CrackedRectangle(LAM, MU, (8.0, 8.0), cracks)


def test_too_few_terms_and_unstable_solids_are_refused():
    crack = [[(-7.6, 0.0), (0.0, 7.6)]]
    with pytest.raises(InputError, match="more terms"):
        CrackedRectangle(LAM, MU, (8.0, 8.0), crack, terms=4, degree=6).solve(PULL)
    with pytest.raises(InputError, match="λ \\+ μ > 0"):
        CrackedRectangle(-1.0, MU, (8.0, 8.0), crack)
