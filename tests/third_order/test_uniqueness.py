"""The guarantee of uniqueness: its bounds are bounds, what it promises is seen; equilibria."""

from dataclasses import replace

import numpy as np
from numpy.linalg import eigvalsh, norm
from numpy.random import default_rng
from scipy.sparse.linalg import splu

from tests.support import near, parametrize, refused, sup, warned
from tests.support.nonlinear import FORMS, psi, solid
from tests.support.problems import ell, lattice, loaded, noise, normal, smooth
from tests.support.symbols import anywhere
from warp_peri import Dirichlet, Newton, solve
from warp_peri.certificates import prove_uniqueness
from warp_peri.materials.certificate import curvature_bound, largest_parts, proven_kappa
from warp_peri.materials.third_order import PlacedThirdOrder
from warp_peri.points.families import bond_classes
from warp_peri.solvers import equilibria, systems
from warp_peri.solvers.linear import Linear

HORIZON = 3.0
certified = lambda form: (solid(form), prove_uniqueness(solid(form), spacing=1.0))
"""A model and its guarantee."""


def balls(count):
    """Random matrices of norm 1, shape [count, 2, 2]."""
    H = normal((count, 2, 2))
    return H / norm(H, axis=(1, 2))[:, None, None]


def test_bounds_of_the_energys_parts_and_its_curvature_hold_and_are_close():
    model = solid("energy")
    parts, H = np.array(largest_parts(model)), balls(20_000)
    sizes = np.array([1.0, -1.0, 2.0, -2.0, 0.5, 3.0])
    values = np.stack([psi(size * H, model) for size in sizes])
    by_degree = np.linalg.lstsq(sizes[:, None] ** np.arange(3, 7), values, rcond=None)[0]
    largest = np.abs(by_degree).max(1)
    assert (0.9 * parts <= largest).all()
    assert (largest <= parts).all()
    step, e, signs = 1e-4, np.eye(4).reshape(4, 2, 2), ((1, 1), (1, -1), (-1, 1), (-1, -1))
    for strain in (0.01, 0.05):
        H = strain * balls(2000)
        second = np.empty((len(H), 4, 4))  # Ψ″ by differences of the energy
        for a, b in np.ndindex(4, 4):
            corners = [s * t * psi(H + step * (s * e[a] + t * e[b]), model) for s, t in signs]
            second[:, a, b] = sum(corners) / (4 * step**2)
        bound = curvature_bound(parts, strain)
        assert 0.7 * bound <= sup(eigvalsh(second)) <= bound


@parametrize("form", FORMS)
def test_kappa_is_a_bound_over_the_whole_zone(form):
    model, proof = certified(form)
    classes, stencil = bond_classes(1.0, HORIZON), model.linear.stencil
    k = anywhere(4000, 1)
    k = np.concatenate([k, 1e-3 * k])
    smallest = eigvalsh(model.linear.symbol(k))[:, 0]
    pull = 2 * np.sin(k @ classes.xi.T)
    for p, kappa in zip(model.weights(classes), (proof.kappa_in, proof.kappa_out)):
        gradient = pull @ (p[classes.bond_class][:, None] * classes.xi)
        sampled = np.sqrt(((gradient**2).sum(1) / smallest).max())
        assert sampled <= kappa <= 1.05 * sampled
    negative = replace(stencil, tensors=-stencil.tensors)
    assert proven_kappa(negative, model.linear.group, classes, p) == np.inf


