"""λ and μ as one value a node: equilibria, waves, files, and what is refused."""

from dataclasses import replace

import numpy as np

from tests.lps.test_force import HORIZON, error
from tests.support import approx, assert_refused, refused, warned
from tests.support.problems import LAM, MU, OTHER, kernel, lattice, noise, periodic
from warp_peri import Cracked, Direct, Dirichlet, Periodic, certify, solve
from warp_peri.core.proof import largest
from warp_peri.materials.lps_force import Bonds
from warp_peri.materials.lps_operator import node_fields


def laid():
    """A model, nodes and smooth fields of contrast four on them."""
    points = lattice(12, HORIZON)
    mu = MU * (2.5 + 1.5 * np.sin(points.x[:, 0] / 3) * np.cos(points.x[:, 1] / 4))
    return kernel("positive", HORIZON), points, 0.4 * mu, mu


def test_a_kernel_that_changes_sign_is_not_proven_with_fields():
    (_, points, lam, mu), solid = laid(), kernel("sign-changing", HORIZON)
    with warned("are not proven to have one stable answer"):
        answer = solve(
            solid, Dirichlet(points, None, noise(points)), solver=Direct(), lam=lam, mu=mu
        )
    assert answer.proven is None
    assert answer.residual < 1e-9
    with refused("K W ≥ 0"):
        answer.operator.max_symbol_eigenvalue()


def test_uniform_fields_are_the_model_and_functions_are_averaged_harmonically():
    model, points, *_ = laid()
    u, op = noise(points), model.on(points)
    same = model.on(points, mu=np.full(len(points.x), model.mu))
    assert error(same.stress(u), op.stress(u)) < 1e-14
    assert same.max_symbol_eigenvalue() == approx(largest(model.stencil(1.0), model.group))
    assert same.energy(u) == approx(op.energy(u))
    op = model.on(points, mu=lambda x: np.where(x[:, 0] < 0, 1.0, 3.0), lam=1.0)
    row = points.x[:, 1] == 0
    at, mu = points.x[row, 0], op.model.mu[row]
    assert mu[at < -HORIZON / 2] == approx(1.0)
    assert mu[at > HORIZON / 2] == approx(3.0)
    assert mu[at == 0] == approx(1.5, rel=0.1)


def test_what_fields_refuse():
    model, points, _, mu = laid()
    near, other = lattice(5, HORIZON), replace(points, units=OTHER)
    moved = replace(points, x=points.x + 1e3)
    solid, cracked = model.spread(points, None, mu), Cracked(points, u=noise(points))
    assert_refused({
        "mu: expected a number, or one of each of": lambda: model.on(points, mu=mu[:-1]),
        "mu: expected float values": lambda: model.on(points, mu=np.ndarray),
        "expected μ > 0": lambda: model.on(points, mu=-mu),
        f"points: expected the {len(mu)} nodes of the fields":
            (lambda: solid.on(near), lambda: node_fields(solid, moved, moved.x)),
        "units: the model is in": lambda: model.spread(other, None, mu),
        "mu: expected one number": lambda: Bonds(points, HORIZON).law(LAM, mu[:3], 1.0, [1.0]),
        "expected numbers, got fields":
            (lambda: certify(solid, spacing=1.0), lambda: solve(solid, cracked)),
    })  # fmt: skip


def test_a_period_with_fields_is_solved():
    model, whole = kernel("positive", HORIZON), periodic((12, 14))[0]
    mu = MU * (1.5 + np.sin(2 * np.pi * whole.x[:, 0] / 12))
    solid, b = model.spread(whole, 0.4 * mu, mu), noise(whole)
    answer = solve(solid, Periodic(whole, b))
    assert error(answer.operator(answer.u), b - b.mean(0)) < 1e-7
    assert "λ, least and largest" in repr(solid)
