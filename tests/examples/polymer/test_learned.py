"""Learned laws: mixed flows from exact data, noise, Couette, objectivity, tables, files."""

import json
from dataclasses import replace

import numpy as np
import pytest

from examples.polymer.closure import (
    Closure,
    exact_pairs,
    heun,
    homogeneous,
    reached,
    start_pairs,
    window_pairs,
)
from examples.polymer.dumbbells import Dumbbells, Ensembles, held, simulate
from examples.polymer.gaussian_process import fit_process
from examples.polymer.laws import FENEP, IDENTITY, UpperConvectedMaxwell, elongation, shear
from examples.polymer.learned import OutsideWarning
from examples.polymer.plane import PlaneFlow, run_plane
from examples.polymer.rates import learn_rate, learn_shear
from examples.polymer.springs import SpringLaw, invariants, learn_spring, learn_twisted
from warp_peri import InputError, load, save

MAXWELL = UpperConvectedMaxwell()


def errors(law, test):
    rate = law.rate(test.K, test.s + IDENTITY)
    difference = np.linalg.norm(rate - test.rate, axis=0)[:3]
    return 100 * difference / np.linalg.norm(test.rate, axis=0)[:3]


@pytest.fixture(scope="module")
def exact():
    train = exact_pairs(MAXWELL, *reached(MAXWELL, 150, 0.15, seed=0))
    return train, exact_pairs(MAXWELL, *reached(MAXWELL, 400, 0.15, seed=1))


@pytest.fixture(scope="module")
def shears():
    rates = shear(np.linspace(-0.15, 0.15, 9))
    return simulate(Dumbbells(9, 1000, seed=5), held(rates, 500), 0.02)


@pytest.fixture(scope="module")
def spring():
    K = np.concatenate([shear(np.array([1.0, 3.0])), elongation(np.array([0.5, 1.0]))])
    K = np.concatenate([held(K, 30), np.zeros((20, 4, 4))])
    record = simulate(Dumbbells(4, 1500, b=50.0, seed=1), K, 0.1, steps=5)
    return learn_spring(record, points=60, outside="allow"), record


def test_mixed_flows_from_150_exact_samples(exact):
    train, test = exact
    assert errors(learn_rate(train, kernel="product", kinematics=False), test).max() < 0.1
    additive = errors(learn_rate(train, kinematics=False), test)
    assert additive.min() > 5  # sums cannot hold the products of K and s
    assert errors(learn_rate(train), test).max() < 0.1


def test_increments_belong_to_the_start_of_their_window(shears):
    slopes = {}
    for name, pairs in (("start", start_pairs(shears, 2)), ("mean", window_pairs(shears, 2))):
        A = np.stack([pairs.K[:, 1], pairs.s[:, 1]], axis=-1)
        slopes[name] = np.linalg.lstsq(A, pairs.rate[:, 1])[0][1]
        if name == "start":
            rest = pairs.rate[:, 1] - A @ [1, -1]
            assert rest.std() == pytest.approx(np.sqrt(pairs.noise[:, 1].mean()), rel=0.05)
    with pytest.raises(InputError, match="dumbbells would do"):
        start_pairs(shears, 2, largest=0.01)
    assert slopes["start"] == pytest.approx(-1, abs=0.2)
    assert slopes["mean"] > -0.6  # biased by what both have in common


@pytest.mark.slow
def test_start_up_between_plates_from_a_thousand_dumbbells():
    flow = PlaneFlow(1.0, 10.0, 64, top=lambda t: 1.0)
    run = lambda law: run_plane(flow, Closure(law, 1.0, 64), until=10.0, dt=0.02, every=10).u
    exact, errors = run(MAXWELL), []
    for seed in range(3):
        rates = held(shear(np.linspace(-150, 150, 9)), 500)
        record = simulate(Dumbbells(9, 1000, seed=seed), rates, 0.01)
        law = learn_shear(record, outside="allow", most=400)
        errors.append(np.abs(run(law) - exact).max())
    assert np.median(errors) < 0.03


def test_the_spring_of_hookean_dumbbells_is_exact():
    random = np.random.default_rng(0)
    record = simulate(Dumbbells(5, 50), held(random.uniform(-1, 1, (5, 4)), 10), 0.2)
    law = learn_spring(record, points=20, outside="allow")
    K, C = reached(MAXWELL, 50, 1.0)
    assert np.allclose(law.rate(K, C), MAXWELL.rate(K, C), atol=1e-10)


def test_a_learned_spring_beats_fenep_on_flows_it_never_saw(spring):
    law, _ = spring
    K = np.zeros((30, 2, 4))
    K[:, 0] = shear(2.0)
    K[:15, 1], K[15:, 1] = shear(3.0), [0.5, 1.0, 0.2, -0.5]
    truth = simulate(Dumbbells(2, 4000, b=50.0, seed=9), K, 0.1, steps=5)

    def error(fluid):
        s = fluid.stress(homogeneous(fluid, K, 0.1).reshape(-1, 4)).reshape(truth.S.shape)
        return np.linalg.norm((s - truth.stress)[..., :3]) / np.linalg.norm(truth.stress[..., :3])

    assert error(law) < 0.1
    assert error(law) < 0.5 * error(FENEP(50.0))


