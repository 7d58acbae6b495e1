"""Limits that the library sees coming: cancelled kernels, strains, degrees, spread-out nodes."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest

from tests.support.clouds import cloud
from tests.support.plates import plate
from tests.support.problems import kernel, lattice, manufactured, noise
from tests.support.solving import solve, solve_periodic
from warp_peri import Bernstein, InputError, Model, Points, certify
from warp_peri.fe_coupling.body import Coupling, solve_body
from warp_peri.learning.fit import learn as fit
from warp_peri.materials.lps import bernstein_basis
from warp_peri.points.families import bond_classes, families_of
from warp_peri.points.lattice import largest_strain


def cancelled(horizon=2.0):
    """A kernel whose positive and negative parts cancel in m on the unit lattice."""
    classes = bond_classes(1.0, horizon)
    sigma = classes.count * classes.weight * classes.r**2
    a, b = (sigma @ Model(0.3, 0.8, 1.0, D, horizon).influence(classes.r) for D in ([1, 0], [0, 1]))
    return Model(0.3, 0.8, 1.0, [1.0, -a / b], horizon, certified_on=(1.0,))


def test_a_vanishing_weighted_volume_is_refused():
    model, points = cancelled(), lattice(3, 2.0)
    for use in (
        lambda: model.on(points)(noise(points)),
        lambda: certify(model, spacing=1.0),
        lambda: solve(model, points, noise(points), noise(points)),
    ):
        with pytest.raises(InputError, match="weighted volume m .* is zero"):
            use()
    nearly = replace(model, D=model.D * [1.0, 1.0 + 1e-6])
    assert np.isfinite(nearly.on(points)(noise(points))).all()


@pytest.mark.filterwarnings("ignore:spacing. the model is certified")
def test_a_vanishing_weighted_volume_of_scattered_points_is_counted():
    points = cloud(3, 3.5)
    families = families_of(points, 3.5)
    node = np.flatnonzero(points.interior)[0]
    bonds = slice(*families.row[node : node + 2])
    sigma = families.weight[bonds] * families.r[bonds] ** 2
    a, b = (
        sigma @ Model(0.3, 0.8, 1.0, D, 3.5).influence(families.r[bonds]) for D in ([1, 0], [0, 1])
    )
    model = Model(0.3, 0.8, 1.0, [1.0, -a / b], 3.5)
    with pytest.raises(InputError, match="is zero at 1 nodes"):
        model.on(points, allow_uncertified=True)(noise(points))


def test_strain_of_known_fields():
    points = lattice(3, 2.0, spacing=2.5, angle=0.3)
    turn = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    stretch = turn @ np.diag([0.02, -0.05]) @ turn.T
    assert largest_strain(points, points.x @ stretch.T) == pytest.approx(0.05)
    assert largest_strain(points, np.stack([0 * points.x, points.x @ stretch.T])) > 0.049
    alone = Points(np.zeros((1, 2)), np.ones(1, bool), 1.0)
    assert largest_strain(alone, alone.x) == 0
    shear = (points.x @ turn)[:, 1:] * 0.04 * turn[:, 0]  # of lines: half of it along diagonals
    assert largest_strain(points, shear) == pytest.approx(0.02)
    assert largest_strain(points, 0 * points.x + 3.0) == 0
    assert largest_strain(cloud(3, 2.5), cloud(3, 2.5).x * 0.1) == pytest.approx(0.1)
    far = points.x[:, 0] > points.x[points.interior, 0].max() + 1
    u = np.where(far[:, None], 1e3, points.x @ stretch.T)
    assert largest_strain(replace(points, outside=far), u) == pytest.approx(0.05)


def test_a_solution_strained_beyond_the_training_data_warns(tmp_path):
    points = manufactured(kernel("positive", 2.5, lam=-0.2), lattice(5, 2.5), 4)
    model = fit(points, horizon=2.5, kernel=Bernstein(2)).material
    assert model.trained_strain == pytest.approx(largest_strain(points, points.u))
    model.save(tmp_path / "m.json")
    assert Model.load(tmp_path / "m.json").trained_strain == model.trained_strain
    solve(model, points, points.b, points.u)
    with pytest.warns(UserWarning, match="strain: the solution reaches"):
        solve(model, points, 3 * points.b, 3 * points.u)
    with pytest.raises(InputError, match="trained_strain: expected a finite number"):
        replace(model, trained_strain=np.nan)


def test_degrees_beyond_floating_point_are_refused():
    assert np.isfinite(bernstein_basis(np.linspace(0, 1, 50), 1.0, 1000)).all()
    with pytest.raises(InputError, match="degree: expected at most 1000, got 1001"):
        bernstein_basis([0.5], 1.0, 1001)
    with pytest.raises(InputError, match="D: expected at most 1001, got 1002"):
        Model(0.3, 0.8, 1.0, np.ones(1002), 2.0)


def test_what_would_take_memory_without_limit_is_refused():
    with pytest.raises(InputError, match="horizon: expected at most 100 spacings"):
        bond_classes(1e-6, 1.0)
    points = lattice(1, 2.0)
    x = np.concatenate([points.x, [[1e5, 1e5]]])
    far = Points(x, np.append(points.interior, False), 1.0)
    with pytest.raises(InputError, match="nodes spread over 1.0e.10 lattice places"):
        families_of(far, 2.0)


BEYOND = "strain: the solution reaches .* %, the training data 1 %"


def test_a_periodic_sheet_strained_beyond_the_training_data_warns():
    model = replace(kernel("1/r", 3.0), trained_strain=0.01)
    y = np.broadcast_to(np.arange(20.0), (24, 20))
    b = np.sin(2 * np.pi * y / 20)[..., None] * (0.0, 0.5)
    u = solve_periodic(replace(model, trained_strain=None), b, spacing=1.0)
    size = 0.01 / np.abs(np.roll(u, -1, axis=1) - u)[..., 1].max()
    calm = solve_periodic(model, 1.9 * size * b, spacing=1.0)
    with pytest.warns(UserWarning, match=BEYOND):
        loud = solve_periodic(model, 2.1 * size * b, spacing=1.0)
    assert loud == pytest.approx(2.1 / 1.9 * calm)


@pytest.mark.parametrize("half", [32.0, 14.0], ids=["coupled", "elements alone"])
def test_a_body_strained_beyond_the_training_data_warns(half):
    """As of a traction that is a thousand times too large, in GPa for TPa."""
    model = replace(kernel("1/r", 3.0), trained_strain=0.01)
    mesh, coupling = plate(8.0, half, 8, 32), Coupling(spacing=1.0)

    def said(size):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            held = {"sides": lambda x: size * x * (1, 0)}
            solve_body(model, mesh, displacement=held, coupling=coupling)
        return [w for w in caught if re.match(BEYOND, str(w.message))]

    assert not said(1e-3)
    assert len(said(0.1)) == 1
