"""Coefficients from fields: recovered where the dictionary holds the truth."""

import numpy as np
import pytest

import warp_peri as wp
from tests.support.sheets import NEAREST, everything, hgo_dictionary, sheet_on, square, waves
from warp_peri import Samples
from warp_peri.materials.hyperelastic.energies import EnergyTerm, Hyperelastic
from warp_peri.materials.hyperelastic.energy_fit import fit_energy, fit_fibre_families, of_samples

TRUTH = np.array([0.2, 0.15, 0.1, 0.1, 0.07, 0.08, 0.2])


@pytest.fixture(scope="module")
def samples():
    points = square(4)
    u = np.stack([waves(points, 0.3, seed) for seed in range(3)])
    return Samples(points, u, sheet_on(points, c=TRUTH).everywhere(u))


def test_least_squares_finds_the_truth(samples):
    fit = wp.fit(samples, hgo_dictionary(), ridge=0.0, progress=False)
    np.testing.assert_allclose(fit.material.coefficients, TRUTH, rtol=1e-6)
    assert fit.residual < 1e-8
    assert 1.1 < fit.material.stretch < 1.8
    fit = fit_energy(samples, hgo_dictionary(), positive=True, stiffness=0.12)
    assert (fit.material.coefficients[:4] >= 0.12).all()
    assert (fit.material.coefficients >= 0).all()
    assert fit.residual < 0.2


def test_the_reduced_equations_are_the_equations(samples):
    c = np.random.default_rng(0).normal(size=len(everything()))
    op = sheet_on(samples.points, everything(), c)
    R, y = of_samples(op, samples)
    b = samples.b[:, op.interior]
    left = np.linalg.norm((op.force(samples.u) - b).reshape(3, -1), axis=1)
    size = np.linalg.norm(b.reshape(3, -1), axis=1)
    assert np.linalg.norm(R @ c - y) == pytest.approx(np.sqrt(np.mean((left / size) ** 2)))


def test_a_material_is_read_out_of_loaded_fields():
    points = square(6)
    kinds = EnergyTerm("neo_hookean"), EnergyTerm("volumetric")
    fibre, truth = EnergyTerm("fibre_exponential", 0.5, 1.5), [0.2] * 4 + [0.07, 0.08, 0.2]
    u = np.stack([waves(points, 0.4, seed) for seed in range(4)])
    b = sheet_on(points, Hyperelastic(3.0, (), NEAREST, (*kinds, fibre)), truth).everywhere(u)
    solid = fit_fibre_families(Samples(points, u, b), directions=8)
    (fibre,) = [term for term in solid.dictionary.terms if term.is_fibre]
    assert fibre.angle == pytest.approx(0.5, abs=1e-3)
    assert fibre.exponent == pytest.approx(1.5, abs=1e-2)
    np.testing.assert_allclose(solid.coefficients, truth, rtol=1e-2)
