"""Learning: the truth where the dictionary holds it; without loads up to its scale; slopes."""

from dataclasses import replace

import numpy as np
import torch
from numpy import array, eye, nan, ones, sqrt, zeros
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

import warp_peri as wp
from tests.support import approx, near, norms, refused, shared, sup, warned
from tests.support.problems import difference, normal
from tests.support.sheets import NEAREST, dictionary_of, hgo_dictionary, sheet_on, square, waves
from warp_peri.materials.hyperelastic import fibres
from warp_peri.materials.hyperelastic.energies import EnergyTerm, Hyperelastic
from warp_peri.materials.hyperelastic.fibres import ThicknessField
from warp_peri.materials.hyperelastic.lattice import SheetLattice
from warp_peri.materials.hyperelastic.operator import HyperelasticMaterial
from warp_peri.materials.hyperelastic.sheet_fit import Search, Sections, fit_fibre_families
from warp_peri.points.points import PULL, Points, Samples, grid_places

TRUE_ANGLE, TRUE_EXPONENT = 1.1, 2.0
TRUTH = array([0.1] * 4 + [0.05, 0.15])
TIGHT = {"stiffness": 0.0, "most_steps": 20, "tolerance": 1e-9}


def sheet(angle=TRUE_ANGLE, exponent=TRUE_EXPONENT):
    return dictionary_of(("plane_stress",), ("fibre_exponential", angle, exponent))


LOADED = array([0.2, 0.15, 0.1, 0.1, 0.07, 0.08, 0.2])
SCALED = TRUTH / (sheet().stiffness @ TRUTH)


def made(numbers, amplitude):
    """Unloaded equilibria of the true sheet with bent edges."""
    points = square(5)
    thickness = replace(ThicknessField.over(points.x, 2), numbers=array(numbers))
    op = sheet_on(points, sheet(), TRUTH, thickness.at(points.x))
    stretched = points.x @ [[0.25, 0.05], [0.0, 0.2]]
    edges = array([stretched + waves(points, amplitude, seed) for seed in range(3)])
    return Samples(points, op.solve(None, edges).u), thickness


@shared
def frames():
    return made(zeros(5), 0.25)[0]


def noisy(frames, size=0.002):
    """The same with noise in spacings."""
    return Samples(frames.points, frames.u + size * frames.spacing * normal(frames.u.shape, 1))


def test_ratios_directions_and_exponents_are_found_and_the_scale_is_one(frames):
    fit = wp.fit(frames, sheet(), **TIGHT)
    assert_allclose(fit.material.coefficients, SCALED, rtol=1e-3, atol=1e-5)
    assert fit.errors.max() < 1e-5
    start = sheet(TRUE_ANGLE + 0.3, 1.0)
    fit = wp.fit(frames, start, stiffness=0.0, moving=True, most_steps=30, tolerance=1e-6)
    fibre = fit.material.dictionary.terms[1]
    assert fibre.angle == approx(TRUE_ANGLE, abs=1e-3)
    assert fibre.exponent == approx(TRUE_EXPONENT, abs=2e-2)


def test_sensitivities_are_slopes_of_the_solved_displacement(frames):
    uneven = replace(ThicknessField.over(frames.x, 1), numbers=array([0.3, -0.2]))
    search = Search(frames[:1], sheet(1.0, 1.5), 0.0, True, uneven)
    place = search.settled(np.append(search.scaled(TRUTH), search.rest), frames.u, [0])
    place = search.settled(place.x, place.fields, [0])  # slopes of there
    rows, numbers = place.equations[0], place.x
    gradient = 2 * rows[:, :-1].T @ rows[:, -1]
    loss = lambda change: search.moved(place, change).loss()
    size = np.maximum(abs(numbers), 0.1)
    expected = difference(lambda t: loss(t * size), 0 * size, 1e-4, order=2) / size
    assert gradient == approx(expected, rel=1e-3, abs=1e-6 * sup(gradient))


