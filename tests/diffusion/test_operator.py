"""Nonlocal diffusion: gradients, orders, what it keeps, coupling, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

from examples.diffusion import coupled, jump, main, order, smooth, square
from tests.support.bodies import random_breaking
from tests.support.clouds import cloud, periodic_cloud
from tests.support.problems import kernel
from warp_peri import InputError, Model, Points
from warp_peri.damage.lattice_body import lattice_body
from warp_peri.diffusion.conductor import Conductor, load_conductor
from warp_peri.diffusion.coupled import Coupled
from warp_peri.diffusion.operator import DiffusionOperator
from warp_peri.diffusion.transient import steady, transient

CELLS = [6, 9, 13]
LAW = Conductor(horizon=3.2, alpha=1.3, D=np.array([1.0, 0.4, 0.7]))


def difference(function, step=1e-5):
    """Central difference of fourth order at zero."""
    near = (function(step) - function(-step)) / (2 * step)
    far = (function(2 * step) - function(-2 * step)) / (4 * step)
    return (4 * near - far) / 3


@pytest.mark.parametrize("lattice", [True, False])
def test_gradients_are_those_of_differences(lattice):
    points = square(4, 4.0) if lattice else cloud(8, 3.2)
    if lattice:
        points = Points(4 * points.x, points.interior, 1.0)
    random = np.random.default_rng(0)
    phi, field = random.standard_normal((2, len(points.x)))
    operator = DiffusionOperator(LAW, points, kappa=np.exp(field))
    seed = random.standard_normal(len(operator.rows))
    gradient = operator.gradient(phi, seed)

    kept = operator.kappa

    def value(phi=phi, law=LAW, kappa=kept):
        changed = operator if law is LAW else DiffusionOperator(law, points)
        changed.kappa = kappa
        return seed @ changed(phi)

    along = random.standard_normal(len(phi))
    checks = [(gradient.phi @ along, lambda t: value(phi=phi + t * along))]
    bonds = random.standard_normal(len(operator.kappa))
    checks.append((gradient.kappa @ bonds, lambda t: value(kappa=kept + t * bonds)))
    for k in range(3):
        unit = np.eye(3)[k]
        moved = lambda t, unit=unit: value(law=replace(LAW, D=LAW.D + t * unit))
        checks.append((gradient.D[k], moved))
    checks.append((gradient.alpha, lambda t: value(law=replace(LAW, alpha=LAW.alpha + t))))
    for derivative, function in checks:
        assert derivative == pytest.approx(difference(function), rel=1e-8, abs=1e-8)
    operator.kappa = kept
    np.testing.assert_allclose(operator.matrix() @ phi, operator(phi), atol=1e-12)


def test_orders_on_lattices_on_scattered_points_and_at_a_jump():
    assert order(CELLS, [smooth(n, 0.0) for n in CELLS]) > 1.95
    assert order(CELLS, [smooth(n, 0.2) for n in CELLS]) > 1.9
    assert order(CELLS, [jump(n) for n in CELLS]) > 0.95


def test_coupled_fields_converge():
    both = np.array([coupled(n) for n in CELLS])
    assert order(CELLS, both[:, 0]) > 1.95
    assert order(CELLS, both[:, 1]) > 1.95


def test_linear_fields_carry_no_net_flux_and_periodic_lattices_keep_their_content():
    points = square(5, 4.0)
    operator = DiffusionOperator(Conductor(0.7), points)
    assert np.abs(operator(points.x @ (2.0, -1.0))).max() < 1e-11
    steps = np.argwhere(np.ones((12, 10)))
    periodic = Points(steps.astype(float), np.ones(len(steps), bool), 1.0, box=(12.0, 10.0))
    kappa = np.random.default_rng(0).uniform(0.1, 3, len(steps))
    operator = DiffusionOperator(Conductor(3.0), periodic, kappa=kappa)
    assert abs(operator(np.random.default_rng(1).standard_normal(len(steps))).sum()) < 1e-11
    matrix = operator.matrix()
    assert abs(matrix - matrix.T).max() < 1e-13


def test_a_periodic_wave_decays_as_it_should():
    points, box = periodic_cloud(24, perturbation=0.0)
    points = Points(points.x, points.interior, 1.0, box=box)
    k = 2 * np.pi / 24
    phi = np.cos(k * points.x[:, 0])
    operator = DiffusionOperator(Conductor(3.0, conductivity=2.0), points)
    history = transient(operator, phi, 0.5, 20)
    rate = (operator(phi) / phi)[0]
    assert rate == pytest.approx(2 * k**2, rel=0.03)
    decay = ((1 - rate / 4) / (1 + rate / 4)) ** 20
    np.testing.assert_allclose(history[-1], decay * phi, atol=1e-12)


def test_a_hole_is_insulated():
    points = square(8, 4.0)
    hole = np.hypot(*points.x.T) < 0.3
    points = Points(points.x, points.interior & ~hole, points.spacing, outside=hole)
    phi = steady(DiffusionOperator(Conductor(3 / 8), points), points.x[:, 0].copy())
    body = points.interior
    assert np.abs(phi[body]).max() < 1
    right = (points.x[:, 0] > 0.3) & (points.x[:, 0] < 0.5) & (np.abs(points.x[:, 1]) < 0.2)
    assert (phi[right] > points.x[right, 0]).all()  # it piles up before the hole


@pytest.mark.parametrize("kappa", [-1.0, lambda x: x[..., 0]])
def test_a_negative_conductivity_is_refused(kappa):
    with pytest.raises(InputError, match="conductivity: expected finite values > 0, got -"):
        DiffusionOperator(Conductor(0.8), square(4, 4.0), kappa=kappa)
    with pytest.raises(InputError, match="conductivity: expected a number > 0"):
        Conductor(0.8, conductivity=-1.0)


@pytest.mark.parametrize("lattice", [True, False])
def test_a_kernel_that_changes_sign_is_refused_where_diffusion_would_grow(lattice):
    points = square(4, 4.0) if lattice else cloud(8, 3.2)
    if lattice:
        points = Points(4 * points.x, points.interior, 1.0)
    operator = DiffusionOperator(Conductor(3.2, D=np.array([1.0, 1.0, -1.0])), points)
    inner = operator.matrix()[:, operator.rows].toarray()
    below = int((np.linalg.eigvalsh((inner + inner.T) / 2) < 0).sum())
    assert below > 0
    phi = np.random.default_rng(0).standard_normal(len(points.x))
    for call in (lambda: steady(operator, phi), lambda: transient(operator, phi, 0.1, 3)):
        with pytest.raises(InputError, match=f"L \\+ Lᵗ has {below} eigenvalues below zero"):
            call()


@pytest.mark.parametrize("box", [(12.0, 12.0), None])
def test_a_kernel_that_changes_sign_and_stays_definite_is_taken(box):
    points, sides = periodic_cloud(12, perturbation=0.0)
    inside = points.interior if box else np.abs(points.x - 6).max(axis=1) < 2
    points = Points(points.x, inside, 1.0, box=sides if box else None)
    operator = DiffusionOperator(Conductor(3.2, D=np.array([1.0, 0.2, -0.05])), points)
    assert operator.v.min() < 0
    phi = np.where(inside, np.random.default_rng(0).standard_normal(len(inside)), 0.0)
    history = transient(operator, phi, 5.0, 40)
    assert (np.diff(np.linalg.norm(history, axis=1)) <= 1e-12).all()


def test_fields_that_do_not_fit_are_refused():
    points = square(4, 3.0)
    operator = DiffusionOperator(Conductor(3 / 4), points)
    phi, count = points.x[:, 0], len(points.x)
    for call in (
        lambda: DiffusionOperator(Conductor(3 / 4), points, kappa=np.ones(3)),
        lambda: steady(operator, phi[:4]),
        lambda: steady(operator, phi, np.ones(3)),
        lambda: transient(operator, phi, 0.1, 1, collar=lambda time: phi[:4]),
    ):
        with pytest.raises(InputError, match=r"shape \["):
            call()
    for call in (
        lambda: steady(operator, np.full(count, np.nan)),
        lambda: steady(operator, phi, np.nan),
        lambda: transient(operator, phi, 0.1, 1, source=np.inf),
    ):
        with pytest.raises(InputError, match="expected finite values"):
            call()
    for step, steps in ((np.inf, 1), (0.0, 1), (0.1, -1)):
        with pytest.raises(InputError, match="step: expected a number > 0"):
            transient(operator, phi, step, steps)


def test_coupled_steps_that_make_no_sense_are_refused():
    points, law = square(3, 6.0), Model(1.0, 1.0, 1.0, np.ones(1), 1.0)
    body = lattice_body(points.x, 1 / 3, 1.0)
    flux = DiffusionOperator(Conductor(1.0), points)
    for numbers in ({"coupling": np.nan, "storage": 1.0}, {"coupling": 1.0, "storage": -1.0}):
        with pytest.raises(InputError, match="coupling, storage"):
            Coupled(law, body, flux, **numbers)
    system, count = Coupled(law, body, flux, coupling=1.0, storage=1.0), len(points.x)
    rest = (np.zeros((count, 2)), np.zeros(count))
    with pytest.raises(InputError, match="step: expected a number > 0"):
        system.step(rest, rest, 0.0, b=rest[0], source=rest[1])
    with pytest.raises(InputError, match="b: expected shape"):
        system.step(rest, rest, 1.0, b=rest[1], source=rest[1])
    with pytest.raises(InputError, match="not finite"):
        system.step(rest, rest, 1.0, b=rest[0], source=rest[1] + np.nan)


def test_a_solid_or_a_flux_that_would_grow_is_not_coupled():
    points = square(3, 6.0)
    points = Points(3 * points.x, points.interior, 1.0)
    body = lattice_body(points.x, 1.0, 3.0)
    bad = DiffusionOperator(Conductor(3.0, D=np.array([1.0, 1.0, -1.0])), points)
    law, numbers = Model(1.0, 1.0, 1.0, np.ones(1), 3.0), {"coupling": 1.0, "storage": 1.0}
    with pytest.raises(InputError, match="eigenvalues below zero"):
        Coupled(law, body, bad, **numbers)
    sign_changing = kernel("sign-changing", 3.0)
    flux = DiffusionOperator(Conductor(3.0), points)
    Coupled(sign_changing, body, flux, **numbers)
    torn = random_breaking(body, np.random.default_rng(0), 0.5)
    with pytest.raises(InputError, match="negative eigenvalues"):
        Coupled(sign_changing, body, flux, neighbour=torn, **numbers)


def test_laws_go_through_their_file(tmp_path):
    LAW.save(tmp_path / "law.json")
    again = load_conductor(tmp_path / "law.json")
    assert (again.horizon, again.alpha) == (LAW.horizon, LAW.alpha)
    np.testing.assert_array_equal(again.D, LAW.D)


def test_the_example_prints(tmp_path, capsys):
    command = ["--cells", "4", "6", "--microstructure", "0", "--json", "--out", str(tmp_path)]
    assert main(command) == 0
    assert '"order"' in capsys.readouterr().out
