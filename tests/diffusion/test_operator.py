"""Nonlocal diffusion: gradients, orders, what it keeps, coupling, and what it refuses."""

from dataclasses import replace

import numpy as np
from numpy.linalg import eigvalsh, norm
from numpy.random import default_rng

from examples import diffusion
from examples.diffusion import coupled, jump, smooth
from tests.support import approx, in_plane_and_space, near, parametrize, sup
from tests.support.clouds import cloud, larger, plain
from tests.support.problems import cut, fitted_order, kernel, normal, within
from tests.support.told import assert_refused, refused, warned
from warp_peri import Dirichlet, Points, simulate, solve
from warp_peri.diffusion import DiffusionMaterial, DiffusionOperator, ThermoelasticMaterial
from warp_peri.points.arguments import USUAL
from warp_peri.points.points import grid_places

CELLS = np.array([6, 9, 13])
SOLID = plain(0.75, 1.5, 1.0)
square = lambda cells, reach: replace(diffusion.square(cells, reach), units=USUAL)
"""The example's square, in the units that points have by default."""


def steady(operator, phi, source=None):
    """φ at rest."""
    return solve(operator, Dirichlet(operator.points, source, phi)).u


def test_errors_fall_with_their_orders():
    assert fitted_order(1 / CELLS, [smooth(n, 0.0) for n in CELLS]) > 1.95
    assert fitted_order(1 / CELLS, [smooth(n, 0.2) for n in CELLS]) > 1.9
    assert fitted_order(1 / CELLS, [jump(n) for n in CELLS]) > 0.95
    for errors in np.transpose([coupled(n) for n in CELLS]):
        assert fitted_order(1 / CELLS, errors) > 1.95


@in_plane_and_space
def test_linear_fields_carry_no_flux_and_parabolas_that_of_their_laplacian(d):
    x = grid_places(d * (9,)) - 4.0
    points, square = within(x, 2), (x * x).sum(1)
    operator = DiffusionOperator(DiffusionMaterial(3.0, 0.7), points)
    assert sup(operator(x @ np.arange(1, d + 1))) < 1e-11
    assert operator(square) == approx(-2 * d * 0.7)
    near(steady(operator, square, np.full(len(x), -2 * d * 0.7)), square, 1e-10)


def test_periodic_lattices_keep_their_content_and_a_wave_decays_as_it_should():
    points = Points.sheet((24, 24), 1.0)
    kappa = default_rng(0).uniform(0.1, 3, len(points.x))
    uneven = DiffusionOperator(DiffusionMaterial(3.0, 1.0), points, kappa=kappa)
    assert abs(uneven(normal(len(points.x), 1)).sum()) < 1e-11
    assert abs(uneven.matrix - uneven.matrix.T).max() < 1e-13
    k = 2 * np.pi / 24
    phi = np.cos(k * points.x[:, 0])
    operator = DiffusionOperator(DiffusionMaterial(3.0, conductivity=2.0), points)
    history = simulate(operator, Dirichlet(points, None, phi), step=0.5, steps=20)["u"]
    assert isinstance(history, np.ndarray)
    rate = (operator(phi) / phi)[0]
    near(rate, 2 * k**2, 0.03)
    near(history[-1], (((1 - rate / 4) / (1 + rate / 4)) ** 20) * phi, 1e-12, 1)


def test_a_hole_is_insulated():
    points = square(8, 4.0)
    points = cut(points, np.hypot(*points.x.T) < 0.3)
    phi = steady(DiffusionMaterial(3 / 8, 1.0).on(points), points.x[:, 0])
    assert sup(phi[points.interior]) < 1
    right = (points.x[:, 0] > 0.3) & (points.x[:, 0] < 0.5) & (np.abs(points.x[:, 1]) < 0.2)
    assert (phi[right] > points.x[right, 0]).all()  # it piles up before the hole


@parametrize("lattice", [True, False])
def test_a_kernel_that_changes_sign_is_taken_where_diffusion_does_not_grow(lattice):
    points = larger(square(4, 4.0), 4) if lattice else cloud(8, 3.2)
    phi = normal(len(points.x))
    phi *= points.interior
    for last, grows in ((-1.0, True), (-0.05, False)):
        law = DiffusionMaterial(3.2, 1.0, D=np.array([1.0, 1.0 if grows else 0.2, last]))
        operator, problem = law.on(points), Dirichlet(points, None, phi)
        inner = operator.matrix[:, operator.rows].toarray()
        assert (eigvalsh((inner + inner.T) / 2) < 0).any() == grows
        if not grows:
            history = simulate(operator, problem, step=5.0, steps=40)["u"]
            assert (np.diff(norm(history, axis=1)) <= 1e-12).all()
            continue
        for call in (solve, lambda *of: simulate(*of, step=0.1, steps=3)):
            with refused("L \\+ Lᵗ has eigenvalues below zero"):
                call(operator, problem)


