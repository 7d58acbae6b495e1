"""λ and μ as one value a node: the same sweeps, their plain twins, and their derivatives."""

import pickle

import numpy as np
import pytest
import torch

import warp_peri as wp
from tests.lps.test_adjoint import HORIZON, KINDS, bonds_of, error
from tests.support.problems import KERNELS, LAM, MU, difference, kernel, lattice, noise, periodic
from warp_peri import InputError
from warp_peri.core.proof import largest
from warp_peri.materials.lps_bonds import Bonds
from warp_peri.materials.lps_force import evaluate, gradient, pulled

SHAPE = tuple(KERNELS["sign-changing"][name] for name in ("alpha", "D"))


class Problem:
    """A force with fields, and a weight of each of its components."""

    def __init__(self, kind):
        self.bonds, self.points = bonds_of(kind)
        random, size = np.random.default_rng(1), len(self.points.x)
        self.u, self.g = noise(self.points, 2), noise(self.points, 2, seed=3)
        self.g = self.g[:, self.points.interior]
        self.moduli = LAM + 0.2 * random.random(size), MU + 0.2 * random.random(size)

    def flat(self, field):
        return self.bonds.floats(np.ascontiguousarray(field).reshape(len(field), -1))

    def force(self, u, *moduli):
        felt = evaluate(self.bonds, self.flat(u), self.bonds.law(*moduli, *SHAPE))
        return felt, felt.Lu.numpy()

    def gradient(self):
        felt, _ = self.force(self.u, *self.moduli)
        return gradient(self.bonds, felt, self.flat(self.g))


@pytest.mark.parametrize("kind", KINDS)
def test_fields_that_are_the_same_everywhere_are_numbers(kind):
    problem = Problem(kind)
    number, uniform = (LAM, MU), (np.full(len(problem.points.x), one) for one in (LAM, MU))
    (felt, force), (alone, expected) = (problem.force(problem.u, *m) for m in (uniform, number))
    assert error(force, expected) < 1e-14
    g = problem.flat(problem.g)
    by, known = (gradient(problem.bonds, one, g) for one in (felt, alone))
    for name in ("lam", "mu"):
        assert getattr(by, name).sum() == pytest.approx(getattr(known, name), rel=1e-12)
    for name in ("alpha", "D"):
        assert error(getattr(by, name), getattr(known, name)) < 1e-12


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_are_those_of_differences_and_plain_sweeps(kind, monkeypatch):
    problem = Problem(kind)
    by, (lam, mu) = problem.gradient(), problem.moduli
    ways = np.random.default_rng(2).normal(size=(2, len(lam)))
    way = noise(problem.points, 2, seed=5)
    flat = problem.g.ravel()
    for t, part, expected in (
        (0, by.lam @ ways[0], (lam + ways[0], mu)),
        (0, by.mu @ ways[1], (lam, mu + ways[1])),
        (1, np.vdot(by.u.numpy(), way), (lam, mu)),
    ):  # the force is linear in each
        ahead = problem.force(problem.u + t * way, *expected)[1].ravel() @ flat
        here = problem.force(problem.u, lam, mu)[1].ravel() @ flat
        assert part == pytest.approx(ahead - here, rel=1e-10)
    monkeypatch.setattr("warp_peri.materials.lps_bonds.DEVICE", "elsewhere")
    plain = Problem(kind).gradient()
    assert error(by.u.numpy(), plain.u.numpy()) < 1e-12
    for name in ("lam", "mu", "alpha", "D"):
        assert error(getattr(by, name), getattr(plain, name)) < 1e-12, name


def test_each_state_has_its_own_moduli_so_that_the_operator_is_symmetric():
    problem = Problem("periodic lattice")
    law = problem.bonds.law(*problem.moduli, *SHAPE)
    felt = evaluate(problem.bonds, problem.flat(problem.u), law)
    back = pulled(problem.bonds, law, problem.flat(problem.u)).by_u.numpy()
    assert error(back, felt.Lu.numpy()) < 1e-14


def test_fields_of_other_lengths_are_refused():
    points = bonds_of("cloud")[1]
    with pytest.raises(
        InputError, match=f"mu: expected one number, or one of each of {len(points.x)}"
    ):
        Bonds(points, HORIZON).law(LAM, np.ones(3), *SHAPE)


def laid(side=12, angle=0.0):
    """A model, nodes and smooth fields of contrast four on them."""
    points = lattice(side, HORIZON, angle=angle)
    mu = MU * (2.5 + 1.5 * np.sin(points.x[:, 0] / 3) * np.cos(points.x[:, 1] / 4))
    return kernel("positive", HORIZON), points, 0.4 * mu, mu


@pytest.mark.parametrize("angle", [0.0, 0.3])
def test_iteration_and_factors_have_one_answer(angle):
    model, points, lam, mu = laid(angle=angle)
    problem = wp.Dirichlet(points, noise(points, seed=1), noise(points, seed=2))
    by_cg = wp.solve(model, problem, solver=wp.Krylov(tolerance=1e-11), lam=lam, mu=mu)
    by_lu = wp.solve(model, problem, solver=wp.Direct(), lam=lam, mu=mu)
    assert error(by_cg.u, by_lu.u) < 1e-8
    op = by_lu.operator
    assert error(op(by_lu.u), problem.b[points.interior]) < 1e-9
    assert error(op.matrix() @ by_lu.u.ravel(), op(by_lu.u).ravel()) < 1e-12
    assert by_lu.proven is None
    again = pickle.loads(pickle.dumps(op))
    assert np.array_equal(again(by_lu.u), op(by_lu.u))


