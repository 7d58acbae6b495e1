"""Coefficients from fields: recovered where the dictionary holds the truth."""

import numpy as np
import pytest

import warp_peri as wp
from tests.support.sheets import everything, hgo_dictionary, square, waves
from warp_peri import InputError
from warp_peri.materials.hyperelastic.energies import Dictionary, HyperelasticSolid, Term
from warp_peri.materials.hyperelastic.energy_fit import (
    UniformTangents,
    equations,
    fit_energy,
    non_negative,
    residual,
    shortest_margin,
    stable_coefficients,
    strains_of,
    zone,
)
from warp_peri.materials.hyperelastic.fibres import with_corners
from warp_peri.materials.hyperelastic.operator import HyperelasticOperator

MATRIX = (Term("neo_hookean"), Term("volumetric"))
SOFT = np.array([0.1, 0.1, 0.1, 0.1, 0.07, 0.08])
TRUTH = np.array([0.2, 0.15, 0.1, 0.1, 0.07, 0.08, 0.2])


@pytest.fixture(scope="module")
def samples():
    points = square(4)
    op = HyperelasticOperator(hgo_dictionary(), points)
    u = np.stack([waves(points, 0.3, seed) for seed in range(3)])
    b = op.everywhere(u, TRUTH)
    return square(4, u=u, b=b)


def test_least_squares_finds_the_truth(samples):
    fit = fit_energy(samples, hgo_dictionary(), ridge=0.0)
    np.testing.assert_allclose(fit.material.coefficients, TRUTH, rtol=1e-6)
    assert fit.residual < 1e-8
    assert 1.1 < fit.material.stretch < 1.8
    again = wp.fit(samples, hgo_dictionary(), ridge=0.0, progress=False)
    assert np.array_equal(again.material.coefficients, fit.material.coefficients)
    with pytest.raises(InputError, match="fit: expected options among positive, .*, got rigde"):
        wp.fit(samples, hgo_dictionary(), rigde=0.0)


def test_signs_are_kept_and_bounds_too(samples):
    fit = fit_energy(samples, hgo_dictionary(), positive=True, stiffness=0.12)
    c = fit.material.coefficients
    assert (c[:4] >= 0.12).all()
    assert (c >= 0).all()
    assert fit.residual < 0.2


def test_the_reduced_equations_are_the_equations(samples):
    op = HyperelasticOperator(everything(), samples)
    system = equations(op, samples)
    c = np.random.default_rng(0).normal(size=len(op.dictionary))
    b = samples.b[:, op.interior]
    left = np.linalg.norm((op.force(samples.u, c) - b).reshape(3, -1), axis=1)
    size = np.linalg.norm(b.reshape(3, -1), axis=1)
    assert residual(system, c) == pytest.approx(np.sqrt(np.mean((left / size) ** 2)), rel=1e-8)
    assert (non_negative(system) >= 0).all()


def test_waves_are_stable_where_they_are_asked_to_be(samples):
    strong = [np.diag([0.45, 1.1]), np.diag([1.2, 0.5])]
    bare = Dictionary(3.0, (), ((1, 0), (0, 1), (1, 1), (1, -1)), MATRIX)
    assert shortest_margin(HyperelasticSolid(bare, SOFT, 0.1), strong).min() < -0.1
    fit = fit_energy(samples, with_corners(hgo_dictionary()), positive=True, stable=0.05)
    assert fit.margin >= 0.98 * 0.05
    assert (fit.material.coefficients >= 0).all()
    assert fit.residual < 0.2
    op = HyperelasticOperator(fit.material.dictionary, samples)
    seen = strains_of(op, samples, 5)
    np.testing.assert_allclose(seen[0], np.eye(2), atol=2e-5)
    assert shortest_margin(fit.material, seen).min() > 0.04


def test_fibres_are_slack_at_rest(samples):
    """At the kink a difference sees half of a taut fibre: the margin is that of none."""
    dictionary = Dictionary(3.0, terms=(Term("neo_hookean"), Term("fibre_power", 0.3, 2.0)))
    op = HyperelasticOperator(dictionary, samples)
    rest = strains_of(op, samples, 1)[:1]
    tangents = UniformTangents.of(dictionary, samples.spacing, np.concatenate([rest, 1.01 * rest]))
    assert not tangents.stencils[0, ..., 1].any()
    assert tangents.stencils[1, ..., 1].any()


@pytest.mark.parametrize("stable", [np.nan, np.inf, -1.0, 0.0])
def test_a_margin_is_positive_and_finite(stable):
    with pytest.raises(InputError, match="finite margin > 0"):
        stable_coefficients(np.eye(1), np.ones(1), None, stable, scale=np.ones(1))


def test_a_margin_that_no_coefficients_reach_is_refused(samples):
    """Fibres alone carry no compression."""
    fibres = Dictionary(3.0, terms=(Term("fibre_power", 0.3, 2.0),))
    with pytest.raises(InputError, match="no coefficients reach the margin"):
        fit_energy(samples, fibres, stable=0.05)
    with pytest.raises(InputError, match="full rank"):
        stable_coefficients(np.zeros((2, 1)), np.ones(2), None, 0.05, scale=np.ones(1))


@pytest.mark.parametrize(
    ("strains", "words"),
    [
        (np.eye(2), "expected shape"),
        (np.zeros((0, 2, 2)), "F > 0"),
        (np.full((1, 2, 2), np.nan), "finite"),
        (np.zeros((1, 2, 2)), "determinants > 0"),
    ],
)
def test_what_is_no_strain_is_refused(strains, words):
    with pytest.raises(InputError, match=f"strains: .*{words}"):
        shortest_margin(HyperelasticSolid(hgo_dictionary(), np.ones(7), 0.1), strains)


@pytest.mark.parametrize("number", [np.nan, np.inf, -1.0])
@pytest.mark.parametrize("name", ["ridge", "stiffness"])
def test_weights_of_a_fit_are_finite(samples, name, number):
    with pytest.raises(InputError, match=f"{name}: expected a finite number"):
        fit_energy(samples, hgo_dictionary(), positive=True, **{name: number})


def test_the_uniform_tangent_is_the_tangent():
    dictionary = with_corners(hgo_dictionary())
    F = np.array([[0.8, 0.1], [0.05, 1.2]])
    points = square(1)
    op = HyperelasticOperator(dictionary, points)
    c = np.random.default_rng(3).uniform(0.05, 0.2, len(dictionary))
    tangents = UniformTangents.of(dictionary, points.spacing, F[None])
    ratios, directions = tangents.lowest(c)
    number = 7
    k = zone(8)[number]
    a = directions[0, number]
    centre = points.x[op.interior[0]]
    wave = np.cos((points.x - centre) @ k / points.spacing)[:, None] * a
    force = op.product(points.x @ (F - np.eye(2)).T, c, wave)[op.interior[0]]
    laplace = (4 * np.sin(k / 2) ** 2).sum() / points.spacing**2
    assert force @ a / laplace == pytest.approx(ratios[0, number], rel=1e-5)
    assert tangents.row(0, number, a) @ c == pytest.approx(ratios[0, number], rel=1e-12)


def test_what_cannot_be_learned_is_refused(samples):
    with pytest.raises(InputError, match="convex and stress-free"):
        fit_energy(samples, everything(), positive=True)
    with pytest.raises(InputError, match="loads are not known"):
        fit_energy(square(4, u=samples.u), hgo_dictionary())
