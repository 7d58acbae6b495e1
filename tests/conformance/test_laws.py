"""What every law must do: a new law is done when it is in tests/support/materials.py and passes."""

from copy import copy, deepcopy
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from numpy.linalg import norm

import warp_peri as wp
from tests.support import approx, filterwarnings, materials, near, parametrize, sup
from tests.support.fields import answers, field, solved_samples, uneven
from tests.support.materials import KINKED, LAWS, OPERATORS, SPREAD, H, operator, placed
from tests.support.problems import OTHER, assert_balanced, noise, normal, on_interior, rotation
from tests.support.sheets import SPACING
from tests.support.told import all_refused, refused
from warp_peri import runtime, testing
from warp_peri.core.record import Record
from warp_peri.points.dataset import in_units

pytestmark = filterwarnings("ignore:strain:UserWarning")
TURN = 0.4


@pytest.fixture(params=LAWS)
def name(request):
    return request.param


def test_an_operator_offers_the_contract_and_a_field_is_one_of_several(name):
    op, points = placed(name)
    assert op.model.units == points.units
    assert op.model.dimension == points.x.shape[1]
    assert op.model.horizon == approx(LAWS[name].horizon * points.spacing)
    assert op.points is points
    b, u = noise(points, 2), uneven(points, 2)
    near(op.rhs(b), b[:, points.interior], 0)
    with torch.inference_mode():
        bent = op.jvp(u, b)
    near(bent, op.jvp(u, b), 0)


@filterwarnings("ignore:spacing", "ignore:outside")
@parametrize("name", OPERATORS)
def test_fields_have_any_axes_before_their_own_and_products_are_of_one_matrix(name):
    op = operator(name)
    u, own = field(op, 2, 3), -len(op.shape)
    v, w = field(op, 2, 3, seed=5), normal(op(u).shape, 2)
    rate, back = op.jvp(u, v), op.vjp(u, w)
    near((rate * w).sum(), (v * back).sum(), 1e-12, norm(rate) * norm(w))
    inner = lambda u: np.compress(op.points.interior, u, axis=own)
    reads = [op, op.energy, lambda u: op.jvp(u, u), lambda u: op.vjp(u, inner(u))]
    reads += [op.straight] if hasattr(op, "straight") else []
    for read in reads + [op.stress] * (op.points.outside is None):
        if (found := read(u)) is not None:
            assert found.shape[:2] == (2, 3)
            near(found[1, 2], read(u[1, 2]), 1e-12)
            all_refused(read, "expected ", (u[:0, 0], u * 1j))


def test_a_rigid_motion_and_uniform_strain_give_no_force(name):
    op, points = placed(name)
    size = sup(op(uneven(points)))
    for gradient in (0 * H, np.array([[0, -0.05], [0.05, 0]]), rotation(0.5) - np.eye(2), H):
        near(op(points.x @ gradient.T + (0.3, -0.2)), 0 * points.x[points.interior], 1e-11, size)


def test_stress_of_uniform_strain(name):
    op, points = placed(name)
    expected = LAWS[name].stress(LAWS[name].material(), H)
    near(op.stress(points.x @ H.T), np.tile(expected, (points.interior.sum(), 1, 1)), 1e-9)


