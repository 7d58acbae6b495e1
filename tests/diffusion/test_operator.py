"""Nonlocal diffusion: gradients, orders, what it keeps, coupling, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.autograd import forward_ad

from examples import diffusion
from examples.diffusion import coupled, jump, smooth
from tests.support.bodies import random_breaking
from tests.support.clouds import cloud, periodic_cloud
from tests.support.problems import difference, fitted_order, kernel, lattice
from warp_peri import CG, Dirichlet, InputError, LPSMaterial, Points, simulate, solve
from warp_peri.diffusion import (
    CoupledOperator,
    DiffusionMaterial,
    DiffusionOperator,
    ThermoelasticMaterial,
)
from warp_peri.fracture.body import lattice_body
from warp_peri.points.unit_names import factors

CELLS = np.array([6, 9, 13])
LAW = DiffusionMaterial(horizon=3.2, alpha=1.3, D=np.array([1.0, 0.4, 0.7]))


def square(cells, reach):
    """The example's square, in the units that points have by default."""
    return replace(diffusion.square(cells, reach), units=("angstrom", "TPa"))


def steady(operator, phi, source=None):
    """φ at rest."""
    return solve(operator, Dirichlet(operator.points, source, phi)).u


def transient(operator, phi, step, steps, source=None, **options):
    """φ at every step."""
    problem = Dirichlet(operator.points, source, phi)
    return simulate(operator, problem, step=step, steps=steps, **options)["u"]


def test_slopes_of_scattered_points_are_those_of_differences():
    """Of the kernel and of κ of every bond; those of lattices are in the table of gradients."""
    points, random = cloud(8, 3.2), np.random.default_rng(0)
    phi, field = random.standard_normal((2, len(points.x)))
    operator = DiffusionOperator(LAW, points, kappa=np.exp(field))
    seed = random.standard_normal(len(operator.rows))
    gradient, kept = operator.gradient(phi, seed), operator.kappa

    def value(law=LAW, kappa=kept):
        changed = DiffusionOperator(law, points)
        changed.kappa = kappa
        return seed @ changed(phi)

    bonds = random.standard_normal(len(kept))
    checks = [
        (gradient.D[k], lambda t, k=k: value(replace(LAW, D=LAW.D + t[0] * np.eye(3)[k])))
        for k in range(3)
    ]
    checks.append((gradient.kappa @ bonds, lambda t: value(kappa=kept + t[0] * bonds)))
    checks.append((gradient.alpha, lambda t: value(replace(LAW, alpha=LAW.alpha + t[0]))))
    for slope, function in checks:
        assert slope == pytest.approx(difference(function, [0.0], 1e-3)[0], rel=1e-7, abs=1e-7)
    np.testing.assert_allclose(operator.matrix() @ phi, operator(phi), atol=1e-12)


def test_orders_on_lattices_on_scattered_points_and_at_a_jump():
    assert fitted_order(1 / CELLS, [smooth(n, 0.0) for n in CELLS]) > 1.95
    assert fitted_order(1 / CELLS, [smooth(n, 0.2) for n in CELLS]) > 1.9
    assert fitted_order(1 / CELLS, [jump(n) for n in CELLS]) > 0.95


def test_coupled_fields_converge():
    both = np.array([coupled(n) for n in CELLS])
    assert fitted_order(1 / CELLS, both[:, 0]) > 1.95
    assert fitted_order(1 / CELLS, both[:, 1]) > 1.95


def test_linear_fields_carry_no_net_flux_and_periodic_lattices_keep_their_content():
    points = square(5, 4.0)
    operator = DiffusionOperator(DiffusionMaterial(0.7), points)
    assert np.abs(operator(points.x @ (2.0, -1.0))).max() < 1e-11
    steps = np.argwhere(np.ones((12, 10)))
    periodic = Points(steps.astype(float), np.ones(len(steps), bool), 1.0, box=(12.0, 10.0))
    kappa = np.random.default_rng(0).uniform(0.1, 3, len(steps))
    operator = DiffusionOperator(DiffusionMaterial(3.0), periodic, kappa=kappa)
    assert abs(operator(np.random.default_rng(1).standard_normal(len(steps))).sum()) < 1e-11
    matrix = operator.matrix()
    assert abs(matrix - matrix.T).max() < 1e-13


def test_a_periodic_wave_decays_as_it_should():
    points, box = periodic_cloud(24, perturbation=0.0)
    points = Points(points.x, points.interior, 1.0, box=box)
    k = 2 * np.pi / 24
    phi = np.cos(k * points.x[:, 0])
    operator = DiffusionOperator(DiffusionMaterial(3.0, conductivity=2.0), points)
    history = transient(operator, phi, 0.5, 20)
    rate = (operator(phi) / phi)[0]
    assert rate == pytest.approx(2 * k**2, rel=0.03)
    decay = ((1 - rate / 4) / (1 + rate / 4)) ** 20
    np.testing.assert_allclose(history[-1], decay * phi, atol=1e-12)


