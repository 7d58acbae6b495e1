"""Properties that hold for any input: families, weights, operator, coarse graining, files."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.problems import lattice, noise, periodic
from warp_peri import Dataset, InputError, Model, Points, Samples, certify
from warp_peri.atoms import coarse_grain, smoothing_matrix
from warp_peri.materials.lps_matrices import matrices
from warp_peri.points.dataset import content_hash, load_dataset, save_dataset
from warp_peri.points.families import bond_classes, families_of
from warp_peri.points.quadrature import DEGREE, SINGULARITY, ball_integral

# Derandomised: the same examples in every run.
bounded = settings(max_examples=25, deadline=None, derandomize=True, database=None)
seeds = st.integers(0, 2**32 - 1)
spacings = st.floats(0.1, 50.0)
ratios = st.floats(2.0, 4.5)
finite = st.floats(-1e6, 1e6)
coefficients = st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=6)


@st.composite
def models(draw, spacing=1.0, ratio=ratios):
    """Models of any kernel whose weighted volume does not vanish on the lattice."""
    mu = draw(st.floats(0.1, 2.0))
    D = draw(coefficients)
    D[0] += 2.0  # the nearest bonds stay in charge
    return Model(
        lam=mu * draw(st.floats(-0.9, 5.0)),
        mu=mu,
        alpha=draw(st.floats(-1.0, 2.9)),
        D=np.array(D),
        horizon=spacing * draw(ratio),
        certified_on=(spacing,),
    )


@bounded
@given(spacings, ratios)
def test_weights_of_a_lattice_are_exact_and_symmetric(h, ratio):
    classes = bond_classes(h, ratio * h)
    weight, xi = classes.weight[classes.bond_class], classes.xi / classes.horizon
    r = np.hypot(*xi.T)
    for p in range(2, DEGREE + 1):
        for b in range(p + 1):
            q = xi[:, 0] ** (p - b) * xi[:, 1] ** b / r**3
            exact = ball_integral((p - b, b), SINGULARITY) * classes.horizon**2
            assert weight @ q == pytest.approx(exact, abs=1e-9 * np.abs(weight).sum())
    bonds = {tuple(step) for step in classes.steps.tolist()}
    assert bonds == {(-a, -b) for a, b in bonds} == {(b, a) for a, b in bonds}


@bounded
@given(seeds, st.floats(1.05, 3.0), st.floats(0, 0.4))
def test_families_of_points_are_mutual(seed, horizon, perturbation):
    points = periodic((9, 8))[0]
    shift = np.random.default_rng(seed).uniform(-perturbation, perturbation, points.x.shape)
    x = points.x + shift
    from warp_peri.points.scattered import neighbours

    row, neighbour, r = neighbours(x, horizon)
    node = np.repeat(np.arange(len(x)), np.diff(row))
    pairs = set(zip(node.tolist(), neighbour.tolist()))
    assert all((j, i) in pairs and i != j for i, j in pairs)
    distance = np.linalg.norm(x[:, None] - x, axis=2)
    assert len(pairs) == np.count_nonzero(distance <= horizon) - len(x)
    np.testing.assert_allclose(r, distance[node, neighbour], rtol=1e-12)


@bounded
@given(models(ratio=st.floats(2.0, 3.0)), seeds)
def test_the_operator_on_lattices_is_symmetric_and_blind_to_rigid_motion(model, seed):
    points = lattice(4, model.horizon)
    unknown = np.repeat(points.interior, 2)
    L = matrices(model, points).operator(model.lam, model.mu)[:, unknown].toarray()
    size = np.abs(L).max()
    np.testing.assert_allclose(L, L.T, rtol=0, atol=1e-11 * size)
    operator = model.on(points)
    a, b, turn = np.random.default_rng(seed).normal(size=3)
    rigid = np.array([a, b]) + turn * points.x @ np.array([[0, 1], [-1, 0]])
    assert np.abs(operator(rigid)).max() <= 1e-9 * size * np.abs(rigid).max()


@bounded
@given(models(ratio=st.floats(2.0, 3.0)), seeds, finite)
def test_the_operator_is_linear_and_balances_momentum(model, seed, factor):
    points, _ = periodic((8, 7))
    operator = model.on(points)
    u, v = noise(points, seed=seed), noise(points, seed=seed + 1)
    size = np.abs(operator(u)).max() + np.abs(operator(v)).max()
    both = operator(u + factor * v)
    expected = operator(u) + factor * operator(v)
    np.testing.assert_allclose(both, expected, rtol=0, atol=1e-12 * size * (1 + abs(factor)))
    np.testing.assert_allclose(operator(u).sum(axis=0), 0, atol=1e-11 * size * len(u))
    np.testing.assert_allclose(
        np.vdot(v, operator(u)), np.vdot(u, operator(v)), rtol=0, atol=1e-10 * size * len(u)
    )


@bounded
@given(seeds, st.floats(1.0, 3.0), st.sampled_from(["cone", "paraboloid"]), finite)
def test_coarse_graining_shares_atoms_out_and_is_linear(seed, radius, shape, factor):
    rng = np.random.default_rng(seed)
    atoms = rng.uniform(-6, 6, (60, 2))
    line = 1.3 * np.arange(-9, 10)
    nodes = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    omega = smoothing_matrix(atoms, nodes, radius=radius, shape=shape, spacing=1.3)
    assert (omega.data >= 0).all()
    np.testing.assert_allclose(omega.sum(axis=0), 1.0, rtol=1e-12)
    near = np.asarray(omega.sum(axis=1)) > 0
    u, f = rng.normal(size=(2, 2, 60, 2))
    options = {"mass": rng.uniform(1, 2, 60), "node_area": 1.69, "thickness": 3.35}
    alone, two, both = (
        coarse_grain(omega[near], displacement=a, force=b, **options)
        for a, b in (
            (u[:1], f[:1]),
            (u[1:], f[1:]),
            (u[:1] + factor * u[1:], f[:1] + factor * f[1:]),
        )
    )
    for first, second, mixed in zip(alone, two, both):
        expected = first + factor * second
        np.testing.assert_allclose(mixed, expected, rtol=0, atol=1e-12 * (1 + abs(factor)))
    still = coarse_grain(omega[near], displacement=0 * u + 3.0, force=0 * f, **options)[0]
    np.testing.assert_allclose(still, 3.0, rtol=1e-12)  # a rigid shift stays one
    total = both[1].sum(axis=1) * 1.69 * 3.35 / 0.1602176634
    np.testing.assert_allclose(
        total, (f[:1] + factor * f[1:]).sum(axis=1), rtol=0, atol=1e-10 * (1 + abs(factor))
    )


names = st.text(
    st.characters(exclude_characters="/\x00", exclude_categories=["Cs"]), min_size=1, max_size=12
).filter(lambda name: name not in (".", "x", "u", "b", "interior"))
texts = st.text(st.characters(exclude_characters="\x00", exclude_categories=["Cs"]), max_size=9)
jsons = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | finite | texts,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=6,
)


@bounded
@given(
    st.lists(names, min_size=1, max_size=3, unique=True), seeds, st.integers(0, 3), names,
    st.dictionaries(texts, jsons, max_size=3), st.lists(texts, min_size=3, max_size=3),
)  # fmt: skip
def test_data_sets_come_back_bit_by_bit(folder, sets, seed, samples, name, provenance, words):
    rng = np.random.default_rng(seed)
    made = {}
    for number, key in enumerate(sets):
        n = int(rng.integers(1, 9))
        x, u, b = rng.normal(size=(n, 2)), *rng.normal(size=(2, samples, n, 2))
        extra = {name: np.array(words[:samples])} if samples else {}
        interior = np.arange(n) <= number
        made[key] = Samples(Points(x, interior, float(rng.uniform(0, 9))), u, b, extra)
    data = Dataset(made, 3.35, 2000.0, provenance)
    save_dataset(folder / "d.h5", data)
    back = load_dataset(folder / "d.h5")
    assert content_hash(back) == content_hash(data)
    assert set(back) == set(data)
    assert back.provenance == data.provenance
    for key in sets:
        for field in ("x", "u", "b", "interior"):
            np.testing.assert_array_equal(getattr(back[key], field), getattr(data[key], field))
        for word, values in data[key].arrays.items():
            assert back[key].arrays[word].tolist() == values.tolist()


@bounded
@given(models(), st.dictionaries(texts, jsons, max_size=3))
def test_models_come_back_bit_by_bit(folder, model, record):
    on = model.certified_on if certify(model, spacing=1.0).holds else ()
    model = replace(model, provenance=record, certified_on=on)
    model.save(folder / "m.json")
    back = Model.load(folder / "m.json")
    for name in {*vars(model)} - {"file"}:
        assert np.array_equal(getattr(back, name), getattr(model, name)), name


@bounded
@given(models(), st.data())
def test_no_number_of_a_model_file_changes_unseen(folder, model, data):
    model.save(folder / "m.json")
    content = json.loads((folder / "m.json").read_text())
    key = data.draw(st.sampled_from(["lambda", "mu", "alpha", "horizon"]))
    changed = data.draw(finite.filter(lambda value: value != content[key]))
    (folder / "m.json").write_text(json.dumps(content | {key: changed}))
    with pytest.raises(InputError):
        Model.load(folder / "m.json")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("files")


@bounded
@given(st.integers(1, 4), st.integers(1, 5), ratios)
def test_every_node_of_a_lattice_that_carries_the_collar_has_a_full_family(rows, columns, ratio):
    points = lattice(np.ones((rows, columns), bool), ratio)
    families = families_of(points, ratio)
    bonds = len(families.pattern)
    full = families.neighbour.reshape(-1, bonds)[families.whole]
    assert (full >= 0).all()
    ends = points.x[full] - points.x[families.whole][:, None]
    np.testing.assert_allclose(ends, np.broadcast_to(families.pattern, ends.shape), atol=1e-9)
