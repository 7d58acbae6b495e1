"""Cut bodies at rest: rates of a crack's opening, G and J, growth; inclusions, pressure."""

import numpy as np
from numpy import array, eye, pi, sqrt, zeros
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from examples import inclusion as inclusions
from examples import pressurised_crack
from examples.exact import westergaard
from examples.inclusion import Mixed
from examples.static_crack import edge_crack, static_crack
from tests.support import approx, assert_refused, clouds, near, parametrize, refused, sup
from tests.support.bodies import plate, random_breaking, solid
from tests.support.problems import everywhere, fitted_order, kernel, rotation, within
from warp_peri import CG, Cracked, Points, Solution, fracture, simulate, solve
from warp_peri.fracture import Injected, box_nodes, j_integral, rectangle_nodes, tip_shift
from warp_peri.fracture.body import cracked
from warp_peri.fracture.statics import CutSolid, crack_load


def test_a_crack_converges():
    counts = array([8, 12, 16])
    rows = [static_crack(n, 3.0, -0.28) for n in counts]
    assert fitted_order(1 / counts, [row["displacement"] for row in rows]) > 0.95
    assert fitted_order(1 / counts, [abs(row["G"]) for row in rows]) > 1.4
    assert abs(rows[-1]["J"]) < 0.01
    assert abs(rows[-1]["opening"]) < 0.015


def test_a_sign_changing_model_cracks_only_where_it_stays_definite():
    model, body = kernel("sign-changing", 3.0), plate(16, 16)
    held = (np.abs(body.x) > 5).any(1)
    CutSolid(model, body, held)
    CutSolid(model, body, held, cracks=[[(-4, 0), (4, 0)]])
    at_random = random_breaking(body, default_rng(0), 0.2)
    assert_refused({
        "negative eigenvalues": lambda: CutSolid(model, body, held, neighbour=at_random),
        "changes sign on the lattice of spacing 1, from -":
            lambda: simulate(model, Cracked(Points(body.x, ~held, 1.0), u=body.x), events=1),
    })  # fmt: skip


def test_growth_breaks_the_most_stretched_bonds_and_loses_energy():
    body = plate(20, 16)
    held = np.abs(body.x[:, 1]) > 5
    u = body.x * (0.0, 0.01)
    problem = Cracked(Points(body.x, ~held, 1.0), u=u, cracks=[[(-3, 0), (3, 0)]])
    growth = simulate(solid(), problem, events=12)
    assert (np.diff(growth["energy"]) < 0).all()
    assert growth.plot().get_xlabel() == "load"
    assert_array_equal(growth.time, growth["load"])
    assert_allclose(growth.u[held], growth.time[-1] * u[held])
    neighbour = growth.details
    assert (neighbour < 0).sum() > (body.neighbour < 0).sum()
    node = np.flatnonzero(((neighbour < 0) & (body.neighbour >= 0)).any(1))
    assert sup(body.x[node, 1]) < 3  # along the crack


@parametrize(("axes", "torn"), [((0, 1, 2), False), ((1, 2, 0), True)])
def test_j_in_space_is_that_of_a_straight_front_along_any_axis(axes, torn):
    """Of plane strain, and of a crack whose faces slide along the front."""
    h, lam, mu, place = 1 / 8, 1.3, 1.0, list(axes)
    x = box_nodes((2.5, 2.5, 1.5), h)
    model = clouds.solid(2 * h, lam, mu)
    z = x[:, 0] + 1j * x[:, 1]
    u = np.zeros_like(x)
    if torn:
        u[:, 2] = (sqrt(z - 0.5) * sqrt(z + 0.5)).imag / mu
    else:
        u[:, :2] = westergaard(x[:, :2], 0.5, 1.0, lam, mu)
    expected = pi * 0.5 / (2 * mu if torn else model.E / (1 - model.nu**2))
    turned, moved, tip = np.zeros_like(x), np.zeros_like(u), zeros(3)
    turned[:, place], moved[:, place], tip[place[0]] = x, u, -0.5
    corners = zeros((4, 3))
    corners[:, place] = [(-0.5, 0, -1), (0.5, 0, -1), (0.5, 0, 1), (-0.5, 0, 1)]
    body, nobody = fracture.lattice_body(turned, h, 2 * h), zeros(len(x), bool)
    cut = CutSolid(model, body, nobody, cracks=[corners], moves=True)
    near(j_integral(Solution(moved, None, cut, 0.0, "exact"), tip, (0.25, 0.5)), expected, 0.02)


def test_j_sees_the_crack_whose_tip_it_is_asked_about():
    """An edge crack beside others, far from its tip: two parallel ones, and one across."""
    x = rectangle_nodes(32.0, 32.0, 1.0)
    own, far = [(-20.0, 0.0), (0.5, 0.0)], [(3.0, 9.0), (20.0, 9.0)]
    others = [], [far], [far, [(3.0, -9.0), (20.0, -9.0)]], [[(9.0, 3.0), (9.0, 20.0)]]
    u = 1e-3 * x * (0.0, 1.0)
    found = []
    for more in others:
        solution = solve(solid(horizon=2.0).model, Cracked(within(x, 13), u=u, cracks=[own, *more]))
        found.append(j_integral(solution, (0.5, 0.0), (2, 5)))
    assert min(found) > 0.5 * max(found) > 0


def test_a_straight_front_in_space_spends_more_than_a_straight_cut():
    model = solid(horizon=2.0, dimension=3).model
    body = fracture.lattice_body(box_nodes((3.0, 3.0, 1.0), 1.0), 1.0, 2.0, endless=True)
    layers = fracture.lattice_body(box_nodes((3.0, 3.0, 7.0), 1.0), 1.0, 2.0)
    middle = np.flatnonzero(np.abs(layers.x[:, 2]) < 0.5)
    assert_array_equal(layers.neighbour[middle] >= 0, body.neighbour >= 0)
    assert 1.2 < fracture.apparent_toughness(model, 1.0, cells=6, length=1) < 2.2


