"""Cut bodies at rest: rates of a crack's opening, G and J, growth, and what is refused."""

import numpy as np
import pytest

from examples.static_crack import main, static_crack
from tests.support.bodies import plate, random_breaking, solid
from tests.support.problems import fitted_order, kernel
from warp_peri import InputError, Model
from warp_peri.damage.cut_solid import CutSolid, contour_integral, energy_release, westergaard
from warp_peri.damage.lattice_body import lattice_body, rectangle
from warp_peri.damage.slow_growth import apparent_toughness, grow

SPACINGS = np.array([1 / 8, 1 / 12, 1 / 16])


@pytest.mark.parametrize("lam", [1.0, -0.28])
def test_a_crack_converges(lam):
    rows = [static_crack(round(1 / h), 3.0, lam)[0] for h in SPACINGS]
    assert fitted_order(SPACINGS, [row["displacement"] for row in rows]) > 0.95
    assert fitted_order(SPACINGS, [abs(row["G"]) for row in rows]) > 1.4
    assert abs(rows[-1]["J"]) < 0.01
    assert abs(rows[-1]["opening"]) < 0.015


@pytest.mark.slow
def test_the_numbers_of_a_thirty_second_of_the_plate():
    numbers, _ = static_crack(32, 3.0, 1.0)
    assert abs(numbers["G"]) < 0.002
    assert abs(numbers["opening"]) < 0.01
    assert abs(numbers["J"]) < 0.003


def test_an_affine_field_stays_affine_in_a_whole_body():
    body = plate(20, 20)
    u = body.x @ [[0.01, 0.002], [0.004, -0.003]]
    held = (np.abs(body.x) > 3).any(axis=1)
    solved = CutSolid(solid(0.4).model, body, held).solve(u)
    np.testing.assert_allclose(solved, u, atol=1e-14)
    assert contour_integral(solid(0.4).model, body, u, (0.0, 0.0), (3.0, 6.0)) == pytest.approx(0)


def test_a_crack_that_cuts_a_body_in_two_is_refused():
    body = plate(10, 8)
    below = body.x[:, 1] < -3
    with pytest.raises(InputError, match="40 nodes, node .* is held against 0 of its 3 rigid"):
        CutSolid(solid().model, body, below, cracks=[[(-9, 0), (9, 0)]])
    only_x = np.column_stack([np.ones(len(below), bool), below])
    with pytest.raises(InputError, match="against 2 of its 3"):
        CutSolid(solid().model, body, only_x, cracks=[[(-9, 0), (9, 0)]])


def test_a_sign_changing_model_cracks_only_where_it_stays_definite():
    model, body = kernel("sign-changing", 3.0), plate(16, 16)
    held = (np.abs(body.x) > 5).any(axis=1)
    CutSolid(model, body, held)
    CutSolid(model, body, held, cracks=[[(-4, 0), (4, 0)]])
    at_random = random_breaking(body, np.random.default_rng(0), 0.2)
    with pytest.raises(InputError, match="negative eigenvalues"):
        CutSolid(model, body, held, neighbour=at_random)
    with pytest.raises(InputError, match="changes sign"):
        grow(model, body, held, body.x, 1)


def test_growth_breaks_the_most_stretched_bonds_and_loses_energy():
    body = plate(20, 16)
    held = np.abs(body.x[:, 1]) > 5
    u = body.x * (0.0, 0.01)
    growth = grow(solid().model, body, held, u, 12, cracks=[[(-3, 0), (3, 0)]])
    assert (np.diff(growth.energy) < 0).all()
    assert (growth.neighbour < 0).sum() > (body.neighbour < 0).sum()
    node = np.flatnonzero(((growth.neighbour < 0) & (body.neighbour >= 0)).any(axis=1))
    assert np.abs(body.x[node, 1]).max() < 3  # along the crack


def test_growth_of_what_cannot_grow_is_refused():
    body = plate(20, 16)
    held = np.abs(body.x[:, 1]) > 5
    with pytest.raises(InputError, match="no_fail: expected shape .* of int"):
        grow(solid().model, body, held, body.x, 1, no_fail=held.astype(int))
    with pytest.raises(InputError, match="against 0 of its 3 rigid motions"):
        grow(solid().model, body, held & False, body.x, 1)


