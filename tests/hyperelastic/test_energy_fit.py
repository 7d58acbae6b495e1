"""Coefficients from fields: recovered where the dictionary holds the truth."""

import numpy as np
import pytest

import warp_peri as wp
from tests.support.sheets import NEAREST, everything, hgo_dictionary, square, waves
from warp_peri import InputError, Samples
from warp_peri.materials.hyperelastic.energies import EnergyTerm, Hyperelastic, HyperelasticMaterial
from warp_peri.materials.hyperelastic.energy_fit import (
    coefficients,
    equations,
    fit_energy,
    stability_margin,
    strains_of,
    wave_ratios,
    zone,
)
from warp_peri.materials.hyperelastic.fibres import fit_fibre_families, with_corners
from warp_peri.materials.hyperelastic.operator import HyperelasticOperator

FIBRE = (EnergyTerm("fibre_power", 0.3, 2.0),)
TRUTH = np.array([0.2, 0.15, 0.1, 0.1, 0.07, 0.08, 0.2])
SOLID = HyperelasticMaterial(hgo_dictionary(), TRUTH, 0.1)


@pytest.fixture(scope="module")
def samples():
    points = square(4)
    u = np.stack([waves(points, 0.3, seed) for seed in range(3)])
    return square(4, u=u, b=HyperelasticOperator(hgo_dictionary(), points).everywhere(u, TRUTH))


def test_least_squares_finds_the_truth(samples):
    fit = wp.fit(samples, hgo_dictionary(), ridge=0.0, progress=False)
    np.testing.assert_allclose(fit.material.coefficients, TRUTH, rtol=1e-6)
    assert fit.residual < 1e-8
    assert 1.1 < fit.material.stretch < 1.8


def test_signs_are_kept_and_bounds_too(samples):
    fit = fit_energy(samples, hgo_dictionary(), positive=True, stiffness=0.12)
    assert (fit.material.coefficients[:4] >= 0.12).all()
    assert (fit.material.coefficients >= 0).all()
    assert fit.residual < 0.2


def test_the_reduced_equations_are_the_equations(samples):
    op = HyperelasticOperator(everything(), samples)
    R, y = equations(op, samples)
    c = np.random.default_rng(0).normal(size=len(op.dictionary))
    b = samples.b[:, op.interior]
    left = np.linalg.norm((op.force(samples.u, c) - b).reshape(3, -1), axis=1)
    size = np.linalg.norm(b.reshape(3, -1), axis=1)
    assert np.linalg.norm(R @ c - y) == pytest.approx(np.sqrt(np.mean((left / size) ** 2)))
    assert (coefficients(R, y, 0 * c) >= 0).all()


def test_waves_are_stable_where_they_are_asked_to_be(samples):
    strong = [np.diag([0.45, 1.1]), np.diag([1.2, 0.5])]
    bare = Hyperelastic(3.0, (), NEAREST, (EnergyTerm("neo_hookean"), EnergyTerm("volumetric")))
    soft = np.array([0.1, 0.1, 0.1, 0.1, 0.07, 0.08])
    assert stability_margin(HyperelasticMaterial(bare, soft, 0.1), strong).min() < -0.1
    fit = fit_energy(samples, with_corners(hgo_dictionary()), positive=True, stable=0.05)
    assert fit.margin >= 0.98 * 0.05
    assert (fit.material.coefficients >= 0).all()
    assert fit.residual < 0.2
    seen = strains_of(HyperelasticOperator(fit.material.dictionary, samples), samples, 5)
    assert stability_margin(fit.material, seen).min() > 0.04


def test_the_ratio_of_a_wave_is_that_of_the_tangent_and_fibres_are_slack_at_rest():
    dictionary, points = with_corners(hgo_dictionary()), square(1)
    F = np.array([[0.8, 0.1], [0.05, 1.2]])
    op = HyperelasticOperator(dictionary, points)
    c = np.random.default_rng(3).uniform(0.05, 0.2, len(dictionary))
    ratio = wave_ratios(dictionary, points.spacing, np.stack([F, np.eye(2)]))
    k, centre = zone(8)[7], points.x[op.interior[0]]
    for a in np.eye(2):
        wave = np.cos((points.x - centre) @ k / points.spacing)[:, None] * a
        force = op.jvp(points.x @ (F - np.eye(2)).T, c, wave)[op.interior[0]]
        laplace = (4 * np.sin(k / 2) ** 2).sum() / points.spacing**2
        assert force @ a / laplace == pytest.approx(a @ ratio[0, 7] @ c @ a, rel=1e-10)
    fibre = dictionary.first_term + 2
    assert not ratio[1, ..., fibre].any()
    assert ratio[0, ..., fibre].any()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda s: fit_energy(s, everything(), positive=True), "convex and stress-free"),
        (lambda s: fit_energy(square(4, u=s.u), hgo_dictionary()), "loads are not known"),
        (lambda s: fit_energy(square(4, u=s.u, b=0 * s.u), hgo_dictionary()), "got one without"),
        (lambda s: fit_energy(s[:0], hgo_dictionary()), "samples: expected some"),
        (lambda s: fit_energy(s, hgo_dictionary(), ridge=np.nan), "ridge: expected a finite"),
        (lambda s: fit_energy(s, hgo_dictionary(), stiffness=-1.0), "stiffness: expected a finite"),
        (lambda s: fit_energy(s, hgo_dictionary(), stable=0.0), "finite margin > 0"),
        (lambda s: fit_energy(s, Hyperelastic(3.0, terms=FIBRE), stable=0.05), "reach the margin"),
        (lambda s: wp.fit(s, hgo_dictionary(), rigde=0.0), "options among positive, .*, got rigde"),
        (lambda _: stability_margin(SOLID, np.eye(2)), "strains: expected shape"),
        (lambda _: stability_margin(SOLID, np.zeros((0, 2, 2))), "strains: expected F > 0"),
        (lambda _: stability_margin(SOLID, np.full((1, 2, 2), np.nan)), "strains: .*finite"),
        (lambda _: stability_margin(SOLID, np.zeros((1, 2, 2))), "determinants > 0"),
    ],
)
def test_what_cannot_be_learned_is_refused(samples, call, words):
    with pytest.raises(InputError, match=words):
        call(samples)


def test_a_material_is_read_out_of_loaded_fields():
    points = square(6)
    terms = (
        EnergyTerm("neo_hookean"),
        EnergyTerm("volumetric"),
        EnergyTerm("fibre_exponential", 0.5, 1.5),
    )
    truth = np.array([0.2] * 4 + [0.07, 0.08, 0.2])
    op = HyperelasticOperator(Hyperelastic(3.0, (), NEAREST, terms), points)
    u = np.stack([waves(points, 0.4, seed) for seed in range(4)])
    solid = fit_fibre_families(Samples(points, u, op.everywhere(u, truth)), directions=8)
    (fibre,) = [term for term in solid.dictionary.terms if term.is_fibre]
    assert fibre.angle == pytest.approx(0.5, abs=1e-3)
    assert fibre.exponent == pytest.approx(1.5, abs=1e-2)
    np.testing.assert_allclose(solid.coefficients, truth, rtol=1e-2)