def test_a_dead_load_releases_what_its_work_leaves_over():
    """A plate with a central crack, pulled at its ends by a stress of one; just not loose."""
    body, model = plate(24, 48), solid(0.5).model
    x, held, nothing = body.x, zeros(body.x.shape, bool), zeros(body.x.shape)
    below = np.flatnonzero((x[:, 1] == x[:, 1].min()) & (np.abs(x[:, 0]) < 1))
    held[below, 1], held[below[0], 0] = True, True
    ends = np.abs(x[:, 1:]) > 23
    b = np.where(ends, np.sign(x) * (0.0, 1.0), 0.0)
    cracks = [[[(-4.0 - d, 0.0), (4.0 + d, 0.0)]] for d in (-1, 0, 1)]
    bodies = [CutSolid(model, body, held, cracks=lines) for lines in cracks]
    fields = [one.solve(b, nothing).u for one in bodies]
    elastic = [one.energy(u) for one, u in zip(bodies, fields)]
    points = everywhere(x)
    G = fracture.energy_release(model, Cracked(points, b, nothing, free=~held), cracks)
    assert G == approx((elastic[2] - elastic[0]) / 4, rel=1e-9)  # Clapeyron: it rises
    held_too = Cracked(points, None, fields[1], free=~(held | ends))
    fixed = fracture.energy_release(model, held_too, cracks)
    assert G == approx(fixed, rel=0.02)  # the loads do not matter to an instant of growth


def test_a_tip_acts_further_than_it_is_cut():
    model = clouds.plain(3.0, 1.0, 1.0, units=("sigma", "epsilon/sigma^3"))
    plain, shifted = (edge_crack(model, 10, 0.5, shift) for shift in (0.0, tip_shift(model, 1.0)))
    assert plain > 1.1
    assert abs(shifted - 1) < 0.6 * (plain - 1)  # softer edges are left
    model = clouds.plain(2.0, 1.0, 1.0)
    assert tip_shift(model.in_units(("nm", "TPa")), 0.1) == approx(0.1 * tip_shift(model, 1.0))


def test_inclusions_converge():
    counts = array([8, 12, 16])
    errors = [inclusions.inclusion(n, *inclusions.CASES["stiff in soft"]) for n in counts]
    assert fitted_order(1 / counts, errors) > 0.95
    assert errors[-1] < 0.01


def test_one_material_is_the_plain_operator():
    body, model = plate(8, 8), solid(3.0).model
    uniform = lambda value: lambda place: np.full(place.shape[:-1], value)
    problem = Cracked(within(body.x, 3), u=body.x, cracks=[[(-2, 0.3), (2, 0.3)]])
    one = Mixed(3.0, uniform(3.0), uniform(1.0))
    assert_allclose(solve(one, problem).u, solve(model, problem).u, atol=1e-13)
    field = lambda place: np.where(np.abs(place[..., 0]) < 0.2, -2.0, 1.0)  # nodes are at ± 0.5
    with refused("expected μ > 0 and λ − μ of one sign"):
        solve(Mixed(3.0, uniform(3.0), field), problem)


def test_a_fluid_drives_a_penny():
    brittle = solid(horizon=2.0, dimension=3, toughness=0.01)
    run = simulate(brittle, Injected(within(box_nodes((8.0,) * 3, 1.0), 3), [2.0], leak=0.1))
    assert_allclose(run["pumped"], run["volume"] + 0.2 * 12)  # nodes within 2
    opened = fracture.crack_opening_volume(run.details)
    assert opened * run["pressure"][0] == approx(run["volume"][0])


def test_cracks_in_any_direction_open_by_one_volume():
    x = np.append(rectangle_nodes(24.0, 24.0, 1.0), [(0.5, 12.5), (0.5, 13.5)], axis=0)
    points, opened = within(x, 4), []  # the last is held, with bonds along one axis
    for angle in (0, 90, 45):
        half = rotation(np.radians(angle))[:, 0] * 3.9
        problem = Cracked(points, cracks=[[[0.02, 0] - half, half]], pressure=eye(2))
        opened += [fracture.crack_opening_volume(solve(kernel("1/r", 2.0), problem, solver=CG()))]
    assert opened[1:] == [approx(opened[0], rel=off) for off in (1e-6, 0.2)]


def test_a_pressurised_crack_opens_as_sneddons():
    numbers = [pressurised_crack.opening(n)[0] for n in (8, 16)]
    assert abs(numbers[1]["opening"] - 1) < 0.01
    assert abs(numbers[1]["volume"] - 1) < 0.00092
    assert abs(numbers[1]["opening"] - 1) < abs(numbers[0]["opening"] - 1)


@parametrize(
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
    stress = array([[0.3, 0.1, 0.0], [0.1, -0.2, 0.2], [0.0, 0.2, 0.4]])[:d, :d]
    edge = np.abs(body.x).max(1) > sides[0] / 2 - 1
    whole, cut = (CutSolid(model, body, edge, neighbour=n) for n in (body.neighbour, neighbour))
    load = crack_load(cut, stress)
    assert sup(load) > 1e-3
    assert sup(load.sum(0)) < 1e-13
    strain = (stress - 0.4 / (2 + d * 0.4) * np.trace(stress) * eye(d)) / 2
    there, here = (one.times((body.x @ strain)[None])[0] for one in (whole, cut))
    assert_allclose(here + load, there, atol=1e-13)