def test_momentum_and_its_moment_balance(name):
    """Nodes are moved so far inside that every force they cause is on the interior."""
    law, (op, points) = LAWS[name], placed(name, 13)
    u = np.zeros_like(points.x)
    u[len(u) // 2] = (0.02 * points.spacing, -0.03 * points.spacing)
    f = op(u)
    assert sup(f) > 0
    assert_balanced(f)
    x = (points.x + law.force_turns * u)[points.interior]
    x = x - x.mean(0)
    moments = x[:, 0] * f[:, 1] - x[:, 1] * f[:, 0]
    if law.force_turns or not law.stress_turns:  # else of second order in the strain
        near(moments.sum(), 0.0, 1e-12, np.abs(moments).sum())


def test_momentum_on_a_periodic_lattice(name):
    law = LAWS[name]
    if not law.periodic:
        with refused("box"):
            law.material().on(wp.Points.sheet((14, 16), SPACING))
        return
    points = law.sheet()
    assert_balanced(law.material().on(points)(1e-2 * noise(points)))


def test_a_finite_rotation_turns_stress_and_force(name):
    law, (op, points) = LAWS[name], placed(name)
    R, u = rotation(0.5), points.x @ H.T
    if law.stress_turns:
        turned = op.stress((points.x + u) @ R.T - points.x)
        near(turned, R @ op.stress(u), 1e-10)  # of Piola: its first index turns
    if law.force_turns:
        u = uneven(points)
        near(op((points.x + u) @ R.T - points.x), op(u) @ R.T, 1e-11)


def test_a_turned_lattice_gives_the_turned_force(name):
    (op, points), (other, turned) = placed(name), placed(name, angle=TURN)
    R, u, v = rotation(TURN), uneven(points), noise(points)
    near(turned.x, points.x @ R.T, 1e-14)
    near(other(u @ R.T), op(u) @ R.T, 1e-11)
    near(other.jvp(u @ R.T, v @ R.T), op.jvp(u, v) @ R.T, 1e-11)
    near(other.stress(u @ R.T), R @ op.stress(u) @ R.T, 1e-11)


@parametrize("name", SPREAD)
def test_force_energy_product_units_and_file_pass_the_checks_of_any_material(name):
    op, points = placed(name)
    u, kinks = uneven(points), {"step": 1e-6, "tolerance": 1e-6} if name in KINKED else {}
    testing.check_force(op, u)
    testing.check_energy(op, u)
    testing.check_product(op, u, **kinks)
    material = SPREAD[name].on(points)
    testing.check_units(material, points, u, OTHER)
    own = name == "density"
    read = (lambda path: wp.DensityMaterial.read(path, materials.saint_venant)) if own else wp.load
    testing.check_file(material, points, u, read=read)


def test_other_units_prove_what_these_do_and_are_not_mixed_with_them(name):
    material, (op, points) = LAWS[name].material(), placed(name)
    back = material.in_units(OTHER).in_units(points.units).on(points)
    assert back.proven == op.proven if hasattr(op, "proven") else True
    with refused("in_units"):
        material.on(in_units(wp.Samples(points, uneven(points, 1)), OTHER).points)


def test_checks_of_a_material_see_what_is_wrong():
    """A force without a load, and energies, products, units and files off by a thousandth."""
    op, points = placed("own")
    u, law = uneven(points), SPREAD["own"].on(points)
    testing.check_material(law, points, u)
    wrong = {
        "force": (testing.check_force, lambda v: op(v) + 1e-3 * sup(op(u))),
        "energy": (testing.check_energy, lambda v: 1.001 * op.energy(v)),
        "jvp": (testing.check_product, lambda u, v: 1.001 * op.jvp(u, v)),
        "vjp": (testing.check_product, lambda u, w: 1.001 * op.vjp(u, w)),
    }
    for name, (check, method) in wrong.items():
        bad = copy(op)
        setattr(bad, name, method)
        with pytest.raises(AssertionError):
            check(bad, u)
    other = replace(law, c=1.001 * law.c)
    with pytest.raises(AssertionError):
        testing.check_file(law, points, u, read=lambda path: other)
    with pytest.raises(AssertionError):
        testing.check_units(SimpleNamespace(on=law.on, in_units=other.in_units), points, u)


@parametrize("name", [*LAWS, *materials.FLOWS, "cut"])
def test_arrays_may_change_after_they_were_given(name):
    op, given = operator(name), []

    def again(value):
        if isinstance(value, np.ndarray):
            given.append(value.copy())
            return given[-1]
        if isinstance(value, (wp.Points, Record)):
            for one in (value, deepcopy(value)):
                arrays = [part for part in vars(one).values() if isinstance(part, np.ndarray)]
                assert not any(part.flags.writeable for part in arrays)
            return replace(value, **{f.name: again(getattr(value, f.name)) for f in fields(value)})
        return value

    made, options = op._made_of
    twin = type(op)(*map(again, made), **{name: again(one) for name, one in options.items()})
    for one in given:
        one.fill(7)
    given = field(op, 2), field(op, 2, seed=1)
    assert all(map(np.array_equal, answers(op, *given), answers(twin, *given)))
    for way in "tangent", "interior_tangent", "storage":
        if read := getattr(op, way, None):
            made = [read(*given[0][: way != "storage"]).data for _ in range(2)]
            assert not np.shares_memory(*made)


def test_samples_and_influence_functions_keep_copies():
    points = LAWS["LPS"].points(2)
    u = np.tile([1.0, 2.0], (1, len(points.x), 1))
    samples, p = wp.Samples(points, u, u, {"a": u}), u[0, 0]
    K = wp.influence.InfluenceFunction(lambda r, p: p[0] * r, {"p": p}, {"p": p})
    table, found = wp.influence.table(p, p), (samples.u, samples.b, samples.arrays["a"])
    u += 7
    assert [K(2.0), table(2.0), *map(np.max, (*found, K.ends))] == 6 * [2.0]


@parametrize("name", SPREAD)
def test_threads_change_no_bit(name, monkeypatch, threads):
    monkeypatch.setattr(runtime, "SLICE", 16)  # so that a small lattice is shared out
    law = SPREAD[name]
    points = law.points(8)
    u, v = uneven(points, 2), noise(points, 2)
    found = []
    for count in (1, 2):
        threads(count)
        found.append(answers(law.on(points).on(points), u, v))
    assert all(map(np.array_equal, *found))


@parametrize("name", ["crystal", "own", "neural operator"])
def test_single_precision(name):
    (op, points), material = placed(name), LAWS[name].material()
    u = uneven(points)
    if name == "neural operator":
        force = material.float().on(points)(torch.from_numpy(u).float()).detach().numpy()
    else:
        force = material.on(points, dtype=np.float32)(u)
    assert force.dtype == np.float32
    # forces of single bonds cancel: what is lost is counted against the force of a rough field
    near(force, op(u), 1e-5, sup(op(sup(u) * noise(points))))


def test_a_solve_finds_the_truth_and_an_evaluation_no_error(name):
    op, points = placed(name)
    samples = solved_samples(op)
    solution = wp.solve(op, wp.Dirichlet(points, samples.b, on_interior(points, np.nan, samples.u)))
    near(solution.u, samples.u, 1e-8)
    assert solution.residual < 1e-8
    near(solution.stress(), op.stress(samples.u), 1e-7)
    if LAWS[name].energy:
        near(solution.energy(), op.energy(samples.u), 1e-7)
    else:
        with refused("energy"):
            solution.energy()
    one = samples[:1]
    errors = wp.evaluate(op, one)
    assert errors["E_res"] < 1e-13
    assert errors["E_u"] < 1e-8
    assert wp.evaluate(LAWS[name].material(), one) == errors
    none = np.empty((0, *points.x.shape))
    assert str([*none.shape]) in repr(wp.solve(op, wp.Dirichlet(points, none, none)))


def test_one_unknown_node_is_solved_for_whatever_is_not_read(name):
    points = LAWS[name].points(1)
    read = np.repeat(points.interior[:, None], 2, axis=1)
    b, u = np.where(read, 1e-3, np.nan), np.where(read, np.nan, 0.0)
    for load in (b, np.ma.masked_invalid(b)):
        solution = wp.solve(placed(name, 1)[0], wp.Dirichlet(points, load, u))
        assert np.isfinite(solution.u).all()
        assert solution.residual < 1e-6