def test_a_learned_spring_is_objective_at_rest_and_positive(spring):
    law, record = spring
    C = record.C.reshape(-1, 4)[::7]
    assert np.abs(law.stress(law.rest[None])).max() < 1e-9
    S = law.spring(C)
    assert np.all(S[:, 0] * S[:, 2] > S[:, 1] ** 2)
    angle = 0.7
    Q = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def turned(A):
        full = Q @ A[:, [0, 1, 1, 2]].reshape(-1, 2, 2) @ Q.T
        return np.stack([full[:, 0, 0], full[:, 0, 1], full[:, 1, 1], A[:, 3]], -1)

    assert np.allclose(law.spring(turned(C)), turned(S), atol=1e-9)


def test_tables_agree_and_do_not_extrapolate(spring, exact):
    law, record = spring
    table, C = law.tabulated(), record.C.reshape(-1, 4)
    assert np.abs(table.spring(C) / law.spring(C) - 1)[:, [0, 2, 3]].max() < 1e-3
    far = np.array([[200.0, 0.0, 1e-3, 1e-3]])
    ends = np.exp(table.process(table.process.X)).max()
    assert 0 < table.spring(far)[0, 0] < 200 * 3 * ends
    train, test = exact
    additive = learn_rate(train, outside="allow")
    tabled = additive.tabulated()
    same = tabled.rate(test.K, test.s + IDENTITY) - additive.rate(test.K, test.s + IDENTITY)
    assert np.abs(same).max() < 1e-6
    K, C = 3 * test.K, 3 * test.s + IDENTITY  # some beyond the tables' ends
    marched = tabled.march(len(K))(K, C, 0.1, 2)
    assert np.abs(marched - heun(tabled, K, heun(tabled, K, C, 0.1), 0.1)).max() < 1e-12
    beyond = tabled.learned(np.full((1, 7), 1e3))
    assert np.allclose(beyond, tabled.learned(np.full((1, 7), 1e6)))
    with pytest.raises(InputError, match="additive"):
        learn_rate(train, kernel="product", kinematics=False).tabulated()


def test_laws_go_through_their_files(spring, exact, shears, tmp_path):
    train, test = exact
    file = tmp_path / "law.json"
    laws = [
        spring[0],
        learn_rate(train, kinematics=False),
        learn_shear(shears, most=60, outside="refuse"),
    ]
    for law in laws:
        save(file, replace(law, provenance={"dumbbells": 1}))
        again = load(file)
        assert again.provenance == {"dumbbells": 1}
        C = test.s + IDENTITY
        assert np.allclose(again.rate(test.K, C), law.rate(test.K, C), atol=1e-12)
        assert again.outside == law.outside
    content = json.loads(file.read_text())
    content["units"]["time"] = "second"
    file.write_text(json.dumps(content))
    with pytest.raises(InputError, match="units"):
        load(file)
    with pytest.raises(InputError, match="save: expected .* got UpperConvectedMaxwell"):
        save(file, MAXWELL)


def test_records_are_as_good_as_their_pairs(shears):
    law = learn_rate([shears, shears], window=2, most=60, rounds=1, progress=False)
    pairs = start_pairs(shears, 2).joined(start_pairs(shears, 2)).evenly(60)
    same = learn_rate(pairs, rounds=1, progress=False)
    C = shears.C[::50, 0]
    assert np.array_equal(law.rate(shears.K[::50, 0], C[:-1]), same.rate(shears.K[::50, 0], C[:-1]))
    with pytest.raises(InputError, match="records: expected one or more"):
        learn_rate([])
    with pytest.raises(InputError, match="expected one of simple shear, got 2"):
        learn_shear([shears, shears])


def test_a_law_refuses_states_beyond_its_data(exact):
    law = learn_rate(exact[0], kernel="product", kinematics=False, outside="refuse")
    closure = Closure(law, 1.0, 4, check_every=1)
    closure.advance(shear(np.full(4, 0.05)), 0.1)
    with pytest.raises(InputError, match="outside the training data"):
        closure.advance(shear(np.full(4, 2.0)), 0.1)
    with pytest.raises(InputError, match="at most 150"):
        exact[0].choose(151, np.random.default_rng(0))


def test_moments_that_are_not_positive_are_refused():
    C = np.array([[[1.0, 2.0, 1.0, 1.0]]])
    with pytest.raises(InputError, match="positive eigenvalues"):
        learn_spring(Ensembles(0.1, np.zeros((0, 1, 4)), C, C, 10))


