"""Learning without loads: the truth up to its scale, sensitivities, and what cannot be known."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.sheets import NEAREST, hgo_dictionary, square, waves
from warp_peri import InputError
from warp_peri.materials.hyperelastic.energies import Dictionary, HyperelasticSolid, Term
from warp_peri.materials.hyperelastic.equilibrium import StaticProblem, TangentPattern
from warp_peri.materials.hyperelastic.fibres import (
    families,
    grouped,
    read_material,
    rose,
    with_corners,
    with_directions,
    with_families,
)
from warp_peri.materials.hyperelastic.from_displacement import (
    Search,
    Sections,
    Thickness,
    fit_displacement,
    fit_thickness,
)
from warp_peri.materials.hyperelastic.operator import HyperelasticOperator
from warp_peri.materials.hyperelastic.placed import hyperelastic_errors
from warp_peri.points.points import Points
from warp_peri.points.samples import PULL, Samples

TRUE_ANGLE, TRUE_EXPONENT = 1.1, 2.0
SIDE = 0.1


def sheet(angle=TRUE_ANGLE, exponent=TRUE_EXPONENT):
    terms = (Term("plane_stress"), Term("fibre_exponential", angle, exponent))
    return Dictionary(3.0, (), NEAREST, terms)


TRUTH = np.array([0.1] * 4 + [0.05, 0.15])


@pytest.fixture(scope="module")
def frames():
    """Unloaded equilibria of the true sheet with bent edges."""
    points = square(5)
    problem = StaticProblem(HyperelasticOperator(sheet(), points))
    stretched = points.x @ np.array([[0.25, 0.05], [0.0, 0.2]])
    edges = [stretched + waves(points, 0.25, seed) for seed in range(3)]
    return Samples(points, np.stack([problem.solve(TRUTH, None, u).u for u in edges]))


def test_ratios_are_found_and_the_scale_is_one(frames):
    fit = fit_displacement(frames, sheet(), stiffness=0.0, most_steps=20, tolerance=1e-9)
    measure = sheet().stiffness
    assert measure @ fit.material.coefficients == pytest.approx(1.0)
    np.testing.assert_allclose(
        fit.material.coefficients, TRUTH / (measure @ TRUTH), rtol=1e-3, atol=1e-5
    )
    assert fit.errors.max() < 1e-5


def test_deviations_stay_between_their_bounds(frames):
    fit = fit_displacement(frames, sheet(), stiffness=(0.1, 0.12), most_steps=4)
    deviations = fit.material.coefficients[:4]
    assert deviations.min() > 0.1 - 1e-6
    assert deviations.max() < 0.12 + 1e-6


def test_direction_and_exponent_are_found(frames):
    start = sheet(TRUE_ANGLE + 0.3, 1.0)
    fit = fit_displacement(frames, start, stiffness=0.0, moving=True, most_steps=30, tolerance=1e-6)
    fibre = fit.material.dictionary.terms[1]
    assert fibre.angle == pytest.approx(TRUE_ANGLE, abs=1e-3)
    assert fibre.exponent == pytest.approx(TRUE_EXPONENT, abs=2e-2)


def test_sensitivities_are_slopes_of_the_solved_displacement(frames):
    uneven = Thickness.over(frames.x, 2)
    uneven = replace(uneven, numbers=np.array([0.3, -0.2, 0.1, 0.15, -0.1]))
    path = Search(frames, sheet(1.0, 1.5), (0.0, np.inf), True, uneven)
    c = path.scaled(TRUTH)
    path.begin(c)
    assert path.balance()
    assert path.linearise()
    reduced, gap = path.equations[:, :-1], path.equations[:, -1]
    gradient = 2 * reduced.T @ gap
    numbers = path.now

    def loss(values):
        path.move(values - path.now)
        assert path.balance()
        return path.loss()

    for n in range(len(numbers)):
        step = 1e-4 * max(abs(numbers[n]), 0.1) * np.eye(len(numbers))[n]
        slope = (loss(numbers + step) - loss(numbers - step)) / (2 * step.max())
        assert gradient[n] == pytest.approx(slope, rel=1e-3, abs=1e-6 * np.abs(gradient).max())


def noisy(frames, size=0.002):
    """The same with noise in spacings."""
    noise = np.random.default_rng(1).standard_normal(frames.u.shape)
    return Samples(frames.points, frames.u + size * frames.spacing * noise)


def test_a_frame_left_out_by_one_step_is_as_by_a_fit_of_its_own(frames):
    seen = noisy(frames)
    settings = dict(stiffness=(0.1, 0.1), most_steps=20)
    fit = fit_displacement(seen, sheet(), **settings, tolerance=3e-3)
    for n, other in enumerate(fit.others):
        rest = Samples(seen.points, np.delete(seen.u, n, axis=0))
        full = fit_displacement(rest, sheet(), **settings, tolerance=1e-9)
        moved = full.material.coefficients - fit.material.coefficients
        step = other.material.coefficients - fit.material.coefficients
        assert np.abs(moved).max() > 1e-4
        np.testing.assert_allclose(step, moved, atol=0.05 * np.abs(moved).max())
        assert other.frames_left_out == [n]
        np.testing.assert_allclose(np.delete(other.errors, n), full.errors, rtol=1e-2)


def test_a_material_that_fits_takes_three_tangents_a_frame(frames, monkeypatch):
    made, factors = [], TangentPattern.factors

    def counted(pattern, op, u, *how):
        made.append(u)
        return factors(pattern, op, u, *how)

    monkeypatch.setattr(TangentPattern, "factors", counted)
    seen = noisy(frames, 1e-3)
    fit = fit_displacement(seen, sheet(), tolerance=1e-3)
    assert len(made) <= 3 * len(seen)
    assert fit.history[-1] < 2e-3
    np.testing.assert_allclose(
        [np.linalg.norm((u - v)[seen.interior]) / np.linalg.norm(v[seen.interior])
         for u, v in zip(fit.fields, seen.u)], fit.errors, rtol=1e-6,
    )  # fmt: skip


@pytest.fixture(scope="module")
def uneven_frames():
    """The same sheet where it is 1.8 times as thick at one side as at the other."""
    points = square(5)
    thickness = replace(Thickness.over(points.x, 2), numbers=np.array([0.2, -0.3, 0.0, 0.1, -0.2]))
    problem = StaticProblem(HyperelasticOperator(sheet(), points))
    problem = problem.with_thickness(thickness.at(points.x))
    stretched = points.x @ np.array([[0.25, 0.05], [0.0, 0.2]])
    edges = [stretched + waves(points, 0.1, seed) for seed in range(3)]
    return Samples(points, np.stack([problem.solve(TRUTH, None, u).u for u in edges])), thickness


def test_thickness_and_material_are_found_together(uneven_frames):
    frames, thickness = uneven_frames
    settings = dict(stiffness=0.0, most_steps=20, tolerance=1e-9)
    even = fit_displacement(frames, sheet(), **settings)
    fit = fit_displacement(frames, sheet(), thickness=2, **settings)
    measure = sheet().stiffness
    assert fit.history[-1] < 1e-5
    assert even.history[-1] > 0.003
    np.testing.assert_allclose(fit.thickness.numbers, thickness.numbers, atol=1e-3)
    np.testing.assert_allclose(
        fit.material.coefficients, TRUTH / (measure @ TRUTH), rtol=1e-3, atol=1e-5
    )


def test_an_uneven_sheet_goes_on_from_an_even_fit_or_begins_anew(uneven_frames):
    frames, thickness = uneven_frames
    settings = dict(stiffness=0.0, most_steps=20, tolerance=1e-9)
    even = fit_displacement(frames, sheet(), **settings)
    fit = fit_displacement(frames, sheet(), start=even, thickness=2, **settings)
    assert fit.history[-1] < 1e-5
    np.testing.assert_allclose(fit.thickness.numbers, thickness.numbers, atol=1e-3)


def test_a_known_material_tells_the_thickness_of_another_sheet(uneven_frames):
    frames, thickness = uneven_frames
    solid = HyperelasticSolid(sheet(), 3.0 * TRUTH, frames.spacing)
    fit = fit_thickness(frames, solid)
    np.testing.assert_allclose(fit.thickness.numbers, thickness.numbers, atol=1e-5)
    measure = sheet().stiffness
    np.testing.assert_allclose(fit.material.coefficients, TRUTH / (measure @ TRUTH), rtol=1e-12)
    uneven = hyperelastic_errors(solid, frames, thickness=thickness.at(frames.x))["E_u"]
    assert uneven < 1e-6
    assert hyperelastic_errors(solid, frames)["E_u"] > 0.003


def test_what_says_nothing_is_refused(frames):
    points = frames.points
    affine = Samples(points, np.stack([0.1 * points.x, points.x @ [[0.2, 0.1], [0.0, 0.3]]]))
    with pytest.raises(InputError, match="a homogeneous body of any material"):
        fit_displacement(affine, sheet())
    with pytest.raises(InputError, match="convex and stress-free"):
        fit_displacement(frames, Dictionary(3.0, ("square",), (), (Term("area"),)))
    with pytest.raises(InputError, match="with loads use fit_energy"):
        fit_displacement(Samples(points, frames.u, np.ones_like(frames.u)), sheet())


def test_numbers_that_make_no_sense_are_refused(frames):
    solid = HyperelasticSolid(sheet(), TRUTH, frames.spacing)
    for stiffness in (-1.0, np.nan, (0.1, 0.05), (0.1, np.nan), (1.0, 2.0, 3.0), "soft", np.inf):
        with pytest.raises(InputError, match="stiffness: expected"):
            fit_displacement(frames, sheet(), stiffness=stiffness)
    with pytest.raises(InputError, match="start: expected 6 coefficients"):
        fit_displacement(frames, sheet(), start=np.ones(2))
    for degree in (2.0, True, 7):
        with pytest.raises(InputError, match="degree: expected 1 to 6"):
            fit_displacement(frames, sheet(), thickness=degree)
    at_rest = Samples(frames.points, np.stack([frames.u[0], 0 * frames.u[0]]))
    with pytest.raises(InputError, match="frame 1 is at rest"):
        fit_displacement(at_rest, sheet())
    with pytest.raises(InputError, match="frame 1 is at rest"):
        fit_thickness(at_rest, solid)
    with pytest.raises(InputError, match="frames: expected one or more"):
        fit_thickness(Samples(frames.points, frames.u[:0]), solid)


@pytest.mark.parametrize("axis", [0, 1])
def test_sections_go_from_edge_to_edge(axis):
    """Of an affine field they carry its stress, edges included; a hole takes lines away."""
    x = SIDE * np.argwhere(np.ones((19, 14)))
    C, shape = 0.4, np.array([[1.2, 0.1], [-0.05, 1.1]])
    terms = (Term("plane_stress"),)
    P = 2 * C * (shape - np.linalg.inv(shape).T / np.linalg.det(shape) ** 2)
    thick = replace(Thickness.over(x, 1), numbers=np.array([0.3, -0.2]))
    for hole, lines in ((20.0, 19 - 12 if axis == 0 else 14 - 12), (0.6, 0)):
        kept = (np.abs(x - x.mean(axis=0)) > hole * SIDE).any(axis=1) | (hole > 1)
        points = Points(x[kept], np.arange(kept.sum()) == 0, SIDE)
        sheet = Samples(points, (x[kept] @ (shape - np.eye(2)).T)[None])
        if not lines:
            with pytest.raises(InputError, match=f"across {'xy'[axis]} from edge to edge"):
                Sections(sheet, Dictionary(terms=terms), axis)
            continue
        sections = Sections(sheet, Dictionary(terms=terms), axis)
        found = sections.stress(0, terms, np.array([C]), None)
        np.testing.assert_allclose(found, np.full(lines, P[axis, axis]), rtol=1e-9)
        uneven = sections.stress(0, terms, np.array([C]), thick)
        assert uneven.mean() == pytest.approx(P[axis, axis], rel=0.01)
        assert np.ptp(uneven) > 0.02 * P[axis, axis]


def test_forces_set_the_scale_and_their_scatter_is_told(frames):
    """One of the last frame, or of all, with an error of one of them."""
    sections = Sections(frames, sheet(), 1)
    pulls = [sections.stress(n, sheet().terms, TRUTH, None).mean() for n in range(len(frames))]
    settings = dict(stiffness=0.0, most_steps=20, tolerance=1e-9)
    for known, error in ((slice(2, None), 0.0), (slice(None), 0.0), (slice(None), 0.03)):
        pull = np.full((len(frames), 2), np.nan)
        pull[known, 1] = np.array(pulls)[known]
        pull[1, 1] *= 1 + error
        measured = replace(frames, arrays={PULL: pull})
        fit = fit_displacement(measured, sheet(), **settings)
        np.testing.assert_allclose(fit.material.coefficients, TRUTH, rtol=1e-3 + error, atol=1e-5)
        scales = [other.scale for other in fit.others]
        assert np.ptp(scales) < 1e-3 if error == 0 else np.ptp(scales) > 0.2 * error
        assert "stresses" not in fit.material.provenance
    with pytest.raises(InputError, match="pull with the sign of the sheet's stress"):
        fit_displacement(replace(measured, arrays={PULL: -pull}), sheet(), **settings)


def test_small_strain_tells_no_material(frames):
    """Below 2 % noise decides on the bulk modulus: 20 % off at 1.3 % and noise of .003 spacings."""
    small = Samples(frames.points, 0.05 * frames.u)
    with pytest.raises(InputError, match=r"expected strains of 2 % or more in one, got 1\.\d"):
        fit_displacement(small, sheet())
    both = Samples(frames.points, np.stack([small.u[0], frames.u[0]]))
    assert len(fit_displacement(both, sheet(), most_steps=1).errors) == 2


def test_errors_are_relative_and_counted(frames):
    solid = HyperelasticSolid(sheet(), TRUTH, frames.spacing)
    exact = hyperelastic_errors(solid, frames)
    assert "E_res" not in exact
    assert exact["E_u"] < 1e-6
    assert exact["not_solved"] == exact["left_branch"] == 0
    shifted = hyperelastic_errors(solid, frames, truth=1.1 * frames.u)
    assert shifted["E_u"] == pytest.approx(0.1 / 1.1, rel=1e-5)


def test_families_come_from_a_rose():
    dictionary = Dictionary(3.0, (), NEAREST, (Term("neo_hookean"), *rose(8, (2.0, 4.0))))
    c = np.zeros(len(dictionary))
    c[dictionary.first_term] = 0.07
    for n, value in ((3, 0.2), (4, 0.1), (6, 0.3)):
        c[dictionary.first_term + 1 + 2 * n] = value
    solid = HyperelasticSolid(dictionary, c, 0.1, stretch=1.3)
    apart, start = families(solid)
    assert [round(np.rad2deg(t.angle), 1) for t in apart.terms[1:]] == [67.5, 90.0, 135.0]
    together, _ = families(solid, within=0.4)
    assert [round(np.rad2deg(t.angle), 1) for t in together.terms[1:]] == [75.0, 135.0]
    assert start[dictionary.first_term] == 0.07
    assert grouped({0.05: 1.0, 3.1: 1.0}, 0.2)[0][0] == pytest.approx(0.0042, abs=1e-3)


def test_a_material_is_read_out_of_loaded_fields():
    points = square(6)
    terms = (Term("neo_hookean"), Term("volumetric"), Term("fibre_exponential", 0.5, 1.5))
    dictionary = Dictionary(3.0, (), NEAREST, terms)
    truth = np.array([0.2] * 4 + [0.07, 0.08, 0.2])
    op = HyperelasticOperator(dictionary, points)
    u = np.stack([waves(points, 0.4, seed) for seed in range(4)])
    solid = read_material(Samples(points, u, op.everywhere(u, truth)), directions=8)
    fibres = [t for t in solid.dictionary.terms if t.kind == "fibre_exponential"]
    assert len(fibres) == 1
    assert fibres[0].angle == pytest.approx(0.5, abs=1e-3)
    assert fibres[0].exponent == pytest.approx(1.5, abs=1e-2)
    of_terms = solid.coefficients[solid.dictionary.first_term :]
    np.testing.assert_allclose(of_terms, truth[4:], rtol=1e-2)
    np.testing.assert_allclose(solid.coefficients[:4], truth[:4], rtol=1e-2)
    wide = with_directions(Dictionary(3.0, terms=tuple(rose(4))), solid)
    assert [term.angle for term in wide.terms[12:]] == [fibres[0].angle] * 4
    assert with_directions(wide, solid) == wide


def test_energies_of_corners_have_the_initial_stiffness_of_the_nodes():
    measure = with_corners(hgo_dictionary()).stiffness
    assert (measure[4:] > 1).all()
    np.testing.assert_array_equal(measure[7:], measure[4:7])


def test_no_energy_joins_twice():
    dictionary = with_corners(hgo_dictionary())
    c = np.full(len(dictionary), 0.1)
    joined = with_families(hgo_dictionary(), HyperelasticSolid(dictionary, c, 0.1))
    assert len(joined) == len(hgo_dictionary()) + 1
    assert with_corners(dictionary) == dictionary


def test_a_law_from_a_handful_of_nodes_is_refused(frames):
    """Three nodes inside and all else given: an answer a third off, with a band of no width."""
    few = np.zeros_like(frames.interior)
    few[np.flatnonzero(frames.interior)[[11, 12, 13]]] = True
    points = replace(frames.points, interior=few)
    with pytest.raises(InputError, match="60 measured components inside for 6 numbers, got 18"):
        fit_displacement(Samples(points, frames.u), sheet())
