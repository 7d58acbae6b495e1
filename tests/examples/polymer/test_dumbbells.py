"""Dumbbells against what is exact: Hookean moments, FENE ones at rest and stretched."""

import numpy as np
import pytest
from scipy.linalg import expm

from examples.polymer.closure import homogeneous
from examples.polymer.dumbbells import (
    Dumbbells,
    Ensembles,
    Twins,
    held,
    mixed,
    propagator,
    read_trajectory,
    rest_moment,
    simulate,
    stretched_rest,
)
from examples.polymer.laws import FENEP, IDENTITY, UpperConvectedMaxwell, elongation, shear
from warp_peri import InputError
from warp_peri.launch import set_threads, threads


def test_a_hookean_step_is_exact_in_its_moments():
    K, dt = np.array([0.3, 2.0, 0.5, -0.3]), 0.7
    A = np.array([[0.3, 2.0], [0.5, -0.3]]) - np.eye(2) / 2
    block = np.block([[-A, np.eye(2)], [np.zeros((2, 2)), A.T]])
    E = expm(block * dt)
    P, L = propagator(K[None], dt)
    lower = np.array([[L[0, 0], 0], [L[0, 1], L[0, 2]]])
    assert np.abs(P[0, :4].reshape(2, 2) - E[2:, 2:].T).max() < 1e-14
    assert np.abs(lower @ lower.T - E[2:, 2:].T @ E[:2, 2:]).max() < 1e-11
    assert P[0, 4] ** 2 + L[0, 3] ** 2 == pytest.approx(1, abs=1e-14)


def test_hookean_ensembles_follow_the_upper_convected_maxwell_law():
    count, K = 40_000, mixed(8, 12, 1.0, hold=3, seed=2)
    record = simulate(Dumbbells(8, count, seed=1), K, 0.25)
    exact = homogeneous(UpperConvectedMaxwell(), K, 0.25, parts=200)
    xx, xy, yy, zz = np.moveaxis(exact, -1, 0)
    deviation = np.sqrt(np.stack([2 * xx**2, xx * yy + xy**2, 2 * yy**2, 2 * zz**2], -1) / count)
    error = (record.C - exact) / deviation
    assert np.abs(error).max() < 4.5  # of 416 normal numbers
    assert 0.8 < np.sqrt(np.mean(error**2)) < 1.2


@pytest.mark.slow
@pytest.mark.parametrize("K", [0 * shear(1.0), elongation(0.4), elongation(2.0)])
def test_fene_ensembles_reach_the_exact_steady_state(K):
    b, m = 20.0, 10
    dumbbells = Dumbbells(m, 2000, b=b, seed=4)
    dumbbells.advance(K, 0.02, 400)
    moments, exact = dumbbells.moments(), stretched_rest(K, b)
    for sampled, truth in ((moments.C, exact.C), (moments.S, exact.S)):
        assert np.all(np.abs(sampled.mean(0) - truth[0]) < 4 * sampled.std(0) / np.sqrt(m) + 2e-3)
    if not K.any():
        assert np.allclose(exact.S[0], IDENTITY)
        assert np.allclose(exact.C[0], rest_moment(b) * IDENTITY)


@pytest.mark.parametrize("b", [None, 50.0])
def test_seeds_repeat_on_any_number_of_threads_and_runs_resume(b, tmp_path):
    K, before = mixed(3, 6, 1.0, hold=2), threads()
    whole = simulate(Dumbbells(3, 5000, b=b, seed=7), K, 0.1, steps=2)
    try:
        set_threads(1)
        again = simulate(Dumbbells(3, 5000, b=b, seed=7), K, 0.1, steps=2)
    finally:
        set_threads(before)
    assert np.array_equal(whole.S, again.S)
    file = tmp_path / "run.npz"
    dumbbells = Dumbbells(3, 5000, b=b, seed=7)
    advance, calls = dumbbells.advance, []

    def stop(*arguments):
        calls.append(1)
        if len(calls) > 4:
            raise KeyboardInterrupt
        return advance(*arguments)

    dumbbells.advance = stop
    with pytest.raises(KeyboardInterrupt):
        simulate(dumbbells, K, 0.1, steps=2, checkpoint=file)
    resumed = simulate(Dumbbells(3, 5000, b=b, seed=7), K, 0.1, steps=2, checkpoint=file)
    assert np.array_equal(whole.C, resumed.C)
    assert np.array_equal(whole.S, resumed.S)
    with pytest.raises(InputError, match="another run"):
        simulate(Dumbbells(3, 5000, b=b, seed=8), K, 0.1, steps=2, checkpoint=file)
    for other in ((2 * K, 0.1, 2), (K, 0.2, 2), (K, 0.1, 3)):
        made = Dumbbells(3, 5000, b=b, seed=7)
        with pytest.raises(InputError, match="another run"):
            simulate(made, *other[:2], steps=other[2], checkpoint=file)


def test_common_noise_and_matched_starts():
    dumbbells = Dumbbells(2, 500, common=True, matched=True, seed=3)
    start = dumbbells.moments()
    assert np.abs(start.C - IDENTITY).max() < 1e-5
    alike = dumbbells.advance(shear(1.0), 0.3)
    assert np.array_equal(alike.C[0], alike.C[1])