def test_a_frame_left_out_by_one_step_is_as_by_a_fit_of_its_own(frames, monkeypatch):
    """And a material that fits takes three tangents a frame."""
    seen, made = noisy(frames), []
    factors = SheetLattice.factors
    monkeypatch.setattr(SheetLattice, "factors", lambda *of: made.append(of) or factors(*of))
    fit = wp.fit(noisy(frames, 1e-3), sheet(), tolerance=1e-3)
    assert len(made) <= 3 * len(seen)
    assert fit.residual < 2e-3
    fit = wp.fit(seen, sheet(), most_steps=20, tolerance=3e-3)
    gaps = (fit.fields - seen.u)[:, seen.interior]
    assert_allclose(np.divide(*norms(gaps, seen.u[:, seen.interior])), fit.errors, rtol=1e-6)
    full = wp.fit(seen[[0, 2]], sheet(), most_steps=20, tolerance=1e-9)
    moved = (full.material.coefficients - fit.material.coefficients)[-2:]
    step = (fit.others[1].material.coefficients - fit.material.coefficients)[-2:]
    assert sup(moved) > 1e-4
    near(step, moved, 0.1)
    assert [other.frames_left_out for other in fit.others] == [[0], [1], [2]]
    assert_allclose(fit.others[1].errors[[0, 2]], full.errors, rtol=1e-2)


def test_thickness_and_material_are_found_together():
    """Of a sheet that is 1.8 times as thick at one side as at the other."""
    frames, thickness = made([0.2, -0.3, 0.0, 0.1, -0.2], 0.1)
    even = wp.fit(frames, sheet(), **TIGHT)
    assert even.residual > 0.003
    fit = wp.fit(frames, sheet(), start=even, thickness=2, **TIGHT)
    assert fit.residual < 1e-5
    assert_allclose(fit.thickness.numbers, thickness.numbers, atol=1e-3)
    assert_allclose(fit.material.coefficients, SCALED, rtol=1e-3, atol=1e-5)
    solid = HyperelasticMaterial(sheet(), 3.0 * TRUTH, frames.spacing)
    uneven = wp.evaluate(solid.on(frames, thickness=thickness.at(frames.x)), frames)
    assert "E_res" not in uneven
    assert uneven["E_u"] < 1e-6
    assert uneven["not_solved"] == uneven["left_branch"] == 0
    assert wp.evaluate(solid, frames)["E_u"] > 0.003


def test_sections_go_from_edge_to_edge():
    """Of an affine field they carry its stress, edges included; a hole takes lines away."""
    x, C, shape = 0.1 * grid_places((19, 14)), 0.4, array([[1.2, 0.1], [-0.05, 1.1]])
    dictionary = Hyperelastic(terms=(EnergyTerm("plane_stress"),))
    solid = HyperelasticMaterial(dictionary, array([C]), 0.1)
    P = 2 * C * (shape - np.linalg.inv(shape).T / np.linalg.det(shape) ** 2)

    def sections(axis, kept):
        points = Points(x[kept], np.arange(kept.sum()) == 0, 0.1)
        return Sections(Samples(points, (x[kept] @ (shape - eye(2)).T)[None]), dictionary, axis)

    for axis, across in enumerate((19, 14)):
        whole, pull = sections(axis, ones(len(x), bool)), P[axis, axis]
        assert_allclose(whole.stress(0, solid, None), (across - 12) * [pull], rtol=1e-9)
        thick = replace(ThicknessField.over(x, 1), numbers=array([0.3, -0.2]))
        uneven = whole.stress(0, solid, thick)
        near(uneven.mean(), pull, 0.01)
        assert np.ptp(uneven) > 0.02 * pull
        with refused(f"across {'xy'[axis]} from edge to edge"):
            sections(axis, (np.abs(x - x.mean(0)) > 0.06).any(1))


def test_forces_set_the_scale_and_their_scatter_is_told(frames):
    """One of the last frame, or of all, with an error of one of them."""
    sections = Sections(frames, sheet(), 1)
    solid = HyperelasticMaterial(sheet(), TRUTH, frames.spacing)
    pulls = [sections.stress(n, solid, None).mean() for n in range(len(frames))]
    for known, error in ((slice(2, None), 0.0), (slice(None), 0.03)):
        pull = np.full((len(frames), 2), nan)
        pull[known, 1] = array(pulls)[known]
        pull[1, 1] *= 1 + error
        measured = replace(frames, arrays={PULL: torch.tensor(pull)})
        fit = wp.fit(measured, sheet(), **TIGHT)
        assert_allclose(fit.material.coefficients, TRUTH, rtol=1e-3 + error, atol=1e-5)
        scales = [other.scale for other in fit.others]
        assert np.ptp(scales) < 1e-3 if error == 0 else np.ptp(scales) > 0.2 * error
        assert "stresses" not in fit.material.provenance
    with refused("pull with the sign of the sheet's stress"):
        wp.fit(replace(measured, arrays={PULL: -pull}), sheet(), most_steps=1)