def test_steps_of_a_coupled_solid_come_to_its_steady_state():
    points, random = square(4, 6.0), default_rng(0)
    solid = ThermoelasticMaterial(SOLID, DiffusionMaterial(0.75, 1.0), coupling=0.7, storage=0.3)
    problem = Dirichlet(points, *random.standard_normal((2, len(points.x), 3)))
    found = solve(solid, problem)
    near(found.operator(found.u), found.load, 1e-9, 1)
    near(simulate(solid, problem, step=50.0, steps=8).u, found.u, 1e-6, 1)
    with warned("storage: none is stated"):
        simulate(replace(solid, storage=0.0), problem, step=50.0, steps=1)


@parametrize("coupling", [0.0, 1e-12, 1e-4, 1e6])
def test_at_rest_a_coupled_solid_conducts_as_its_conductor(coupling):
    heat, points = DiffusionMaterial(0.75, 1.0), square(4, 6.0)
    b, u = default_rng(0).standard_normal((2, len(points.x), 3))
    found = solve(ThermoelasticMaterial(SOLID, heat, coupling, 0.3), Dirichlet(points, b, u))
    near(found.u[:, 2], solve(heat, Dirichlet(points, b[:, 2], u[:, 2])).u, 1e-12)
    assert found.residual < 1e-12
    assert solve(found.operator, Dirichlet(points, b[None][:0], u[None][:0])).u.shape[0] == 0
    warm = np.full(b.shape, [0.0, 0.0, 300.0])  # whose pull is zero inside
    scale = [1 + coupling, 1 + coupling, 1.0]
    near(solve(found.operator, Dirichlet(points, None, warm)).u / scale, warm, 1e-12)


def test_what_does_not_fit_is_refused():
    points, law = square(3, 6.0), DiffusionMaterial(1.0, 1.0)
    metres, wide = DiffusionMaterial(1.0, 1.0, units=("m", "Pa")), larger(points, 3)
    bad = DiffusionMaterial(3.0, 1.0, D=np.array([1.0, 1.0, -1.0]))
    torn = cut(wide, default_rng(0).uniform(size=len(wide.x)) < 0.4)
    operator, x = law.on(points), points.x[:, 0]

    def flow(collar=None, b=None):
        return simulate(operator, Dirichlet(points, b, x), step=0.1, steps=2, collar=collar)

    kept = 0 * x  # of a function that fills one array
    near(flow(b=lambda t: np.multiply(t, x, out=kept)).u, flow(b=lambda t: t * x).u, 0)
    coupled = ThermoelasticMaterial(SOLID, DiffusionMaterial(0.75, 1.0), 1.0, 1.0)
    rest, three = np.zeros((len(x), 3)), replace(SOLID, horizon=3.0)
    soft = ThermoelasticMaterial(
        kernel("sign-changing", 3.0), DiffusionMaterial(3.0, 1.0), 1.0, 1.0
    )
    soft.on(wide)  # torn, its bonds leave negative eigenvalues
    assert_refused({
        "one a node": lambda: law.on(points, kappa=np.ones(3)),
        "one a position": lambda: law.on(points, kappa=lambda x: np.ones(3)),
        "finite values > 0, got -1": lambda: law.on(points, kappa=-1.0),
        "finite values > 0, got -": lambda: law.on(points, kappa=lambda x: x[..., 0]),
        "conductivity: expected a number > 0": lambda: DiffusionMaterial(0.8, conductivity=-1.0),
        "storage": lambda: ThermoelasticMaterial(SOLID, law, 1.0, -1.0),
        "units: the model is in":
            (lambda: ThermoelasticMaterial(SOLID, metres, 1.0, 1.0), lambda: metres.on(points)),
        "eigenvalues below zero": lambda: ThermoelasticMaterial(three, bad, 1.0, 1.0).on(wide),
        "negative eigenvalues": lambda: soft.on(torn),
        "collar: expected shape": (lambda: flow(0.0), lambda: flow([])),
        "b: expected a field at t = 0.1": (
            lambda: flow(b=np.ndarray), lambda: flow(b=lambda t: {}[t]),
        ),
        "kappa: expected float values": lambda: law.on(points, kappa=np.ndarray),
        "b: expected shape": (
            lambda: flow(b=lambda t: x[: int(10 * t)]),
            lambda: solve(coupled, Dirichlet(points, rest[:, 0], rest)),
        ),
        r"among alpha \[\], D \[1\], kappa \[\], got mu":
            lambda: solve(law, Dirichlet(points, None, x), parameters={"mu": 2.0}),
    })  # fmt: skip