def test_bad_input_is_refused():
    with pytest.raises(InputError, match="above 3"):
        Dumbbells(1, 10, b=2.0)
    with pytest.raises(InputError, match="time step: expected at most 0.1 "):
        Dumbbells(1, 10, b=50.0).advance(shear(10.0), 0.2)
    with pytest.raises(InputError, match="shape"):
        simulate(Dumbbells(2, 10), held(shear(np.ones(3)), 4), 0.1)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"interval": 0.0}, "interval: expected a number > 0, got 0.0"),
        ({"interval": -0.1}, "interval: expected a number > 0"),
        ({"interval": np.nan}, "interval: expected a number > 0"),
        ({"steps": -1}, "steps: expected a whole number ≥ 1, got -1"),
        ({"steps": 1.5}, "steps: expected a whole number ≥ 1"),
    ],
)
def test_a_protocol_without_time_or_steps_is_refused(given, words):
    K = held(shear(np.ones(2)), 4)
    with pytest.raises(InputError, match=words):
        simulate(Dumbbells(2, 10), K, **({"interval": 0.1} | given))


def test_a_protocol_that_is_no_real_field_is_refused():
    K = held(shear(np.ones(2)), 4)
    for bad in (K + 1j, np.ma.masked_array(K, K == 1), np.full(K.shape, np.nan)):
        with pytest.raises(InputError, match="K: expected"):
            simulate(Dumbbells(2, 10), bad, 0.1)
    for given in ({"ensembles": np.nan}, {"count": 10.5}, {"b": "x"}):
        with pytest.raises(InputError, match="expected a"):
            Dumbbells(**{"ensembles": 2, "count": 10} | given)


def test_records_that_are_none_are_refused():
    K, C = np.zeros((3, 1, 4)), np.ones((4, 1, 4))
    Ensembles(0.1, K, C, C, 0)
    for wrong, words in (
        ((0.0, K, C, C, 10), "interval"),
        ((0.1, K, C, C, -1), "count: expected a whole number ≥ 0"),
        ((0.1, K, C[:3], C, 10), r"C: expected shape \[4, 1, 4\]"),
        ((0.1, K, C, np.nan * C, 10), "S: expected finite values"),
    ):
        with pytest.raises(InputError, match=words):
            Ensembles(*wrong)


def test_a_stress_trajectory_of_another_simulator(tmp_path):
    tau, modulus = 2.0, 5.0
    t = np.arange(0, 8, 0.4)
    xy = 0.3 * tau * modulus * (1 - np.exp(-t / tau))
    table = np.zeros((len(t), 9))
    table[:, 0], table[:, 2], table[:, 6] = t, 0.3, xy
    np.savetxt(tmp_path / "run.csv", table, delimiter=",")
    record = read_trajectory(tmp_path / "run.csv", tau, modulus, 1000)
    assert record.interval == pytest.approx(0.2)
    assert np.allclose(record.K[:, 0], shear(0.6))
    assert np.allclose(record.stress[:, 0, 1], 0.6 * (1 - np.exp(-t / tau)))
    np.savetxt(tmp_path / "run.csv", table[:, :4], delimiter=",")
    with pytest.raises(InputError, match="9 columns"):
        read_trajectory(tmp_path / "run.csv", tau, modulus, 1000)
    for n, name in enumerate(("relaxation_time", "modulus", "count")):
        wrong = [0 if n == m else value for m, value in enumerate((tau, modulus, 1000))]
        with pytest.raises(InputError, match=f"{name}: expected"):
            read_trajectory(tmp_path / "run.csv", *wrong)


@pytest.mark.parametrize(("K", "cut"), [(shear(0.5), 40), (elongation(0.3), 30), (shear(8.0), 3)])
def test_twins_take_noise_off_fene_dumbbells_and_nothing_else(K, cut):
    m, count = 24, 400
    twins, plain = Twins(m, count, b=50.0, seed=7), Dumbbells(m, count, b=50.0, seed=7)
    quiet, noisy = twins.advance(K, 0.02, 25).S, plain.advance(K, 0.02, 25).S
    assert np.array_equal(twins.q.numpy(), plain.q.numpy())
    assert np.all(noisy.var(axis=0) > cut * quiet.var(axis=0))
    assert np.all(np.abs(quiet.mean(0) - noisy.mean(0)) < 4 * noisy.std(0) / np.sqrt(m))
    with pytest.raises(InputError, match="20 dumbbells"):
        Twins(1, 10, b=50.0)


def test_twins_resume_with_the_same_bits(tmp_path):
    K, twins = mixed(2, 8, 1.0, hold=2), lambda: Twins(2, 100, b=50.0, seed=7)
    whole = simulate(twins(), K, 0.1, steps=2)
    half, file = twins(), tmp_path / "half.npz"
    simulate(half, K[:4], 0.1, steps=2)
    half.save(file)
    again = twins()
    again.load(file)
    assert np.array_equal(simulate(again, K[4:], 0.1, steps=2).S[1:], whole.S[5:])
    assert again.exact == pytest.approx(homogeneous(FENEP(50.0), K, 0.1)[-1], rel=0.02, abs=0.02)