def test_a_growing_crack_spends_more_than_a_straight_cut():
    ratio = apparent_toughness(solid().model, 1.0, cells=10, length=2)
    assert 1.1 < ratio < 1.9


def test_the_example_prints_and_draws(tmp_path, capsys):
    assert main(["--cells", "8", "--json", "--out", str(tmp_path)]) == 0
    assert '"G"' in capsys.readouterr().out
    assert (tmp_path / "crack.png").stat().st_size > 5000


@pytest.mark.parametrize("shift", [0.0, 0.25, 0.5])
def test_j_does_not_mind_where_the_tip_stands_between_nodes(shift):
    h, (lam, mu) = 1 / 16, (1.0, 1.0)
    x = rectangle(2.5, 2.5, h)
    body = lattice_body(x, h, 3 * h)
    model = Model(lam=lam, mu=mu, alpha=1.0, D=np.ones(1), horizon=3 * h)
    u = westergaard(x - (shift * h, 0.0), 0.5, 1.0, lam, mu)
    J = contour_integral(model, body, u, (0.5 + shift * h, 0.0), (0.25, 0.5))
    assert J == pytest.approx(np.pi * 0.5 / model.E, rel=0.006)


MIRRORS = {
    "left": np.eye(2),
    "right": np.diag([-1.0, 1.0]),
    "below": np.array([[0.0, 1.0], [1.0, 0.0]]),
    "above": np.array([[0.0, 1.0], [-1.0, 0.0]]),
}


@pytest.mark.parametrize("side", MIRRORS)
@pytest.mark.parametrize("shear", [0.0, 0.3])
def test_j_is_the_same_from_whichever_side_the_crack_comes(side, shear):
    h, (lam, mu), turn = 1 / 16, (1.0, 1.0), MIRRORS[side]
    x = rectangle(2.5, 2.5, h)
    body = lattice_body(x, h, 3 * h)
    model = Model(lam=lam, mu=mu, alpha=1.0, D=np.ones(1), horizon=3 * h)
    one = x @ turn  # where the crack comes from the left
    u = (westergaard(one, 0.5, 1.0, lam, mu) + shear * one @ [[0.0, 1.0], [0.0, 0.0]]) @ turn.T
    tip = tuple(turn @ (0.5, 0.0))
    J = contour_integral(model, body, u, tip, (0.25, 0.5))
    if not shear:
        assert J == pytest.approx(np.pi * 0.5 / model.E, rel=0.006)
    left = westergaard(x, 0.5, 1.0, lam, mu) + shear * x @ [[0.0, 1.0], [0.0, 0.0]]
    assert J == pytest.approx(contour_integral(model, body, left, (0.5, 0.0), (0.25, 0.5)))


def test_the_other_tip_of_one_crack_has_the_same_j():
    body, model = plate(32, 24), solid(0.4).model
    held = np.abs(body.x[:, 1]) > 9
    u = CutSolid(model, body, held, cracks=[[(-5, 0), (5, 0)]]).solve(body.x * (0, 0.01))
    ends = [contour_integral(model, body, u, (tip, 0.0), (3.0, 6.0)) for tip in (5.0, -5.0)]
    assert ends[0] > 0
    assert ends[1] == pytest.approx(ends[0])


def dead_load(width, height, half):
    """A plate with a central crack, pulled at its ends by a stress of one; just not loose."""
    body, model = plate(width, height), solid(0.5).model
    held = np.zeros((len(body.x), 2), bool)
    below = np.flatnonzero((body.x[:, 1] == body.x[:, 1].min()) & (np.abs(body.x[:, 0]) < 1))
    held[below, 1], held[below[0], 0] = True, True
    b = np.where(np.abs(body.x[:, 1:]) > height / 2 - 1, np.sign(body.x) * (0.0, 1.0), 0.0)
    cracks = [[[(-half - d, 0.0), (half + d, 0.0)]] for d in (-1, 0, 1)]
    return model, body, held, b, cracks