def test_gradients_of_a_solve_to_its_fields():
    model, points, lam, mu = laid(8)
    op, u, fields = model.on(points, lam=lam, mu=mu), noise(points, seed=2), {"lam": lam, "mu": mu}
    leaves = {name: torch.tensor(one, requires_grad=True) for name, one in fields.items()}
    way, weight = np.random.default_rng(5).normal(size=(2, len(mu)))

    def value(**fields):
        given = {name: torch.as_tensor(one) for name, one in fields.items()}
        found = op.rest(0 * u, u, wp.Krylov(tolerance=1e-12), parameters=given)
        return (found.u[:, 0] * torch.from_numpy(weight)).sum()

    gradients = torch.autograd.grad(value(**leaves), [*leaves.values()])
    for name, by in zip(fields, gradients):

        def along(t, name=name):
            return value(**fields | {name: fields[name] + 0.01 * t[0] * way}).item()

        expected = difference(along, np.zeros(1), 0.1)[0]
        assert by.numpy() @ (0.01 * way) == pytest.approx(expected, rel=1e-7)


def test_uniform_fields_are_the_model():
    model, points, *_ = laid()
    u, op = noise(points), model.on(points)
    same = model.on(points, mu=np.full(len(points.x), model.mu))
    assert error(same(u), op(u)) < 1e-14
    assert error(same.stress(u), op.stress(u)) < 1e-14
    assert same.stiffest_wave() == pytest.approx(largest(model.stencil(1.0), model.group))
    assert same.energy(u) == pytest.approx(op.energy(u))


def test_functions_are_averaged_harmonically():
    model, points, *_ = laid()
    op = model.on(points, mu=lambda x: np.where(x[:, 0] < 0, 1.0, 3.0), lam=1.0)
    mu = op.model.mu[points.x[:, 1] == 0]
    at = points.x[points.x[:, 1] == 0, 0]
    assert mu[at < -HORIZON / 2] == pytest.approx(1.0)
    assert mu[at > HORIZON / 2] == pytest.approx(3.0)
    assert mu[at == 0] == pytest.approx(1.5, rel=0.1)


def test_a_wave_through_a_stiff_part_keeps_its_energy():
    model, points, lam, mu = laid()
    op = model.on(points, lam=lam, mu=mu)
    u = np.exp(-((points.x - 5.5) ** 2).sum(axis=1) / 4)[:, None] * [0.0, 1e-3]
    longest = 2 * np.sqrt(1e-8 * 2000 / op.stiffest_wave())
    start = wp.Dirichlet(points, 0 * u, u)
    moved = wp.move(op, start, density=2000.0, step=0.5 * longest, steps=100)
    assert abs(moved.drift) < 1e-3
    with pytest.raises(InputError, match="step: expected at most"):
        wp.move(op, start, density=2000.0, step=1.01 * longest, steps=1)


def test_what_fields_refuse():
    model, points, _, mu = laid()
    with pytest.raises(InputError, match="mu: expected a number, a function, or shape"):
        model.on(points, mu=mu[:-1])
    with pytest.raises(InputError, match="expected μ > 0"):
        model.on(points, mu=-mu)
    with pytest.raises(InputError, match="K W ≥ 0"):
        kernel("sign-changing", HORIZON).on(points, mu=mu).stiffest_wave()
    near = lattice(5, HORIZON)
    with pytest.raises(InputError, match=f"points: expected the {len(mu)} nodes of the fields"):
        model.spread(points, None, mu).on(near)
    solid, cracked = model.spread(points, None, mu), wp.Cracked(points, u=noise(points))
    for use in (
        lambda: wp.certify(solid, spacing=1.0),
        lambda: wp.solve(solid, cracked),
        lambda: wp.micromodulus.tensors_of(solid, 1.0),
        lambda: wp.damage.BrittleSolid(solid, 1.0, toughness=1.0),
    ):
        with pytest.raises(InputError, match="expected numbers, got fields"):
            use()


def test_a_period_with_fields_is_solved_and_a_file_keeps_them(tmp_path):
    model, whole = kernel("positive", HORIZON), periodic((12, 14))[0]
    mu = MU * (1.5 + np.sin(2 * np.pi * whole.x[:, 0] / 12))
    solid = model.spread(whole, 0.4 * mu, mu)
    b = noise(whole)
    answer = wp.solve(solid, wp.Periodic(whole, b))
    assert error(answer.operator(answer.u), b - b.mean(axis=0)) < 1e-7
    assert answer.proven is None
    wp.save(tmp_path / "m.json", solid)
    again = wp.load(tmp_path / "m.json")
    assert np.array_equal(again.mu, mu)
    assert np.array_equal(again.on(whole)(b), answer.operator(b))
    other = again.in_units(("nm", "GPa"))
    there = wp.Points(
        whole.x / 10, whole.interior, 0.1, np.array(whole.box) / 10, units=other.units
    )
    assert error(other.on(there)(b / 10), 1e4 * answer.operator(b)) < 1e-13
    assert "λ, least and largest" in repr(again)
