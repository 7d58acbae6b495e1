"""Inclusions and pressurised cracks against exact fields."""

import numpy as np
import pytest

from examples import inclusion as inclusions
from examples import pressurised_crack
from examples.inclusion import Mixed
from tests.support.bodies import plate, solid
from warp_peri import InputError, Points, simulate, solve
from warp_peri.fracture import Cracked, Injected, box_nodes, crack_opening_volume
from warp_peri.fracture.body import cracked
from warp_peri.fracture.statics import CutSolid, crack_load

CELLS = np.array([8, 12, 16])


def test_inclusions_converge():
    errors = [inclusions.inclusion(n, *inclusions.CASES["stiff in soft"]) for n in CELLS]
    assert -np.polyfit(np.log(CELLS), np.log(errors), 1)[0] > 0.95
    assert errors[-1] < 0.01


def test_one_material_is_the_plain_operator():
    body, model = plate(8, 8), solid(3.0).model
    uniform = lambda value: lambda place: np.full(place.shape[:-1], value)
    points = Points(body.x, np.abs(body.x).max(axis=1) < 3, 1.0)
    problem = Cracked(points, u=body.x, cracks=[[(-2, 0.3), (2, 0.3)]])
    one = Mixed(3.0, uniform(3.0), uniform(1.0))
    np.testing.assert_allclose(solve(one, problem).u, solve(model, problem).u, atol=1e-13)
    field = lambda place: np.where(np.abs(place[..., 0]) < 0.2, -2.0, 1.0)  # nodes are at ± 0.5
    with pytest.raises(InputError, match="expected μ > 0 and λ − μ of one sign"):
        solve(Mixed(3.0, uniform(3.0), field), problem)


def test_a_fluid_drives_a_penny():
    x = box_nodes((8.0,) * 3, 1.0)
    points = Points(x, np.abs(x).max(axis=1) < 3, 1.0)
    brittle = solid(horizon=2.0, dimension=3, toughness=0.01)
    run = simulate(brittle, Injected(points, [2.0], leak=0.1))
    np.testing.assert_allclose(run["pumped"], run["volume"] + 0.2 * 12)  # nodes within 2
    assert crack_opening_volume(run.details) * run["pressure"][0] == pytest.approx(run["volume"][0])


def test_a_pressurised_crack_opens_as_sneddons():
    numbers = [pressurised_crack.opening(n)[0] for n in (8, 16)]
    assert abs(numbers[1]["opening"] - 1) < 0.01
    assert abs(numbers[1]["volume"] - 1) < 0.00092
    assert abs(numbers[1]["opening"] - 1) < abs(numbers[0]["opening"] - 1)


@pytest.mark.parametrize(
    ("sides", "crack"),
    [
        ((16, 16), [(-3, 0.5), (4, 2.2)]),
        ((6, 6, 6), [(-1, -0.1, -1), (1, -0.1, -1), (1, 0.3, 1), (-1, 0.3, 1)]),
    ],
)
def test_the_load_of_a_crack_undoes_it(sides, crack):
    d = len(sides)
    body, model = plate(*sides), solid(0.4, dimension=d).model
    neighbour = cracked(body, [crack])
    stress = np.array([[0.3, 0.1, 0.0], [0.1, -0.2, 0.2], [0.0, 0.2, 0.4]])[:d, :d]
    edge = np.abs(body.x).max(axis=1) > sides[0] / 2 - 1
    whole, cut = (CutSolid(model, body, edge, neighbour=n) for n in (body.neighbour, neighbour))
    load = crack_load(cut, stress)
    assert np.abs(load).max() > 1e-3
    assert np.abs(load.sum(axis=0)).max() < 1e-13
    strain = (stress - 0.4 / (2 + d * 0.4) * np.trace(stress) * np.eye(d)) / 2
    there, here = (one.times((body.x @ strain)[None])[0] for one in (whole, cut))
    np.testing.assert_allclose(here + load, there, atol=1e-13)
