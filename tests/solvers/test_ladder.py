"""The solver ladder: every method gives the same answer, or says why there is none."""

from dataclasses import replace

import numpy as np
import torch
from numpy.linalg import norm

from tests.support import approx, each_refused, filterwarnings, near, parametrize, refused, sup
from tests.support.clouds import plain
from tests.support.problems import kernel, lattice, manufactured, noise, normal, on_interior
from tests.support.solving import solve
from tools.benchmark import MODEL_FILE as TABLE
from tools.benchmark import lattice_of as problem
from tools.benchmark import loads, mask_of
from warp_peri import CG, Direct, Dirichlet, LPSMaterial
from warp_peri import solve as at_rest
from warp_peri.materials.lps_operator import LPSOperator

HORIZON = 3.0
linear_of = lambda points, model: LPSOperator(model, points).linear


def notched(n=40):
    """A mask with a re-entrant corner and a hole."""
    mask = np.ones((n, n - 7), bool)
    mask[n // 2 :, n // 2 :] = False
    mask[n // 4 : n // 4 + 5, 6:9] = False
    return mask


@parametrize("method", ["lu", "sine", "multigrid", "strip"])
def test_solves_recover_a_manufactured_solution_whatever_is_not_read(method):
    model = kernel("sign-changing", HORIZON, lam=-0.2)
    mask = np.ones((23, 31), bool) if method == "sine" else notched()
    points = lattice(mask, HORIZON, angle=0.4, origin=(3.0, -8.0))
    points = manufactured(model, points, 2)
    assert sup(points.u[:, ~points.interior]) > 0.1
    collar = on_interior(points, np.nan, points.u)
    load = on_interior(points, points.b, np.nan)
    solver = Direct() if method == "lu" else CG(method, tolerance=1e-11)
    solution = at_rest(model, Dirichlet(points, load, collar), solver=solver)
    solved, records = solution.u, solution.details or ()
    assert solved == approx(points.u, abs=1e-11 if method == "lu" else 2e-8)
    near(solved[:, ~points.interior], points.u[:, ~points.interior], 0)
    assert np.isnan(collar[:, points.interior]).all()  # what was given stays as it was
    left = (model.on(points)(solved) - points.b[:, points.interior]).reshape(2, -1)
    assert len(records) == 2 * (method != "lu")
    assert all(record.residual <= 1e-11 and record.iterations > 1 for record in records)
    size = norm(points.b[:, points.interior].reshape(2, -1), axis=1)
    assert (norm(left, axis=1) < 1e-9 * size).all()  # by the sweeps, not the stencil


@parametrize("kind", ["sine", "multigrid", "fft"])
def test_filters_are_symmetric_and_positive(kind):
    mask = np.ones((21, 26), bool) if kind == "sine" else notched(48)
    linear = linear_of(lattice(mask, HORIZON), kernel("sign-changing", HORIZON))
    (apply, _), grid = linear.filter(kind), linear.grid
    r, q = normal((2, 2, *grid.shape)) * grid.mask()
    a, b, scale = (apply(r) * q).sum(), (apply(q) * r).sum(), (apply(r) * r).sum()
    assert abs(a - b) < 1e-4 * scale  # single precision inside
    assert scale > 0
    assert apply(r).dtype == np.float64


def test_iterations_do_not_grow_with_the_domain():
    model = LPSMaterial.load(TABLE)
    for method, mask in (("sine", lambda n: np.ones((n, n), bool)), ("multigrid", notched)):
        iterations = []
        for n in (64, 128):
            points = lattice(mask(n), model.horizon, spacing=model.certified_on[0])
            b = normal((points.interior.sum(), 2))
            iterations.append(linear_of(points, model).inverse(b, 1e-8, method)[1].iterations)
        assert iterations[1] <= 1.25 * iterations[0]


def test_near_incompressibility_takes_few_iterations():
    """λ = 1000μ, where the other methods take hundreds to thousands."""
    model = LPSMaterial.load(TABLE)
    model = replace(model, lam=1000 * model.mu)
    linear = linear_of(problem(mask_of("disk", 50), model.horizon, model.certified_on[0]), model)
    assert linear.inverse(loads(linear.grid)["smooth"], 1e-8, "strip")[1].iterations <= 30


@filterwarnings("ignore:spacing")
def test_an_indefinite_operator_is_named_by_every_method():
    model = plain(HORIZON, D=[1.0, -0.9, 0.3], certified_on=(1.0,))
    points = lattice(8, HORIZON)
    with refused("certified on 1 Å, not on 1 Å"):  # as it says of itself
        model.on(points, transfer=False)
    operator = model.on(points, allow_uncertified=True)
    for method in ("lu", "sine", "multigrid", "strip"):
        solver = Direct() if method == "lu" else CG(method)
        with refused("nodes is indefinite"):
            solve(operator, points, noise(points), noise(points), solver=solver)
        fields = (torch.from_numpy(noise(points)) for _ in range(2))
        with refused("nodes is indefinite"):
            operator.solve(*fields, solver)


def test_methods_that_do_not_fit_and_tolerances_out_of_reach_are_refused():
    box, points = lattice(12, HORIZON), lattice(notched(), HORIZON)
    cut = replace(points, outside=np.zeros(len(points.x), bool))
    model = kernel("1/r", HORIZON)
    each_refused(lambda at, solver: solve(model, at, noise(at), noise(at), solver=solver), {
        "sine is for boxes": (points, CG("sine")),
        "is for lattices without a box": (cut, CG("multigrid")),
        "the solve stalled: residual": (box, CG("sine", tolerance=1e-17)),
    })  # fmt: skip
