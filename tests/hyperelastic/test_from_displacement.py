"""Learning without loads: the truth up to its scale, sensitivities, and what cannot be known."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.sheets import NEAREST, hgo_dictionary, square, waves
from warp_peri import InputError
from warp_peri.materials.hyperelastic.energies import EnergyTerm, Hyperelastic, HyperelasticMaterial
from warp_peri.materials.hyperelastic.equilibrium import StaticProblem, TangentPattern
from warp_peri.materials.hyperelastic.fibres import fibre_families, fibre_fan, grouped, with_corners
from warp_peri.materials.hyperelastic.from_displacement import (
    Search,
    Sections,
    ThicknessField,
    fit_displacement,
    fit_thickness,
)
from warp_peri.materials.hyperelastic.operator import HyperelasticOperator
from warp_peri.materials.hyperelastic.placed import evaluate_hyperelastic
from warp_peri.points.points import Points
from warp_peri.points.samples import PULL, Samples

TRUE_ANGLE, TRUE_EXPONENT = 1.1, 2.0
TRUTH = np.array([0.1] * 4 + [0.05, 0.15])
TIGHT = {"stiffness": 0.0, "most_steps": 20, "tolerance": 1e-9}


def sheet(angle=TRUE_ANGLE, exponent=TRUE_EXPONENT):
    terms = (EnergyTerm("plane_stress"), EnergyTerm("fibre_exponential", angle, exponent))
    return Hyperelastic(3.0, (), NEAREST, terms)


SCALED = TRUTH / (sheet().stiffness @ TRUTH)


def made(numbers, amplitude):
    """Unloaded equilibria of the true sheet with bent edges."""
    points = square(5)
    thickness = replace(ThicknessField.over(points.x, 2), numbers=np.array(numbers))
    op = HyperelasticOperator(sheet(), points, thickness=thickness.at(points.x))
    stretched = points.x @ np.array([[0.25, 0.05], [0.0, 0.2]])
    edges = [stretched + waves(points, amplitude, seed) for seed in range(3)]
    problem = StaticProblem(op)
    return Samples(points, np.stack([problem.solve(TRUTH, None, u).u for u in edges])), thickness


@pytest.fixture(scope="module")
def frames():
    return made(np.zeros(5), 0.25)[0]


@pytest.fixture(scope="module")
def uneven_frames():
    """A sheet that is 1.8 times as thick at one side as at the other."""
    return made([0.2, -0.3, 0.0, 0.1, -0.2], 0.1)


def noisy(frames, size=0.002):
    """The same with noise in spacings."""
    noise = np.random.default_rng(1).standard_normal(frames.u.shape)
    return Samples(frames.points, frames.u + size * frames.spacing * noise)


def test_ratios_are_found_and_the_scale_is_one(frames):
    fit = fit_displacement(frames, sheet(), **TIGHT)
    np.testing.assert_allclose(fit.material.coefficients, SCALED, rtol=1e-3, atol=1e-5)
    assert fit.errors.max() < 1e-5
    bounded = fit_displacement(frames, sheet(), stiffness=(0.1, 0.12), most_steps=4)
    deviations = bounded.material.coefficients[:4]
    assert deviations.min() > 0.1 - 1e-6
    assert deviations.max() < 0.12 + 1e-6


def test_direction_and_exponent_are_found(frames):
    start = sheet(TRUE_ANGLE + 0.3, 1.0)
    fit = fit_displacement(frames, start, stiffness=0.0, moving=True, most_steps=30, tolerance=1e-6)
    fibre = fit.material.dictionary.terms[1]
    assert fibre.angle == pytest.approx(TRUE_ANGLE, abs=1e-3)
    assert fibre.exponent == pytest.approx(TRUE_EXPONENT, abs=2e-2)


def test_sensitivities_are_slopes_of_the_solved_displacement(frames):
    uneven = ThicknessField.over(frames.x, 2)
    uneven = replace(uneven, numbers=np.array([0.3, -0.2, 0.1, 0.15, -0.1]))
    path = Search(frames, sheet(1.0, 1.5), (0.0, np.inf), True, uneven)
    path.begin(path.scaled(TRUTH))
    assert path.balance()
    assert path.linearise()
    gradient = 2 * path.equations[:, :-1].T @ path.equations[:, -1]
    numbers = path.now

    def loss(values):
        path.move(values - path.now)
        assert path.balance()
        return path.loss()

    for n in range(len(numbers)):
        step = 1e-4 * max(abs(numbers[n]), 0.1) * np.eye(len(numbers))[n]
        slope = (loss(numbers + step) - loss(numbers - step)) / (2 * step.max())
        assert gradient[n] == pytest.approx(slope, rel=1e-3, abs=1e-6 * np.abs(gradient).max())


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
    gaps, sizes = ((fields[:, seen.interior] ** 2).sum(axis=(1, 2)) ** 0.5
                   for fields in (fit.fields - seen.u, seen.u))  # fmt: skip
    np.testing.assert_allclose(gaps / sizes, fit.errors, rtol=1e-6)


def test_thickness_and_material_are_found_together(uneven_frames):
    frames, thickness = uneven_frames
    even = fit_displacement(frames, sheet(), **TIGHT)
    assert even.history[-1] > 0.003
    for start in (None, even):
        fit = fit_displacement(frames, sheet(), start=start, thickness=2, **TIGHT)
        assert fit.history[-1] < 1e-5
        np.testing.assert_allclose(fit.thickness.numbers, thickness.numbers, atol=1e-3)
        np.testing.assert_allclose(fit.material.coefficients, SCALED, rtol=1e-3, atol=1e-5)


def test_a_known_material_tells_the_thickness_of_another_sheet(uneven_frames):
    frames, thickness = uneven_frames
    solid = HyperelasticMaterial(sheet(), 3.0 * TRUTH, frames.spacing)
    fit = fit_thickness(frames, solid)
    np.testing.assert_allclose(fit.thickness.numbers, thickness.numbers, atol=1e-5)
    np.testing.assert_allclose(fit.material.coefficients, SCALED, rtol=1e-12)
    uneven = evaluate_hyperelastic(solid, frames, thickness=thickness.at(frames.x))
    assert "E_res" not in uneven
    assert uneven["E_u"] < 1e-6
    assert uneven["not_solved"] == uneven["left_branch"] == 0
    assert evaluate_hyperelastic(solid, frames)["E_u"] > 0.003


def few(frames):
    """Three nodes inside and all else given: an answer a third off, with a band of no width."""
    inside = np.zeros_like(frames.interior)
    inside[np.flatnonzero(frames.interior)[[11, 12, 13]]] = True
    return Samples(replace(frames.points, interior=inside), frames.u)


def wrong_frames(f):
    """Frames that say nothing, and why."""
    affine = [0.1 * f.x, f.x @ [[0.2, 0.1], [0.0, 0.3]]]
    at_rest = [f.u[0], 0 * f.u[0]]
    made = {
        "a homogeneous body of any material": Samples(f.points, np.stack(affine)),
        "with loads use fit_energy": Samples(f.points, f.u, np.ones_like(f.u)),
        "frame 1 is at rest": Samples(f.points, np.stack(at_rest)),
        r"expected strains of 2 % or more in one, got 1\.\d": Samples(f.points, 0.05 * f.u),
        "60 measured components inside for 6 numbers, got 18": few(f),
    }
    return made.items()


def test_what_says_nothing_is_refused(frames):
    for words, wrong in wrong_frames(frames):
        with pytest.raises(InputError, match=words):
            fit_displacement(wrong, sheet())
    both = Samples(frames.points, np.stack([0.05 * frames.u[0], frames.u[0]]))
    assert len(fit_displacement(both, sheet(), most_steps=1).errors) == 2
    unsafe = Hyperelastic(3.0, ("square",), (), (EnergyTerm("area"),))
    with pytest.raises(InputError, match="convex and stress-free"):
        fit_displacement(frames, unsafe)
    for stiffness in (-1.0, np.nan, (0.1, 0.05), (1.0, 2.0, 3.0), "soft", np.inf):
        with pytest.raises(InputError, match="stiffness: expected"):
            fit_displacement(frames, sheet(), stiffness=stiffness)
    with pytest.raises(InputError, match="start: expected 6 coefficients"):
        fit_displacement(frames, sheet(), start=np.ones(2))
    solid = HyperelasticMaterial(sheet(), TRUTH, frames.spacing)
    with pytest.raises(InputError, match="frames: expected one or more"):
        fit_thickness(Samples(frames.points, frames.u[:0]), solid)


@pytest.mark.parametrize("axis", [0, 1])
def test_sections_go_from_edge_to_edge(axis):
    """Of an affine field they carry its stress, edges included; a hole takes lines away."""
    x, side = 0.1 * np.argwhere(np.ones((19, 14))), 0.1
    C, shape = 0.4, np.array([[1.2, 0.1], [-0.05, 1.1]])
    terms = (EnergyTerm("plane_stress"),)
    P = 2 * C * (shape - np.linalg.inv(shape).T / np.linalg.det(shape) ** 2)

    def sections(kept):
        points = Points(x[kept], np.arange(kept.sum()) == 0, side)
        field = Samples(points, (x[kept] @ (shape - np.eye(2)).T)[None])
        return Sections(field, Hyperelastic(terms=terms), axis)

    whole = sections(np.ones(len(x), bool))
    lines = np.full((19, 14)[axis] - 12, P[axis, axis])
    np.testing.assert_allclose(whole.stress(0, terms, np.array([C]), None), lines, rtol=1e-9)
    thick = replace(ThicknessField.over(x, 1), numbers=np.array([0.3, -0.2]))
    uneven = whole.stress(0, terms, np.array([C]), thick)
    assert uneven.mean() == pytest.approx(P[axis, axis], rel=0.01)
    assert np.ptp(uneven) > 0.02 * P[axis, axis]
    with pytest.raises(InputError, match=f"across {'xy'[axis]} from edge to edge"):
        sections((np.abs(x - x.mean(axis=0)) > 0.6 * side).any(axis=1))


def test_forces_set_the_scale_and_their_scatter_is_told(frames):
    """One of the last frame, or of all, with an error of one of them."""
    sections = Sections(frames, sheet(), 1)
    pulls = [sections.stress(n, sheet().terms, TRUTH, None).mean() for n in range(len(frames))]
    for known, error in ((slice(2, None), 0.0), (slice(None), 0.03)):
        pull = np.full((len(frames), 2), np.nan)
        pull[known, 1] = np.array(pulls)[known]
        pull[1, 1] *= 1 + error
        measured = replace(frames, arrays={PULL: pull})
        fit = fit_displacement(measured, sheet(), **TIGHT)
        np.testing.assert_allclose(fit.material.coefficients, TRUTH, rtol=1e-3 + error, atol=1e-5)
        scales = [other.scale for other in fit.others]
        assert np.ptp(scales) < 1e-3 if error == 0 else np.ptp(scales) > 0.2 * error
        assert "stresses" not in fit.material.provenance
    with pytest.raises(InputError, match="pull with the sign of the sheet's stress"):
        fit_displacement(replace(measured, arrays={PULL: -pull}), sheet(), **TIGHT)


def test_families_come_from_a_rose():
    dictionary = Hyperelastic(
        3.0, (), NEAREST, (EnergyTerm("neo_hookean"), *fibre_fan(8, (2.0, 4.0)))
    )
    c = np.zeros(len(dictionary))
    c[dictionary.first_term] = 0.07
    for n, value in ((3, 0.2), (4, 0.1), (6, 0.3)):
        c[dictionary.first_term + 1 + 2 * n] = value
    solid = HyperelasticMaterial(dictionary, c, 0.1, stretch=1.3)
    apart, start = fibre_families(solid)
    assert [round(np.rad2deg(t.angle), 1) for t in apart.terms[1:]] == [67.5, 90.0, 135.0]
    together, _ = fibre_families(solid, within=0.4)
    assert [round(np.rad2deg(t.angle), 1) for t in together.terms[1:]] == [75.0, 135.0]
    assert start[dictionary.first_term] == 0.07
    assert grouped({0.05: 1.0, 3.1: 1.0}, 0.2)[0][0] == pytest.approx(0.0042, abs=1e-3)
    cornered = with_corners(hgo_dictionary())
    np.testing.assert_array_equal(cornered.stiffness[7:], cornered.stiffness[4:7])
    assert with_corners(cornered) == cornered


X = np.random.default_rng(0).uniform(-1, 3, (50, 2))


def test_the_thickness_is_the_exponential_of_a_polynomial():
    even = ThicknessField.over(X, 2)
    assert even.names == ["x", "y", "x^2", "x y", "y^2"]
    np.testing.assert_array_equal(even.at(X), 1.0)
    uneven = replace(even, numbers=np.array([0.1, -0.2, 0.3, 0.4, -0.5]))
    p, q = ((X - uneven.centre) / uneven.half).T
    assert max(abs(p).max(), abs(q).max()) == pytest.approx(1.0)
    expected = 0.1 * p - 0.2 * q + 0.3 * p**2 + 0.4 * p * q - 0.5 * q**2
    np.testing.assert_allclose(np.log(uneven.at(X)), expected, atol=1e-14)
    for n, slope in enumerate(uneven.slopes(X).T):
        step = 1e-5 * np.eye(5)[n]
        ends = [replace(uneven, numbers=uneven.numbers + s * step).at(X) for s in (1, -1)]
        np.testing.assert_allclose(slope, (ends[0] - ends[1]) / 2e-5, atol=1e-8)
    steep = ThicknessField(1, np.zeros(2), np.ones(2), np.array([100.0, 0.0]))
    assert steep.at(np.array([[1.0, 0.5]])) == pytest.approx(np.exp([20.0]))
    assert not steep.slopes(np.array([[1.0, 0.5]])).any()


def test_what_is_no_thickness_is_refused():
    for degree in (7, 0, 2.0, True, "2"):
        with pytest.raises(InputError, match="degree: expected (1 to 6|a whole number), got "):
            ThicknessField.over(X, degree)
    with pytest.raises(InputError, match=r"numbers: expected shape \[5\], got \[4\]"):
        replace(ThicknessField.over(X, 2), numbers=np.ones(4))
    with pytest.raises(InputError, match="half: expected two lengths > 0"):
        ThicknessField.over(X[:1], 2)
