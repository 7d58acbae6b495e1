"""Force, energy, stress and solves on nodes against plain loops, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tests.crystal.crystals import lattice, learned, plain_force, random_law
from warp_peri.core.groups import checked_orientation
from warp_peri.errors import InputError
from warp_peri.points.points import Points

SIZE = {2: 12, 3: 6}
CASES = [(2, "ball"), (2, "period"), (3, "cube"), (3, "ball"), (3, "period")]


def body(d, kind, n=None):
    return lattice(d, n or SIZE[d], 2, ball=kind == "ball", box=kind == "period")


@pytest.mark.parametrize(("d", "kind"), CASES)
@pytest.mark.parametrize("method", ["rows", "fft"])
def test_force_is_that_of_a_plain_loop(d, kind, method):
    law, points = random_law(d), body(d, kind)
    u = np.random.default_rng(0).normal(size=(2, *points.x.shape))
    force = law.on(points, method=method)(u)
    assert force.shape == (2, points.interior.sum(), d)
    np.testing.assert_allclose(force[1], plain_force(law, points, u[1]), atol=1e-11)
    by_matrix = law.on(points, method=method).matrix() @ u[1].ravel()
    np.testing.assert_allclose(by_matrix, force[1].ravel(), atol=1e-11)


@pytest.mark.parametrize(
    ("d", "kind", "method"),
    [
        (2, "cube", "sine"),
        (2, "ball", "multigrid"),
        (2, "period", None),
        (3, "cube", "sine"),
        (3, "ball", "fft"),
        (3, "ball", "sine"),
    ],
)
def test_solves_find_the_field_whose_force_they_are_given(d, kind, method):
    law, points = learned(d), body(d, kind, {2: 26, 3: 9}[d])
    operator = law.on(points)
    rng = np.random.default_rng(6)
    u = rng.normal(size=points.x.shape)
    if kind == "period":
        u -= u.mean(axis=0)
    b = np.zeros_like(u)
    b[points.interior] = operator(u)
    if method == "sine" and kind == "ball":
        with pytest.raises(InputError, match="boxes"):
            operator.linear.solve(b[None], u[None], 1e-10, method)
        return
    (found,), (record,) = operator.linear.solve(b[None], u[None], 1e-10, method)
    assert record.residual <= 1e-10
    np.testing.assert_allclose(found, u, atol=1e-7)


def test_affine_fields_have_their_gradient_and_stress_on_a_turned_lattice():
    law, points, turn = learned(3), body(3, "ball"), checked_orientation(25.0, 3)
    stated = Points(points.x @ turn.T, points.interior, points.spacing, axis=turn)
    F = np.random.default_rng(3).normal(size=(3, 3))
    stress = np.einsum("ijkl,kl->ij", law.tensor(), (F + F.T) / 2)
    for where, own in ((points, np.eye(3)), (stated, turn)):
        operator, u = law.on(where), where.x @ (own @ F @ own.T).T + [1.0, 2.0, 3.0]
        inside = np.ones((points.interior.sum(), 1, 1))
        np.testing.assert_allclose(operator.stress(u), own @ stress @ own.T * inside, atol=1e-12)
        np.testing.assert_allclose(operator.gradient(u)[0], own @ F @ own.T, atol=1e-12)
    u = np.random.default_rng(1).normal(size=points.x.shape)
    force = law.on(points)(u) @ turn.T
    np.testing.assert_allclose(law.on(stated)(u @ turn.T), force, atol=1e-11)


@pytest.mark.parametrize(("d", "kind"), CASES)
def test_energy_is_that_of_every_bond_with_an_unknown_at_an_end(d, kind):
    law, points = random_law(d), body(d, kind)
    u, box = np.random.default_rng(5).normal(size=points.x.shape), points.box
    tree = cKDTree(points.x, boxsize=box)
    total, half = 0.0, 0.5 * law.spacing**d
    for step, C in zip(law.steps, law.tensors):
        x = points.x + law.spacing * step
        far, other = tree.query(x if box is None else x % box)
        bent = u[other] - u
        kept = (far < 1e-6) & (points.interior | points.interior[other])
        total += half * np.einsum("ni,ij,nj->", bent[kept], C, bent[kept])
    assert law.on(points).energy(u) == pytest.approx(total, rel=1e-10)


REFUSED = {
    "cut": (lambda law, p: law.on(replace(p, interior=p.interior | True)), "objective.*per radian"),
    "spacing": (lambda law, p: law.on(Points(2 * p.x, p.interior, 3.0)), "spacing"),
    "dimension": (lambda law, p: learned(2).on(p), "coordinates"),
    "collar": (lambda law, p: random_law(3, 3.0).on(p), "cut bonds: .*; give a collar"),
    "axis": (lambda law, p: law.on(replace(p, axis=checked_orientation(20.0, 3))), "stands at 20°"),
    "sign": (
        lambda law, p: replace(law, tensors=-law.tensors).on(p).solve(0 * p.x, p.x),
        "the operator on these 216 nodes is indefinite",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_nodes_that_do_not_fit_and_laws_that_are_not_positive_are_refused(name):
    call, words = REFUSED[name]
    with pytest.raises(InputError, match=words):
        call(replace(learned(3), certificate=None), body(3, "cube"))


def test_how_a_crystal_lies_is_stated_or_its_assumption_said_once():
    law, points, turn = learned(3), body(3, "cube"), checked_orientation(20.0, 3)
    turned = Points(points.x @ turn.T, points.interior, points.spacing)
    with pytest.warns(UserWarning, match="how the crystal lies"):
        law.on(turned)
    law.on(turned)  # once for these points
    law.on(replace(turned, axis=turn[:, [1, 2, 0]]))  # a symmetry of the crystal
