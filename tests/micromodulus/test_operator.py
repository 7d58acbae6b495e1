"""Force, energy, stress and solves on nodes: what every law of the library has to keep."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import warp_peri
from tests.micromodulus.crystals import lattice, learned, plain_force, random_law
from warp_peri.errors import InputError
from warp_peri.launch import set_threads, threads
from warp_peri.materials.crystal import Crystal
from warp_peri.points.points import Points
from warp_peri.points.samples import Samples
from warp_peri.solvers.linear import Linear
from warp_peri.solvers.verlet import critical_time_step

SIZE = {2: 12, 3: 6}
CASES = [(d, kind) for d in (2, 3) for kind in ("cube", "ball", "period")]


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


@pytest.mark.parametrize("d", [2, 3])
def test_motion_is_stable_below_the_longest_step_and_keeps_its_energy(d):
    law, points = learned(d), body(d, "ball")
    longest = warp_peri.proofs.critical_time_step(law, spacing=law.spacing, density=8e3)
    waves = np.random.default_rng(0).uniform(-np.pi, np.pi, size=(20000, d)) / law.spacing
    largest = np.linalg.eigvalsh(law.symbol(waves)).max()
    assert 0.999 * largest < law.stiffest_wave() < 1.05 * largest
    problem = warp_peri.Dirichlet(
        points, None, 1e-3 * np.random.default_rng(1).normal(size=points.x.shape)
    )
    moved = warp_peri.move(law, problem, density=8e3, step=longest, steps=300)
    assert np.abs(moved.u).max() < 0.05
    shorter = warp_peri.move(law, problem, density=8e3, step=longest / 2, steps=50)
    assert shorter.drift < 1e-9
    with pytest.raises(InputError, match="step: expected at most"):
        warp_peri.move(law, problem, density=8e3, step=1.01 * longest, steps=1)
    with pytest.raises(InputError, match="spacing: the model is for"):
        warp_peri.proofs.critical_time_step(law, spacing=2 * law.spacing, density=8e3)
    bare = replace(law, certificate=None)  # proven when it moves
    again = warp_peri.move(bare, problem, density=8e3, step=longest / 2, steps=50)
    assert np.array_equal(again.u, shorter.u)
    grows = replace(bare, tensors=-law.tensors)
    with pytest.raises(InputError, match="expected one whose certificate holds"):
        warp_peri.move(grows, problem, density=8e3, step=longest, steps=1)


@pytest.mark.parametrize("d", [2, 3])
def test_nodes_in_any_order_and_a_turned_lattice(d):
    law, points = learned(d), body(d, "ball")
    rng = np.random.default_rng(1)
    u = rng.normal(size=points.x.shape)
    force = law.on(points)(u)
    order = rng.permutation(len(u))
    shuffled = Points(points.x[order], points.interior[order], points.spacing)
    np.testing.assert_allclose(
        law.on(shuffled)(u[order]),
        force[np.argsort(np.argsort(order[points.interior[order]]))],
        atol=1e-12,
    )
    turn = np.linalg.qr(rng.normal(size=(d, d)) + 3 * np.eye(d))[0]
    turn *= np.sign(np.linalg.det(turn))
    stated = turn if d == 3 else np.degrees(np.arctan2(turn[1, 0], turn[0, 0]))
    turned = Points(points.x @ turn.T, points.interior, points.spacing, axis=stated)
    found = law.on(turned)(u @ turn.T)  # the crystal turns with its nodes
    np.testing.assert_allclose(found, force @ turn.T, atol=1e-11)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_the_bits_are_the_same_on_one_and_two_threads(d, dtype):
    law, points = random_law(d), lattice(d, {2: 90, 3: 20}[d], 2)
    u = np.random.default_rng(2).normal(size=points.x.shape)
    before = threads()
    try:
        found = []
        for count in (1, 2):
            set_threads(count)
            found.append([law.on(points, method=m, dtype=dtype)(u) for m in ("rows", "fft")])
    finally:
        set_threads(before)
    for one, two in zip(*found):
        assert one.dtype == dtype
        np.testing.assert_array_equal(one, two)
    exact = law.on(points)(u)
    np.testing.assert_allclose(
        found[0][0], exact, atol=(1e-5 if dtype == np.float32 else 1e-12) * np.abs(exact).max()
    )


@pytest.mark.parametrize("d", [2, 3])
def test_affine_fields_have_their_gradient_and_stress(d):
    law, points = learned(d), body(d, "ball")
    operator = law.on(points)
    rng = np.random.default_rng(3)
    F = rng.normal(size=(d, d))
    u = points.x @ F.T + rng.normal(size=d)
    strain = (F + F.T) / 2
    stress = np.einsum("ijkl,kl->ij", law.tensor(), strain)
    np.testing.assert_allclose(
        operator.stress(u), np.broadcast_to(stress, (points.interior.sum(), d, d)), atol=1e-12
    )
    np.testing.assert_allclose(operator.gradient(u)[0], F, atol=1e-12)
    constant = operator(np.broadcast_to(rng.normal(size=d), points.x.shape))
    assert np.abs(constant).max() == 0


@pytest.mark.parametrize(("d", "kind"), CASES)
def test_force_is_the_derivative_of_energy_and_the_tangent_that_of_force(d, kind):
    law, points = random_law(d), body(d, kind)
    operator = law.on(points)
    rng = np.random.default_rng(5)
    u, v = rng.normal(size=(2, *points.x.shape))
    v = v * points.interior[:, None]
    slope = (operator.energy(u + v) - operator.energy(u - v)) / 2  # exact: energy is quadratic
    work = (operator(u) * v[points.interior]).sum() * law.spacing**d
    assert slope == pytest.approx(work, rel=1e-8)
    tangent = (operator(u + v) - operator(u - v)) / 2
    np.testing.assert_allclose(operator.product(u, v), tangent, atol=1e-10)


@pytest.mark.parametrize(("d", "kind"), CASES)
@pytest.mark.parametrize("method", [None, "fft", "sine", "multigrid"])
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


@pytest.mark.parametrize("d", [2, 3])
def test_iterations_do_not_grow(d):
    law = learned(d)
    counts = []
    for n in {2: (40, 80), 3: (12, 24)}[d]:
        points = lattice(d, n, 2)
        operator = law.on(points)
        u = np.sin(2 * points.x / (n * law.spacing))
        b = np.random.default_rng(7).normal(size=u.shape) * 1e-3
        counts.append(
            [
                operator.linear.solve(b[None], u[None], 1e-8, m)[1][0].iterations
                for m in ("sine", "multigrid")
            ]
        )
    assert (np.array(counts[1]) <= np.array(counts[0]) + 4).all()
    assert max(counts[1]) <= 45


def test_cut_bonds_other_spacings_and_units_are_refused():
    law, points = learned(3), body(3, "cube")
    whole = Points(points.x, np.ones(len(points.x), bool), points.spacing)
    with pytest.raises(InputError, match="not objective.*per radian"):
        law.on(whole)
    with pytest.raises(InputError, match="spacing"):
        law.on(Points(2 * points.x, points.interior, 3.0))
    with pytest.raises(InputError, match="units"):
        law.in_units(("nm", "GPa")).on(points)
    with pytest.raises(InputError, match="coordinates"):
        learned(2).on(points)
    with pytest.raises(InputError, match="shape"):
        law.on(points)(np.zeros((3, 3)))


def test_how_a_crystal_lies_is_stated_or_its_assumption_said_once(tmp_path):
    law, points = learned(3), body(3, "cube")
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)) + 3 * np.eye(3))[0]
    turn *= np.sign(np.linalg.det(turn))
    turned = Points(points.x @ turn.T, points.interior, points.spacing)
    with pytest.warns(UserWarning, match="how the crystal lies"):
        law.on(turned)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        law.on(turned)  # once for these points
        stated = replace(turned, axis=turn)
        law.on(stated)
        law.on(replace(stated, axis=turn[:, [1, 2, 0]]))  # a symmetry of the crystal
    with pytest.warns(UserWarning, match="how the crystal lies"):  # others are other ones
        law.on(replace(turned, x=turned.x.copy()))
    with pytest.raises(InputError, match="stands at"):
        law.on(replace(turned, axis=np.eye(3)))
    with pytest.raises(InputError, match="rotation"):
        replace(turned, axis=2 * turn)
    u = np.zeros((1, *turned.x.shape))
    path = tmp_path / "turned.h5"
    warp_peri.save(path, warp_peri.Dataset({"train": Samples(stated, u)}, 1.0, 1.0))
    assert warp_peri.load(path)["train"].axis == stated.axis


def test_a_law_that_is_not_positive_is_refused_in_words_that_are_true():
    steps = np.array([[1, 0], [0, 1], [2, 0], [0, 2]])
    one = np.eye(2)
    law = Crystal(1.5, steps, np.array([one, one, -0.4 * one, -0.4 * one])).certified()
    assert not law.certificate.holds
    points = lattice(2, 6, 2)
    u = np.random.default_rng(0).normal(size=points.x.shape)
    with pytest.raises(InputError, match="the operator on these 36 nodes is indefinite"):
        warp_peri.solve(law, warp_peri.Dirichlet(points, None, u))


def test_a_body_that_nothing_moves_loses_no_energy():
    law, points = learned(2), lattice(2, 4, 3)
    step = 0.9 * critical_time_step(law, spacing=law.spacing, density=8960.0)
    problem = warp_peri.Dirichlet(points, None, np.zeros_like(points.x))
    assert warp_peri.move(law, problem, density=8960.0, step=step, steps=3).drift == 0


def test_the_collar_that_is_there_and_the_one_that_is_asked_are_told():
    law, points = random_law(2, reach=3.0), lattice(2, 12, 2)
    told = f"got 44 of 144 nodes with cut bonds in a collar {np.sqrt(8) * law.spacing:g} wide"
    with pytest.raises(InputError, match=f"{told}: .*; give a collar 4.5 wide"):
        law.on(points)
    with pytest.raises(InputError, match=f"{told}; give one 4.5 wide"):
        Linear(law.stencil, points)