def test_families_come_from_a_rose():
    terms = EnergyTerm("neo_hookean"), *fibres.fibre_fan(8, (2.0, 4.0))
    dictionary = Hyperelastic(3.0, NEAREST, terms)
    c = zeros(len(dictionary))
    c[[4, 11, 13, 17]] = 0.07, 0.2, 0.1, 0.3
    solid = HyperelasticMaterial(dictionary, c, 0.1, stretch=1.3)
    for within, angles in ((0.0, [67.5, 90.0, 135.0]), (0.4, [75.0, 135.0])):
        found, start = fibres.fibre_families(solid, within=within)
        assert [round(np.rad2deg(t.angle), 1) for t in found.terms[1:]] == angles
        assert start[4] == 0.07
    assert fibres.grouped({0.05: 1.0, 3.1: 1.0}, 0.2)[0][0] == approx(0.0042, abs=1e-3)
    cornered = fibres.with_corners(hgo_dictionary())
    assert_array_equal(cornered.stiffness[7:], cornered.stiffness[4:7])
    assert fibres.with_corners(cornered) == cornered


def test_the_thickness_is_the_exponential_of_a_polynomial():
    x = default_rng(0).uniform(-1, 3, (50, 2))
    even = ThicknessField.over(x, 2)
    assert even.names == ["x", "y", "x^2", "x y", "y^2"]
    assert_array_equal(even.at(x), 1.0)
    uneven = replace(even, numbers=array([0.1, -0.2, 0.3, 0.4, -0.5]))
    p, q = 2 * ((x - x.min(0)) / np.ptp(x, axis=0)).T - 1
    expected = 0.1 * p - 0.2 * q + 0.3 * p**2 + 0.4 * p * q - 0.5 * q**2
    assert_allclose(np.log(uneven.at(x)), expected, atol=1e-14)


def loaded(count, size, interior):
    points = square(interior)
    u = np.stack([waves(points, size, seed) for seed in range(count)])
    return Samples(points, u, sheet_on(points, c=LOADED).everywhere(u))


def test_least_squares_finds_the_truth_and_says_what_forces_leave():
    loads = loaded(3, 0.3, 4)
    start = np.full(len(LOADED), 1e7)  # which a linear fit does not need
    fit = wp.fit(loads, hgo_dictionary(), progress=False, start=start)
    assert_allclose(fit.material.coefficients, LOADED, rtol=1e-6)
    assert fit.residual < 1e-8
    assert not fit.guaranteed
    assert 1.1 < fit.material.stretch < 1.8
    with warned(r"residual: 40.1 % of the loads are left"):
        wp.fit(replace(loads, b=loads.b + 0.5 * loads.b[::-1]), hgo_dictionary())
    fit = wp.fit(loads, hgo_dictionary(), positive=True, stiffness=0.12)
    assert fit.guaranteed
    assert (fit.material.coefficients[:4] >= 0.12).all()
    assert (fit.material.coefficients >= 0).all()
    b = loads.b[:, loads.interior]
    left, size = norms(fit.material.on(loads.points)(loads.u) - b, b)
    assert fit.residual == approx(sqrt(np.mean((left / size) ** 2)))
    assert 0 < fit.residual < 0.2


def test_a_material_is_read_out_of_loaded_fields():
    solid = fit_fibre_families(loaded(4, 0.4, 6), directions=8)
    (fibre,) = [term for term in solid.dictionary.terms if term.is_fibre]
    assert fibre.angle == approx(1.2, abs=1e-3)
    assert fibre.exponent == approx(1.5, abs=1e-2)
    assert_allclose(solid.coefficients, LOADED, rtol=1e-2)
