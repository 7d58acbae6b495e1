"""Force, energy and solves of a crystal against plain loops, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from tests.crystal.crystals import lattice, learned, plain_energy, random_law
from warp_peri.core.elastic import checked_orientation
from warp_peri.errors import InputError
from warp_peri.points.points import Points

CASES = [(2, "ball"), (2, "period"), (3, "ball"), (3, "period")]


def body(d, kind, n=None):
    return lattice(d, n or {2: 12, 3: 6}[d], 2, ball=kind == "ball", box=kind == "period")


@pytest.mark.parametrize(("d", "kind"), CASES)
def test_force_and_energy_are_those_of_all_bonds(d, kind, monkeypatch):
    law, points = random_law(d), body(d, kind)
    u, v = np.random.default_rng(0).normal(size=(2, *points.x.shape))
    v[~points.interior] = 0
    operator = law.on(points)
    force = operator.force(np.stack([v, u]))[1]
    ends = [plain_energy(law, points, u + way * v) for way in (1, -1)]
    assert operator.energy(u) == pytest.approx(plain_energy(law, points, u), rel=1e-10)
    work = law.spacing**d * (force * v[points.interior]).sum()  # exact, for energies are squares
    assert (ends[0] - ends[1]) / 2 == pytest.approx(work, rel=1e-9)
    monkeypatch.setattr("warp_peri.solvers.linear.FFT_BONDS", {2: 0, 3: 0})
    np.testing.assert_allclose(law.on(points)(u), force, atol=1e-11)
    np.testing.assert_allclose(operator.matrix() @ u.ravel(), force.ravel(), atol=1e-11)


def test_a_turned_lattice_in_space_has_the_turned_gradient_stress_and_force():
    law, points, turn = learned(3), body(3, "ball"), checked_orientation(25.0, 3)
    stated = Points(points.x @ turn.T, points.interior, points.spacing, axis=turn)
    operator, F = law.on(stated), np.random.default_rng(3).normal(size=(3, 3))
    stress = turn @ np.einsum("ijkl,kl->ij", law.tensor(), (F + F.T) / 2) @ turn.T
    u = stated.x @ (turn @ F @ turn.T).T + [1.0, 2.0, 3.0]
    np.testing.assert_allclose(operator.stress(u) - stress, 0, atol=1e-12)
    np.testing.assert_allclose(operator.gradient(u)[0], turn @ F @ turn.T, atol=1e-12)
    u = np.random.default_rng(1).normal(size=points.x.shape)
    np.testing.assert_allclose(operator(u @ turn.T), law.on(points)(u) @ turn.T, atol=1e-11)


def test_nodes_that_do_not_fit_and_laws_that_are_not_positive_are_refused():
    law, p = replace(learned(3), certificate=None), body(3, "ball")
    for words, call in {
        "objective.*per radian": lambda: law.on(replace(p, interior=p.interior | True)),
        "spacing": lambda: law.on(Points(2 * p.x, p.interior, 3.0)),
        "coordinates": lambda: learned(2).on(p),
        "cut bonds: .*; give a collar": lambda: random_law(3, 3.0).on(p),
        "stands at 20°": lambda: law.on(replace(p, axis=checked_orientation(20.0, 3))),
        "expected symmetric matrices": lambda: law.on(p).at({"tensors": np.triu(law.tensors)}),
        "the operator on these .* nodes is indefinite": lambda: (
            replace(law, tensors=-law.tensors).on(p).solve(0 * p.x, p.x)
        ),
    }.items():
        with pytest.raises(InputError, match=words):
            call()


def test_how_a_crystal_lies_is_stated_or_its_assumption_said_once():
    law, points, turn = learned(3), body(3, "cube"), checked_orientation(20.0, 3)
    turned = Points(points.x @ turn.T, points.interior, points.spacing)
    with pytest.warns(UserWarning, match="how the crystal lies"):
        law.on(turned)
    law.on(turned)  # once for these points
    law.on(replace(turned, axis=turn[:, [1, 2, 0]]))  # a symmetry of the crystal