def test_a_dead_load_releases_what_its_work_leaves_over():
    model, body, held, b, cracks = dead_load(24, 48, 4.0)
    nothing = np.zeros_like(body.x)
    G = energy_release(model, body, held, nothing, cracks, b=b)
    bodies = [CutSolid(model, body, held, cracks=lines) for lines in cracks]
    fields = [one.solve(nothing, b) for one in bodies]
    elastic = [one.energy(u) for one, u in zip(bodies, fields)]
    assert G == pytest.approx((elastic[2] - elastic[0]) / 4, rel=1e-9)  # Clapeyron: it rises
    ends = np.abs(body.x[:, 1]) > 23
    fixed = energy_release(model, body, held | ends[:, None], fields[1], cracks)
    assert G == pytest.approx(fixed, rel=0.02)  # the loads do not matter to an instant of growth
    crooked = held | (ends & (body.x[:, 1] < 0))[:, None]
    both = energy_release(model, body, crooked, 0.3 * body.x * (0, 1), cracks, b=b)
    potential = []
    for lines in cracks:
        one = CutSolid(model, body, crooked, cracks=lines)
        u = one.solve(0.3 * body.x * (0, 1), b)
        potential.append(one.energy(u) - (b * u).sum())
    assert both == pytest.approx((potential[0] - potential[2]) / 4, rel=1e-9)
    assert both > 0


def test_a_dead_load_on_a_strip_releases_what_is_known_of_it():
    model, body, held, b, cracks = dead_load(32, 64, 6.0)
    G = energy_release(model, body, held, np.zeros_like(body.x), cracks, b=b)
    known = np.pi * 6 / np.cos(np.pi * 6 / 32) / model.E  # C. E. Feddersen, 1966
    assert G == pytest.approx(known, rel=0.1)


def test_nothing_released_is_zero_without_a_sign():
    model, body, held, _, cracks = dead_load(16, 16, 3.0)
    G = energy_release(model, body, held, np.zeros_like(body.x), cracks)
    assert str(G) == "0.0"
    with pytest.raises(InputError, match=r"b: expected shape \[256, 2\]"):
        energy_release(model, body, held, np.zeros_like(body.x), cracks, b=np.ones(256))


def test_the_release_of_an_inclined_crack_needs_several_lengths():
    h, half, angle = 1 / 12, 0.5, np.radians(30)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    model = Model(lam=1.0, mu=1.0, alpha=1.0, D=np.ones(1), horizon=3 * h)
    body = lattice_body(rectangle(2.5, 2.5, h), h, model.horizon)
    held = (np.abs(body.x) > 1).any(axis=1)
    middle = np.array([0.05, 0.02])
    u = westergaard((body.x - middle) @ turn, half, 1.0, 1.0, 1.0) @ turn.T
    cracks = [
        [np.array([(-half - d * h, 0.0), (half + d * h, 0.0)]) @ turn.T + middle]
        for d in np.linspace(-2, 2, 9)
    ]
    G = energy_release(model, body, held, u, cracks)
    assert G == pytest.approx(np.pi * half / model.E, rel=0.03)


def test_contours_and_lengths_that_make_no_sense_are_refused():
    body, model = plate(20, 20), solid().model
    held, u = np.zeros(400, bool), np.zeros((400, 2))
    for radii in ((4.0, 4.0), (3.6, 4.4), (4.0, np.nan)):
        with pytest.raises(InputError, match="smaller < larger by a spacing of 1"):
            contour_integral(model, body, u, (0.0, 0.0), radii)
    with pytest.raises(InputError, match=r"u: expected shape \[400, 2\]"):
        contour_integral(model, body, u[:3], (0.0, 0.0), (2.0, 4.0))
    with pytest.raises(InputError, match="more than from the tip to the edge"):
        contour_integral(model, body, u, (6.0, 0.0), (2.0, 6.0))
    with pytest.raises(InputError, match="two lengths or more"):
        energy_release(model, body, held | True, u, [[[(-4, 0), (4, 0)]]])
    short = CutSolid(model, body, (np.abs(body.x) > 5).any(axis=1))
    with pytest.raises(InputError, match=r"u: expected shape \[400, 2\]"):
        short.solve(u[:, 0])
    with pytest.raises(InputError, match="finite numbers where"):
        short.solve(u + np.nan)
    with pytest.raises(InputError, match="body: expected the horizon 4"):
        CutSolid(Model(1.0, 1.0, 1.0, np.ones(1), 4.0), body, held)