@parametrize("form", FORMS)
def test_the_clipped_iteration_contracts_from_anywhere(form):
    """u ← u + L⁻¹ (b − L u) in the energy norm, by no more than C κ κ, to one answer."""
    (model, proof), random = certified(form), default_rng(0)
    rate = proof.curvature * proof.kappa_in * proof.kappa_out
    assert proof.strain > 0.003
    assert rate < 1
    points = lattice(random.uniform(size=(5, 5)) < 0.7, HORIZON)
    operator, inside = PlacedThirdOrder(model, points), points.interior
    L = operator.straight.matrix().tocsc()[:, np.repeat(inside, 2)]
    factors, (load, collar) = splu(L), 0.02 * noise(points, 2)

    def moved(field):
        left = load[inside] - operator.force(field, radius=proof.strain)
        field = field.copy()
        field[inside] += factors.solve(left.ravel()).reshape(-1, 2)
        return field

    def energy(difference):
        flat = difference[inside].ravel()
        return np.sqrt(flat @ (L @ flat))

    free = random.normal(size=collar.shape)
    one, other = (np.where(inside[:, None], size * free, collar) for size in (0.1, -30.0))
    for _ in range(3):
        before, one, other = energy(one - other), moved(one), moved(other)
        assert energy(one - other) <= rate * before
    for _ in range(60):
        one, other = moved(one), moved(other)
    near(other, one, 1e-9)


def test_a_planted_violation_takes_the_guarantee_away():
    model, proof = certified("energy")
    stronger = replace(model, tq2=10 * model.tq2)
    assert prove_uniqueness(stronger, spacing=1.0).strain < proof.strain / 5
    longest = np.abs(model.linear.steps).max(1) == 3
    turned = model.linear.tensors - 0.2 * longest[:, None, None] * np.eye(2)
    indefinite = replace(model, linear=replace(model.linear, tensors=turned, certificate=None))
    assert eigvalsh(indefinite.linear.symbol(anywhere(4000, 2))).min() < 0
    nothing = prove_uniqueness(indefinite, spacing=1.0)
    assert nothing.strain == 0
    assert nothing.statement == "Nothing is proven on the lattice of spacing 1 Å."
    assert "at most one solution has |H| ≤" in proof.statement


def problem(model, size, interior=7):
    """A smooth field and the load that holds it."""
    points = replace(lattice(interior, 3.0), axis=0.0)
    made = loaded(model.on(points), size * smooth(points.x, 1, wave_number=0.5))
    return points, made.u[0], made.b[0]


@parametrize("form", FORMS)
def test_a_known_answer_is_found_within_the_proven_strain(form, monkeypatch):
    model = solid(form)
    points, u, b = problem(model, 0.004)
    posed = Dirichlet(points, b, u)
    solution = solve(model, posed, solver=Newton(1e-8, True))  # a warning would be an error
    near(solution.u, u, 1e-7)
    (record,) = solution.details
    assert record.unique
    assert record.largest_gradient <= model.proven_strain(1.0)
    assert record.solves <= 10
    assert record.eigenvalue > 0
    assert sup(solve(model.linear, posed).u - u) > 1e-4 * sup(u)
    monkeypatch.setattr(Linear, "method", lambda *asked, **options: "lu")
    near(solution.u, solve(model, posed, solver=Newton(1e-8)).u, 1e-6, sup(u))


def test_answers_beyond_the_proven_strain_come_with_a_warning():
    model = solid("energy")
    points, u, b = problem(model, 0.1, ell())
    with warned(r"proven unique up to \|H\| = .* go beyond it"):
        solved = solve(model, Dirichlet(points, np.stack([b, 0 * b]), np.stack([u, 0 * u]))).u
    near(solved[0], u, 1e-6)
    assert not solved[1].any()


def test_newton_goes_where_the_fixed_point_does_not(monkeypatch):
    model = replace(solid("energy"), proven={})
    points, u, b = problem(model, 0.03, ell())
    monkeypatch.setattr(equilibria, "MOST_STEPS", 2)
    with warned("no strain, for want of a certificate"):
        solution = solve(model, Dirichlet(points, b, u))
    assert solution.details[0].method == "newton"
    near(solution.u, u, 1e-6)
    monkeypatch.setattr(systems, "MOST", 1)
    with refused("sample 0: no equilibrium was found beyond"):
        solve(model, Dirichlet(points, 40 * b, u))