def test_a_hole_is_insulated():
    points = square(8, 4.0)
    hole = np.hypot(*points.x.T) < 0.3
    points = Points(points.x, points.interior & ~hole, points.spacing, outside=hole)
    phi = steady(DiffusionOperator(DiffusionMaterial(3 / 8), points), points.x[:, 0].copy())
    body = points.interior
    assert np.abs(phi[body]).max() < 1
    right = (points.x[:, 0] > 0.3) & (points.x[:, 0] < 0.5) & (np.abs(points.x[:, 1]) < 0.2)
    assert (phi[right] > points.x[right, 0]).all()  # it piles up before the hole


@pytest.mark.parametrize("kappa", [-1.0, lambda x: x[..., 0]])
def test_a_negative_conductivity_is_refused(kappa):
    with pytest.raises(InputError, match="conductivity: expected finite values > 0, got -"):
        DiffusionOperator(DiffusionMaterial(0.8), square(4, 4.0), kappa=kappa)
    with pytest.raises(InputError, match="conductivity: expected a number > 0"):
        DiffusionMaterial(0.8, conductivity=-1.0)


@pytest.mark.parametrize("lattice", [True, False])
def test_a_kernel_that_changes_sign_is_refused_where_diffusion_would_grow(lattice):
    points = square(4, 4.0) if lattice else cloud(8, 3.2)
    if lattice:
        points = Points(4 * points.x, points.interior, 1.0)
    operator = DiffusionOperator(DiffusionMaterial(3.2, D=np.array([1.0, 1.0, -1.0])), points)
    inner = operator.matrix()[:, operator.rows].toarray()
    assert (np.linalg.eigvalsh((inner + inner.T) / 2) < 0).any()
    phi = np.random.default_rng(0).standard_normal(len(points.x))
    for call in (lambda: steady(operator, phi), lambda: transient(operator, phi, 0.1, 3)):
        with pytest.raises(InputError, match="L \\+ Lᵗ has eigenvalues below zero"):
            call()


@pytest.mark.parametrize("box", [(12.0, 12.0), None])
def test_a_kernel_that_changes_sign_and_stays_definite_is_taken(box):
    points, sides = periodic_cloud(12, perturbation=0.0)
    inside = points.interior if box else np.abs(points.x - 6).max(axis=1) < 2
    points = Points(points.x, inside, 1.0, box=sides if box else None)
    operator = DiffusionOperator(DiffusionMaterial(3.2, D=np.array([1.0, 0.2, -0.05])), points)
    assert operator.v.min() < 0
    phi = np.where(inside, np.random.default_rng(0).standard_normal(len(inside)), 0.0)
    history = transient(operator, phi, 5.0, 40)
    assert (np.diff(np.linalg.norm(history, axis=1)) <= 1e-12).all()


def test_what_does_not_fit_is_refused():
    points, law = square(3, 6.0), LPSMaterial(1.0, 1.0, 1.0, np.ones(1), 1.0)
    operator = DiffusionOperator(DiffusionMaterial(1.0), points)
    phi, both = (
        points.x[:, 0],
        ThermoelasticMaterial(law, DiffusionMaterial(1.0), 1.0, 1.0).on(points),
    )
    rest, metres = np.zeros((len(points.x), 3)), DiffusionMaterial(1.0, units=("m", "Pa"))

    def coupled_steps(b, **options):
        return simulate(both, Dirichlet(points, b, rest), **options)

    for words, call in (
        (r"shape \[", lambda: DiffusionOperator(DiffusionMaterial(1.0), points, kappa=np.ones(3))),
        (r"shape \[", lambda: steady(operator, phi[:4])),
        (r"shape \[", lambda: steady(operator, phi, np.ones(3))),
        (r"shape \[", lambda: transient(operator, phi, 0.1, 1, collar=lambda time: phi[:4])),
        ("expected finite values", lambda: steady(operator, phi * np.nan)),
        ("expected finite values", lambda: transient(operator, phi, 0.1, 1, phi * np.inf)),
        ("step: expected a number > 0", lambda: transient(operator, phi, np.inf, 1)),
        ("step: expected a number > 0", lambda: transient(operator, phi, 0.0, 1)),
        ("steps: expected a whole number ≥ 0", lambda: transient(operator, phi, 0.1, -1)),
        ("steps: expected a whole number ≥ 0", lambda: transient(operator, phi, 0.1, 1.5)),
        ("coupling", lambda: ThermoelasticMaterial(law, DiffusionMaterial(1.0), np.nan, 1.0)),
        ("storage", lambda: ThermoelasticMaterial(law, DiffusionMaterial(1.0), 1.0, -1.0)),
        ("units: the model is in", lambda: ThermoelasticMaterial(law, metres, 1.0, 1.0)),
        ("units: the model is in", lambda: metres.on(points)),
        ("step: expected a number > 0", lambda: coupled_steps(rest, step=0.0, steps=1)),
        ("b: expected shape", lambda: coupled_steps(rest[:, 0], step=1.0, steps=1)),
        ("b: expected finite values", lambda: coupled_steps(rest + np.nan, step=1.0, steps=1)),
        ("parameters, got every", lambda: coupled_steps(rest, step=1.0, steps=1, every=2)),
        ("expected steps too", lambda: coupled_steps(rest, step=1.0)),
    ):
        with pytest.raises(InputError, match=words):
            call()


