"""Forward solves, with a Dirichlet collar and on a periodic sheet."""

from dataclasses import replace

import meshio
import numpy as np
import torch
from numpy.linalg import eigvalsh
from numpy.testing import assert_array_equal
from scipy.optimize import brentq

from tests.crystal.crystals import learned
from tests.support import approx, each_refused, filterwarnings, parametrize, refused, sup
from tests.support.clouds import plain
from tests.support.problems import ell, kernel, lattice, manufactured, noise, on_interior
from tests.support.solving import solve
from warp_peri import Cracked, Dirichlet, LPSMaterial, Periodic, Points, evaluate
from warp_peri import solve as at_rest
from warp_peri.materials.lps_operator import LPSOperator
from warp_peri.solvers.linear import DIRECT

HORIZON = 3.0  # at which all of them are
passing = lambda a: plain(HORIZON, D=[1.0, a, 0.3], certified_on=(1.0,))
"""A kernel that passes through singular ones as a grows, taken as certified."""


def test_the_residual_is_that_of_the_worst_load():
    model = kernel("1/r", HORIZON, lam=-0.2)
    points = manufactured(model, lattice(ell(), HORIZON), 2)
    solution = at_rest(model, Dirichlet(points.points, points.b, points.u))
    spoiled = solution.u.copy()
    spoiled[1, np.flatnonzero(points.interior)[0]] += sup(points.u)
    assert replace(solution, u=spoiled, measured=None).residual > 1e-3


@filterwarnings("ignore:spacing")
@parametrize(("interior", "low", "high"), [(1, -0.9, -0.8), (ell(), -0.775, -0.75)])
def test_a_singular_operator_is_refused(interior, low, high):
    points = lattice(interior, HORIZON)
    unknown, on = np.repeat(points.interior, 2), {"points": points, "allow_uncertified": True}
    smallest = lambda a: eigvalsh(passing(a).on(**on).matrix()[:, unknown].toarray())[0]
    model = passing(brentq(smallest, low, high, xtol=1e-16))
    b = noise(points)
    with refused("nodes is singular"):
        solve(model, points, b, 0 * b, allow_uncertified=True)


def test_a_constant_load_moves_nothing_on_a_period_that_a_sheet_must_fill():
    for box in (None, (9.0, 8.0)):
        points = replace(Points.sheet((8, 8), 1.0), box=box)
        with refused("points: expected"):
            at_rest(kernel("1/r", HORIZON), Periodic(points, np.zeros((64, 2))))
    crystal = learned(2)
    for law, spacing in ((kernel("1/r", HORIZON), 1.0), (crystal, crystal.spacing)):
        points = Points.sheet((20, 20), spacing)
        b = 1e-9 * np.full_like(points.x, [0.1, -0.37])
        answer = at_rest(law, Periodic(points, b))
        assert at_rest(law, Periodic(points, torch.tensor(b).float())).u.dtype == torch.float32
        assert_array_equal(answer.u, np.zeros_like(b))
        assert answer.residual == 0


@parametrize(
    ("stiff", "loads", "method"), [(True, 40, "lu"), (True, 1, "strip"), (False, 40, "multigrid")]
)
def test_more_nodes_are_factorised_where_each_of_many_loads_takes_long(stiff, loads, method):
    solid = plain(2.0, 100.0 if stiff else 1.0, 1.0)
    points = Points.disk(np.sqrt(2 * DIRECT / np.pi), 1.0, 4.0)
    assert DIRECT < points.interior.sum() < 4 * DIRECT
    assert LPSOperator(solid, points).linear.method(loads=loads) == method


def test_a_solution_goes_on_as_samples_and_as_fields(tmp_path):
    made = lambda nu, d=2, E=1.0: LPSMaterial.isotropic(E, nu, 2.0, 1.0, dimension=d)
    material = made(0.3)
    for one in (material, made(0.3, 3)):
        assert (one.E, one.nu) == approx((1.0, 0.3))
    assert made(0.3, E=1e-300).E * 1e300 == approx(1.0)
    points = Points.disk(3.0, 1.0, 2.0)
    load = 1e-3 * on_interior(points, points.x)
    solution = at_rest(material, Dirichlet(points, load, 0.01 * points.x))
    samples = solution.to_samples()
    assert_array_equal(samples.u[0], solution.u)
    assert_array_equal(samples.loads[0], load)
    assert evaluate(material, samples)["E_res"] < 1e-7
    torn = at_rest(material, Cracked(points, u=points.x, cracks=[[(-1, 0.3), (1, 0.3)]]))
    for one, fields in ((solution, 8), (torn, 4)):  # which has no stress
        one.to_vtk(tmp_path / f"{fields}")
        assert len(meshio.read(tmp_path / f"{fields}/sample_0000.vtu").point_data) == fields
    limits = {"nu: exp": 1.0, "nu: expected": -1.0, "nu: expected −1 < ν < 0.5": (0.5, 3)}
    each_refused(made, limits)
