"""The linear solid in three dimensions: identities, affine fields, gradients, matrices."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from tests.support.cubes import cube, periodic_cloud, solid
from tests.support.problems import difference
from warp_peri import load, save
from warp_peri.errors import InputError
from warp_peri.materials.lps import Model, moduli
from warp_peri.materials.lps_bonds import Bonds
from warp_peri.materials.lps_force import lps_force
from warp_peri.materials.lps_matrices import matrices, node_fields
from warp_peri.methods import Solid
from warp_peri.points.families import bond_classes, families_of

pytestmark = pytest.mark.filterwarnings("ignore:spacing. the model is certified")
LAW = {"alpha": 1.2, "D": [1.0, -0.3, 0.6]}
SETS = {"lattice": partial(cube, 2, 2.0), "cloud": partial(periodic_cloud, 6)}
HORIZON = {"lattice": 2.0, "cloud": 2.9}


def placed(name, **law):
    points, model = SETS[name](), solid(HORIZON[name], **LAW | law)
    return points, model, model.on(points, allow_uncertified=True)


def reference(model, points, u):
    """(6) and (9) with c1 = 3 and c2 = 30, node by node in NumPy."""
    families = families_of(points, model.horizon)
    lattice = families.lattice
    parts = []
    for i in range(len(points.x)):
        e = np.arange(families.row[i], families.row[i + 1])
        kind = e if lattice is None else lattice.bond_class[e - families.row[i]]
        far, r, W = families.neighbour[e], families.r[kind], families.weight[kind]
        there = far >= 0
        xi = points.x[far] - points.x[i]
        if points.box is not None:
            xi -= points.box * np.rint(xi / points.box)
        parts.append((far, xi, r, model.influence(r) * W, there.all()))
    theta = np.zeros(len(u))
    for i, (far, xi, r, K, whole) in enumerate(parts):
        if whole and K.any():
            theta[i] = 3 / (K @ r**2) * (K @ (xi * (u[far] - u[i])).sum(axis=1))
    out = []
    for i in families.rows:
        far, xi, r, K, _ = parts[i]
        along = (xi * (u[far] - u[i])).sum(axis=1) / r**2
        bulk = -3 * (model.lam - model.mu) / (K @ r**2) * K * (theta[i] + theta[far])
        out.append(xi.T @ (bulk - 30 * model.mu / (K @ r**2) * K * along))
    return np.array(out)


@pytest.mark.parametrize("name", SETS)
def test_the_operator_is_that_of_the_theory_and_of_its_matrices(name):
    points, model, operator = placed(name)
    u = np.random.default_rng(1).normal(size=(2, len(points.x), 3))
    Lu = operator(u)
    size = np.abs(Lu).max()
    assert np.abs(Lu[0] - reference(model, points, u[0])).max() < 1e-12 * size
    tensor = torch.from_numpy(u).requires_grad_()
    assert np.abs(operator(tensor).detach().numpy() - Lu).max() < 1e-12 * size
    L = matrices(model, points).operator(model.lam, model.mu)
    assert np.abs((L @ u.reshape(2, -1).T).T.reshape(Lu.shape) - Lu).max() < 1e-12 * size


def test_affine_fields_are_in_equilibrium_and_bear_hookes_stress():
    points, model, operator = placed("lattice", alpha=1.0, D=[1.0])
    G = np.random.default_rng(2).normal(size=(3, 3))
    u = points.x @ G.T
    assert np.abs(operator(u)).max() < 1e-12
    fields = node_fields(model, points, u)
    strain = (G + G.T) / 2
    stress = model.lam * np.trace(G) * np.eye(3) + 2 * model.mu * strain
    np.testing.assert_allclose(fields.stress[0], np.broadcast_to(stress, (8, 3, 3)), atol=1e-12)
    np.testing.assert_allclose(fields.dilatation, np.trace(G), atol=1e-12)
    np.testing.assert_allclose(fields.energy, (stress * strain).sum() / 2, rtol=1e-12)


def test_quadratic_fields_have_the_force_of_elasticity():
    points, model, operator = placed("lattice", alpha=1.0, D=[1.0])
    Q = np.random.default_rng(3).normal(size=(3, 3, 3))
    Q += Q.transpose(0, 2, 1)
    u = np.einsum("abc,nb,nc->na", Q, points.x, points.x) / 2
    expected = -(
        model.mu * np.einsum("abb->a", Q) + (model.lam + model.mu) * np.einsum("bba->a", Q)
    )
    assert np.abs(operator(u) - expected).max() < 1e-11


@pytest.mark.parametrize("name", SETS)
def test_gradients_to_the_field_and_to_every_number(name):
    points = SETS[name]()
    bonds = Bonds(points, HORIZON[name])
    random = np.random.default_rng(5)
    u = random.normal(size=(2, len(points.x), 3))
    way = random.normal(size=u.shape)
    seed = torch.from_numpy(random.normal(size=(2, int(points.interior.sum()), 3)))
    leaves = {"way": [0.0], "lam": [0.3], "mu": [0.8], "alpha": [1.2], "D": LAW["D"]}
    leaves = {part: np.atleast_1d(leaf).astype(float) for part, leaf in leaves.items()}
    steps = dict.fromkeys(leaves, (0.004, 8)) | dict.fromkeys(("way", "lam", "mu"), (1.0, 2))

    def scalar(t, *numbers):
        Lu = lps_force(bonds, torch.from_numpy(u) + t * torch.from_numpy(way), Solid(*numbers))
        return (seed * Lu).sum() + (Lu**2).sum() / 100

    given = [torch.tensor(leaf, requires_grad=True) for leaf in leaves.values()]
    gradients = dict(zip(leaves, torch.autograd.grad(scalar(*given), given)))
    for part in leaves:

        def value(leaf, part=part):
            with torch.no_grad():
                return scalar(*map(torch.from_numpy, (leaves | {part: leaf}).values())).item()

        expected = difference(value, leaves[part], *steps[part])
        error = np.abs(gradients[part].numpy() - expected).max()
        assert error < 1e-8 * np.abs(expected).max(), part


def test_broken_bonds_keep_affine_dilatations():
    points = cube(3, 2.0)
    beyond = points.x[:, 0] > 1
    cut = replace(points, interior=points.interior & ~beyond, outside=beyond)
    model = solid(2.0, **LAW)
    L = matrices(model, cut)
    G = np.random.default_rng(6).normal(size=(3, 3))
    theta = L.phi @ (points.x @ G.T).ravel()
    needed = np.diff(L.phi.indptr) > 0
    np.testing.assert_allclose(theta[needed], np.trace(G), atol=1e-12)
    u = np.random.default_rng(7).normal(size=points.x.shape)
    Lu = model.on(cut, allow_uncertified=True)(u)
    np.testing.assert_allclose(
        (L.operator(model.lam, model.mu) @ u.ravel()).reshape(Lu.shape), Lu, atol=1e-10
    )


def test_moduli_are_those_of_the_solid():
    model = solid(2.5)
    found = moduli(model, bond_classes(1.0, 2.5, dimension=3))
    assert found == pytest.approx({"C11": 1.9, "C12": 0.3, "C44": 0.8}, rel=1e-12)
    bulk = model.lam + 2 * model.mu / 3
    assert model.E == pytest.approx(9 * bulk * model.mu / (3 * bulk + model.mu))
    assert model.nu == pytest.approx(model.E / (2 * model.mu) - 1)
    with pytest.raises(InputError, match="expected one of 2 dimensions, those of the lattice"):
        moduli(model, bond_classes(1.0, 2.5))


def test_forces_turn_with_the_lattice_and_follow_the_units(tmp_path):
    points, model, operator = placed("lattice")
    u = np.random.default_rng(8).normal(size=points.x.shape)
    turn = Rotation.from_euler("xyz", [25, -40, 65], degrees=True).as_matrix()
    turned = replace(points, x=points.x @ turn.T)
    force = model.on(turned, allow_uncertified=True)(u @ turn.T)
    np.testing.assert_allclose(force, operator(u) @ turn.T, atol=1e-11)
    save(tmp_path / "m.json", model)
    other = load(tmp_path / "m.json", units=("nm", "GPa"))
    small = replace(points, x=points.x / 10, spacing=0.1, units=other.units)
    force = other.on(small, allow_uncertified=True)(u / 10)
    np.testing.assert_allclose(force, 1e4 * operator(u), rtol=1e-9, atol=1e-7)


def test_a_model_knows_its_dimension_in_its_file_and_on_points(tmp_path):
    model = solid(2.0, lam=-0.5)  # λ + μ < 2μ/3 is a solid, λ + 2μ/3 > 0 is asked
    model.save(tmp_path / "m.json")
    assert Model.load(tmp_path / "m.json").dimension == 3
    with pytest.raises(InputError, match="μ > 0 and λ \\+ 2μ/3 > 0"):
        solid(2.0, lam=-0.6)
    with pytest.raises(InputError, match="expected 2 dimensions, the model's"):
        replace(model, dimension=2).on(cube(2, 2.0), allow_uncertified=True)
    with pytest.raises(InputError, match="dimension: expected 2 or 3, got 4"):
        replace(model, dimension=4)