def test_a_solid_or_a_flux_that_would_grow_is_not_coupled():
    points = square(3, 6.0)
    points = Points(3 * points.x, points.interior, 1.0)
    body = lattice_body(points.x, 1.0, 3.0)
    bad = DiffusionMaterial(3.0, D=np.array([1.0, 1.0, -1.0]))
    law = LPSMaterial(1.0, 1.0, 1.0, np.ones(1), 3.0)
    with pytest.raises(InputError, match="eigenvalues below zero"):
        ThermoelasticMaterial(law, bad, 1.0, 1.0).on(points)
    solid = ThermoelasticMaterial(kernel("sign-changing", 3.0), DiffusionMaterial(3.0), 1.0, 1.0)
    solid.on(points)
    torn = random_breaking(body, np.random.default_rng(0), 0.5)
    with pytest.raises(InputError, match="negative eigenvalues"):
        CoupledOperator(solid, points, neighbour=torn)


def test_sources_are_answered_each_by_itself():
    points = square(5, 4.0)
    operator = DiffusionMaterial(0.7, 2.0).on(points)
    phi, b = np.random.default_rng(0).standard_normal((2, 3, len(points.x)))
    solution = solve(operator, Dirichlet(points, b, phi))
    np.testing.assert_array_equal(solution.u[:, ~points.interior], phi[:, ~points.interior])
    np.testing.assert_allclose(operator(solution.u), operator.rhs(b), atol=1e-11)
    np.testing.assert_allclose(solution.u[1], steady(operator, phi[1], b[1]), atol=1e-13)
    with pytest.raises(InputError, match="solver: expected Direct"):
        solve(operator, Dirichlet(points, b, phi), solver=CG())
    with pytest.raises(InputError, match="stress: this model has none"):
        solution.stress()


def test_a_coupled_solid_comes_to_its_steady_state():
    points = square(4, 6.0)
    solid = ThermoelasticMaterial(
        LPSMaterial(1.5, 1.0, 1.0, np.ones(1), 0.75),
        DiffusionMaterial(0.75),
        coupling=0.7,
        storage=0.3,
    )
    fields, b = np.random.default_rng(0).standard_normal((2, len(points.x), 3))
    problem = Dirichlet(points, b, fields)
    steadily = solve(solid, problem)
    assert steadily.residual < 1e-10
    np.testing.assert_allclose(steadily.operator(steadily.u), steadily.load, atol=1e-9)
    run = simulate(solid, problem, step=50.0, steps=8)
    np.testing.assert_allclose(run.u, steadily.u, atol=1e-6)
    assert run["u"].shape == (9, len(points.x), 3)
    np.testing.assert_allclose(solve(solid, Dirichlet(points, None, 0 * fields)).u, 0)


def test_steps_of_tensors_are_those_of_arrays_and_differentiated_once():
    points = square(3, 3.0)
    operator = DiffusionMaterial(0.9, 2.0).on(points)
    phi, b = np.random.default_rng(0).standard_normal((2, len(points.x)))
    arrays = transient(operator, phi, 0.1, 3, source=b)
    leaf = torch.from_numpy(phi).requires_grad_()
    held = transient(operator, leaf, 0.1, 3, source=b, collar=lambda time: leaf)
    assert np.array_equal(held.detach(), arrays)
    (first,) = torch.autograd.grad(held.square().sum(), leaf, create_graph=True)
    with pytest.raises(InputError, match="second derivative"):
        first.sum().backward()
    with pytest.raises(InputError, match="tangent"), forward_ad.dual_level():
        transient(operator, forward_ad.make_dual(leaf, leaf), 0.1, 3)
    with pytest.raises(InputError, match=r"of shape alpha \[\], D \[1\], kappa \[\], got mu"):
        transient(operator, phi, 0.1, 3, parameters={"mu": 2.0})
    assert transient(operator, leaf, 0.1, 0).shape == (1, len(phi))


def test_the_conductivity_has_units_of_stress_times_length_squared():
    law, points = replace(LAW, conductivity=0.7), lattice(5, LAW.horizon)
    phi = np.cos(points.x @ [0.3, 0.2])
    length, stress = factors(law.units, ("nm", "MPa"))
    x, spacing = points.x * length, points.spacing * length
    there = replace(points, x=x, spacing=spacing, units=("nm", "MPa"))
    found = law.in_units(("nm", "MPa")).on(there)(phi)
    np.testing.assert_allclose(found, stress * law.on(points)(phi), rtol=1e-11, atol=1e-6)
