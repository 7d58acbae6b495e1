"""Gradients of a coupled solve against differences, and what a lattice feels."""

from dataclasses import replace

import numpy as np
from numpy.random import default_rng

from tests.support import approx, assert_refused, filterwarnings, parametrize
from tests.support.plates import MODEL, plate
from tests.support.problems import slope
from warp_peri.fe_coupling.body import Coupling, body_gradient, solve_body
from warp_peri.fe_coupling.boundary_elements import BodyLoads
from warp_peri.points.points import grid_places
from warp_peri.solvers import linear

MESH = plate(8.0, 32.0, 8, 40)
stretch = lambda x: np.c_[0.01 * x[:, 0], 0.003 * np.sin(x[:, 0] / 9)]
wave = lambda x: np.c_[np.cos(x[:, 1] / 8), 0 * x[:, 0]]
H = 2.5
NODES = H * (grid_places((25, 25)) - 12)
felt = lambda b: BodyLoads({}, {}, b).density(NODES, H)


def solved(mesh=MESH, *, lam=0.0, mu=0.0, hold=0.0, pull=0.0, push=0.0):
    """The plate with every number moved a little."""
    return solve_body(
        replace(MODEL, lam=MODEL.lam + lam, mu=MODEL.mu + mu),
        mesh,
        displacement={"sides": lambda x: (1 + hold) * stretch(x)},
        traction={"hole": lambda x, n: (2e-3 + pull) * n},
        b=lambda x: (1e-4 + push) * wave(x),
        coupling=Coupling(spacing=1.0, tolerance=1e-12),
    )


@parametrize("alone", [False, True])
@filterwarnings("ignore:mesh. no triangle")
def test_the_gradient_is_the_difference(monkeypatch, alone):
    """Of elements alone, by each number, and of an iteration."""
    mesh = plate(4.0, 10.0, 5, 24) if alone else MESH
    monkeypatch.setattr(linear, "DIRECT", 4000 if alone else 10)
    rng = default_rng(1)
    half = mesh.x.max() * 0.9
    x = rng.uniform(-half, half, (60, 2))
    x = x[np.hypot(*x.T) > 9 / 32 * mesh.x.max() * 1.5]
    weight = rng.normal(size=x.shape)

    def measure(**moved):
        u = solved(mesh, **moved).displacement(x.tolist())
        return float((weight * u).sum() + 50 * (u**2).sum())

    solution = solved(mesh)
    gradient = body_gradient(solution, x, weight + 100 * solution.displacement(x), tolerance=1e-12)
    steps = {"lam": 1e-4, "mu": 1e-4, "hold": 1e-2, "pull": 1e-4, "push": 1e-5}
    slopes = {
        "lam": gradient.lam,
        "mu": gradient.mu,
        "hold": gradient.along(displacement={"sides": stretch}),
        "pull": gradient.along(traction={"hole": lambda x, n: n}),
        "push": gradient.along(b=wave),
    }
    for names in zip(steps) if alone else [("lam", "hold", "push")]:
        expected = sum(slopes[name] * steps[name] for name in names)
        along = lambda t, names=names: measure(**{name: t * steps[name] for name in names})
        assert expected == approx(slope(along, 1.0, order=2), rel=1e-6), names


@filterwarnings("ignore:mesh. no triangle")
def test_what_does_not_fit_is_refused():
    solution = solved(plate(4.0, 10.0, 5, 24))
    at = np.full((1, 2), 7.0), np.ones((1, 2))
    gradient = body_gradient(solution, *at)
    assert_refused({
        "expected parts that are held": lambda: gradient.along(displacement={"hole": (1.0, 0.0)}),
        "by_u: expected shape":
            lambda: body_gradient(solution, np.full((3, 2), 7.0), np.zeros((2, 2))),
        "tolerance: expected a number": lambda: body_gradient(solution, *at, tolerance=1.0),
        "1 positions are outside the mesh": lambda: solution.probe(np.zeros((1, 2))),
    })  # fmt: skip


def test_quadratic_densities_are_felt_as_they_are():
    b = lambda x: np.stack([1 + x[:, 0] - 0.2 * x[:, 0] * x[:, 1], x[:, 1] ** 2], axis=-1)
    assert felt(b) == approx(b(NODES), abs=1e-9)
    assert not BodyLoads({}, {}, None).density(NODES, H).any()


@parametrize("middle", [(0.9, -0.4), (1.25, 1.25)])
def test_no_force_is_lost_between_nodes(middle):
    """A bump of a triangle's size, wherever it lies; nodes alone would read .6 to 1.7 of it."""

    def b(x):
        bump = np.maximum(0.0, 1 - np.hypot(*(x - middle).T) / 3.0)
        return np.stack([bump, 0 * bump], axis=-1)

    force = 3 * np.pi  # of a cone of height 1 and radius 3
    assert felt(b)[:, 0].sum() * H**2 == approx(force, rel=0.02)