def test_a_second_memory_turns_the_spring(tmp_path):
    K = np.concatenate([held(shear(np.array([1.0, 3.0, 6.0])), 40), np.zeros((20, 3, 4))])
    record = simulate(Dumbbells(3, 3000, b=50.0, seed=1), K, 0.1, steps=5)
    law = learn_twisted(record, b=50.0, points=100, turns=40, outside="allow")
    K = held(shear(np.array([4.5])), 40)
    truth = simulate(Dumbbells(1, 12_000, b=50.0, seed=9), K, 0.1, steps=5)

    def error(fluid):
        state = homogeneous(fluid, K, 0.1)
        C = state[..., :4]
        return np.linalg.norm(C - truth.C) / np.linalg.norm(truth.C)

    assert error(law) < 0.6 * error(law.spring_law)
    assert np.abs(law.stress(law.rest[None])).max() < 1e-9
    save(tmp_path / "law.json", law)
    again, state = load(tmp_path / "law.json"), homogeneous(law, K, 0.1)[-1]
    assert np.allclose(again.rate(K[0], state), law.rate(K[0], state), atol=1e-12)
    still = np.eye(4)[[0, 2, 3]].sum(0) * np.ones((3, 1, 1))
    content = json.loads((tmp_path / "law.json").read_text())
    first, *others = content["processes"]
    for change, words in (
        ({"outside": "ask"}, "outside: expected one of warn, refuse, allow, got 'ask'"),
        ({"b": 2.0}, "b: expected a number above 3"),
        ({"processes": [first] * 2}, "processes: expected 3 of them"),
        ({"processes": [first | {"size": "1"}, *others]}, "size: expected a finite number"),
        ({"processes": [first | {"kernel": "none"}, *others]}, "kernel: expected one of"),
        ({"processes": [first | {"y": [1.0]}, *others]}, "process: y do not fit"),
    ):
        (tmp_path / "bad.json").write_text(json.dumps(content | change))
        with pytest.raises(InputError, match=words):
            load(tmp_path / "bad.json")
    with pytest.raises(InputError, match="records: expected one or more"):
        learn_twisted([], b=50.0)
    with pytest.raises(InputError, match="shear or mixed"):
        learn_twisted(Ensembles(0.1, np.zeros((2, 1, 4)), still, still, 10), b=50.0)


def test_steady_shear_of_the_training_data_comes_back():
    K = np.concatenate([shear(np.array([2.0, 4.0, 8.0])), elongation(np.array([1.0, 2.0]))])
    K = np.concatenate([held(K, 40), np.zeros((30, 5, 4))])
    record = simulate(Dumbbells(5, 3000, b=50.0, seed=3), K, 0.1, steps=5)
    law = learn_twisted(record, b=50.0, points=80, turns=50, outside="allow")
    s = law.stress(homogeneous(law, held(shear(np.array([8.0])), 60), 0.1)[-1])[0]
    K = held(shear(np.array([8.0])), 60)
    truth = simulate(Dumbbells(1, 12_000, b=50.0, seed=9), K, 0.1, steps=5).stress[30:].mean(0)[0]
    assert s[0] - s[2] == pytest.approx(truth[0] - truth[2], rel=0.08)
    assert s[1] == pytest.approx(truth[1], rel=0.05)


def test_a_faster_flow_than_the_data_is_told_at_any_state(spring, tmp_path):
    law, record = spring  # shear to 3, elongation to 1
    save(tmp_path / "law.json", replace(law, outside="refuse"))
    again, state = load(tmp_path / "law.json"), record.C[20, :1]
    for K in (shear([3.2]), elongation([1.0]), 10 * np.array([[0.0, -1.0, 1.0, 0.0]]) / 7):
        again.check(K, state)  # a spin of 10/7 stretches nothing
    for K, kind in ((shear([3.5]), "rate of strain up to 1.75"), (elongation([1.3]), "beyond")):
        with pytest.raises(InputError, match=kind):
            again.check(K, state)
        with pytest.raises(InputError, match=kind):
            again.tabulated().check(K, state)
        with pytest.warns(OutsideWarning, match=kind):
            homogeneous(replace(law, outside="warn"), K[None], 0.1, start=state)
    content = json.loads((tmp_path / "law.json").read_text())
    del content["gradients"], content["sha256"]  # a file of before
    (tmp_path / "law.json").write_text(json.dumps(content))
    load(tmp_path / "law.json").check(shear([3.5]), state)


def test_rest_is_the_root_nearest_to_one():
    X = invariants(np.exp(np.linspace(-4, 1.5, 40))[:, None] * np.ones((40, 3)))[::3]
    wave = 1.5 * np.cos(1.7 * X[:, 0]) - 1.5 - X[:, 0]  # S = c again at a fraction of rest
    law = SpringLaw(fit_process(X, wave + 1e-3, noise=np.full(40, 1e-8)))
    assert np.abs(law.stress(law.rest[None])).max() < 1e-9
    assert law.rest[0] == pytest.approx(1.0, abs=0.1)


def test_a_law_shows_what_it_is_and_no_arrays(spring, exact):
    law = spring[0]
    for one in (law, law.tabulated((4, 4, 4)), learn_rate(exact[0], kinematics=False)):
        lines = repr(one).splitlines()
        assert lines[0] == type(one).__name__
        assert lines[1].split(maxsplit=1) == ["law", one.name]
        assert "array(" not in repr(one)
