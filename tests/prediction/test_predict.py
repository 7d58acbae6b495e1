"""An answer with its error, held to errors that were planted."""

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy import array, cos, eye, ones, pi, sqrt, zeros
from numpy.linalg import norm

import warp_peri as wp
from examples.exact import relative_error
from tests.crystal.crystals import lattice as plain_lattice
from tests.crystal.crystals import learned
from tests.crystal.test_crystal import body
from tests.support import approx, filterwarnings, near, parametrize, shared, sup
from tests.support.nonlinear import solid
from tests.support.problems import OTHER, kernel, lattice, manufactured, noise, on_interior, smooth
from tests.support.solving import solve
from tests.support.told import assert_refused, refused, warned
from warp_peri.cli.main import main
from warp_peri.points.dataset import in_units
from warp_peri.points.families import largest_strain
from warp_peri.points.points import _said
from warp_peri.prediction import CalibrationFactors, Ensemble, EnsembleMaterial, EnsembleOperator
from warp_peri.prediction.ensemble import BEYOND, ErrorSpectrum, pulled, quadratic, spectrum_of

pytestmark = filterwarnings("ignore:(strain|transferred):UserWarning")
HORIZON, APART = 3.0, 0.02


def scaled(model, share):
    """The same law, stiffer by a share: its answers to loads are smaller by as much."""
    tensors = model.linear.tensors * (1 + share)
    linear = replace(model.linear, tensors=tensors, certificate=None).certified()
    cubic = {name: getattr(model, name) * (1 + share) for name in ("t3", "tq2", "q3")}
    return replace(model, linear=linear, **cubic).certified()


@shared
def family():
    """A rich member, a second 1 % stiffer, and halves 2 % to either side."""
    rich = solid("filtered")
    second, *halves = (scaled(rich, share) for share in (0.01, APART, -APART))
    record = ErrorSpectrum(array([2.0, 4.0, 8.0]), array([0.3, 0.1, 0.0]))
    return EnsembleMaterial(rich, second, tuple(halves), record, CalibrationFactors(1.2, 1.48, 2.0))


def held_at(rich, points, u):
    """The problem whose load holds the rich member at u, with none on the collar."""
    placed = rich.on(points)
    return wp.Dirichlet(points, placed.on_all(placed(u)), u)


def problem(family, size=0.01):
    """Nodes, a field, and the problem that it solves."""
    points = lattice(9, HORIZON)
    u = size * smooth(points.x, 1, wave_number=0.3)[0]
    return points, u, held_at(family, points, u)


def as_samples(problem):
    return wp.Samples(problem.points, problem.u[None], problem.b[None])


def along_x(points):
    """A load along x, and a collar that is held."""
    b = 0 * points.x + 1e-4 * eye(points.dimension)[0]
    return wp.Dirichlet(points, b, 0 * b)


def far(u, truth, points):
    inside = points.interior
    return relative_error(u[inside], truth[inside])


def test_corrections_lead_to_the_rich_answer_and_say_how_far_it_and_quantities_are(family):
    points, u, given = problem(family)
    rough = wp.predict(family, given, 0.5)
    best, inside = wp.predict(family, given, None), points.interior
    assert rough.corrections == 0 < best.corrections
    assert far(best.u, u, points) < 0.1 * far(rough.u, u, points)
    assert far(rough.corrected - rough.u, u - rough.u, points) < 0.25
    assert set(best.parts) == {"left", "waves", "data", "strain"}
    assert best.error == approx(norm([*best.parts.values()]))
    assert best.map()[inside].min() > 0
    assert not best.map()[~inside].any()
    root = norm(best.map()[inside]) / norm(best.u[inside])
    assert root >= 0.99 * norm([value for name, value in best.parts.items() if name != "waves"])
    at = [(4.0, 4.0), (2.0, 5.0)]
    assert wp.prediction.strain(points, zeros((0, 2)))(u).shape == (0, 2, 2)
    for quantity in (
        wp.prediction.strain(points, at),
        wp.prediction.stress(rough.operator, at),
        lambda u: u[points.interior].mean(0),
        lambda u: np.multiply(u, 3.0, out=u)[inside],
    ):
        found = rough.of(quantity)
        wrong = quantity(u) - found.value
        assert sup(wrong - found.correction) < 0.3 * sup(wrong)
        assert (found.bar >= 0.99 * np.abs(found.correction)).all()


def test_a_part_is_as_large_as_what_was_planted(family):
    """Without a collar that moves, a law stiffer by a share answers with less by that share."""
    family, posed = replace(family, record=None), along_x(lattice(9, HORIZON))
    answer = wp.predict(family, posed, None)
    floor = family.factors.floor / sqrt(2)
    near(answer.parts["data"], floor * sqrt(2) * APART, 0.1)
    near(answer.parts["waves"], floor * 0.01, 0.1)
    tight, loose = (wp.predict(family, posed, tolerance) for tolerance in (0.01, 0.04))
    assert not tight.kept
    assert "1 % is not kept" in tight.why
    assert loose.kept
    assert "most of it data" in loose.why


@parametrize("steady", [True, False])
def test_strain_counts_what_its_orders_go_on_to(family, steady):
    """The nonlinear part times c|H|, or times what corrections shrink by if that is more."""
    screen = 2.0 if steady else 0.02
    family = replace(family, factors=replace(family.factors, screen=screen))
    points, u, given = problem(family, 0.05)
    best, placed = wp.predict(family, given, None), family.ensemble_on(points)
    inside, load = points.interior, placed.rich.rhs(given.b)
    found = on_interior(points, 0, u)
    found[inside] = placed.inverse(load - placed.straight(found), 1e-6)
    bent = far(found, u, points)
    first = placed.correction(load, found)
    found[inside] += first
    slowed = norm(placed.correction(load, found)) / norm(first)
    ratio = BEYOND * screen * placed.gradient(u)
    assert (ratio > slowed) == steady
    expected = family.factors.floor * max(ratio, slowed) * bent
    assert best.corrections > 1
    near(best.parts["strain"], expected, 0.15)
    # members that were asked before a second correction was known are not asked again
    early = wp.predict(replace(family, record=None), given, 0.015)
    assert early.corrections == 1
    near(early.parts["strain"], expected, 0.15)


def test_the_guarantee_holds_planted_errors(family):
    points, u, given = problem(family, 0.001)
    inside = points.interior
    wrong = on_interior(points, 0.02 * sup(u) * noise(points))
    proof = replace(wp.predict(family, given, None), u=u + wrong).guarantee
    true = sqrt((wrong[inside] * EnsembleOperator(family, points).straight(wrong)).sum())
    assert true <= proof.energy <= true * 1.2 / (1 - proof.contraction)
    assert 0 < proof.contraction < 1
    assert far(u + wrong, u, points) <= proof.displacement
    assert repr(proof).startswith("ErrorBound\n  proven")
    beyond = problem(family, 0.05)[2]  # the proven strain
    assert wp.predict(family, beyond, None).guarantee is None


def test_a_linear_family_is_bounded_without_a_contraction(lps):
    points = lattice(6, HORIZON)
    answer = wp.predict(lps, along_x(points), 0.1)
    wrong = on_interior(points, 1e-4 * noise(points))
    proof = replace(answer, u=answer.u + wrong).guarantee
    assert proof.contraction == 0
    true = sqrt((wrong[points.interior] * lps.on(points)(wrong)).sum())
    assert true <= proof.energy <= 1.001 * true


def test_what_is_not_known_is_named(family):
    points, u, given = problem(family)
    _said.clear()
    with warned("axis"):
        answer = wp.predict(family, wp.Dirichlet(replace(points, axis=None), given.b, u), 0.01)
    assert any("axis" in one for one in answer.uncovered)
    assert answer.parts["axis"] > 0
    assert "not covered: axis" in answer.why
    assert wp.predict(family, given, 0.01).uncovered == ()
    warm = replace(as_samples(given), arrays={"temperature": array([300.0])})
    (answer,) = wp.predict(replace(family, temperature=0.0), wp.Dirichlet(warm, warm.b, warm.u))
    assert not answer.kept
    assert "temperature" in answer.why


def test_a_family_is_one_file_in_any_units_and_has_a_command(family, tmp_path, capsys):
    *_, given = problem(family)
    path = tmp_path / "family.json"
    wp.save(path, family)
    samples = as_samples(given)
    moved = in_units(samples, OTHER)
    (there,) = wp.predict(wp.load(path, units=OTHER), wp.Dirichlet(moved, moved.b, moved.u), 0.01)
    near(there.error, wp.predict(family, given, 0.01).error, 1e-4)
    wp.save(tmp_path / "data.h5", wp.Dataset({"set": samples}, 3.35, 2200.0))
    files = [str(tmp_path / name) for name in ("family.json", "data.h5")]
    assert main(["predict", *files, "--set", "set", "--tolerance", "0.05", "--json"]) == 0
    (sample,) = json.loads(capsys.readouterr().out)["samples"]
    assert sample["kept"]
    assert 0 < sample["true"] < sample["error"] < 0.05
    assert "data" in sample["parts"]


def test_wrong_input_is_refused(family):
    points, _, given = problem(family)
    one = as_samples(given)
    warm = replace(one[[0] * 4], arrays={"temperature": 4 * ["300 K"]})
    assert_refused({
        "problem, .* got Cracked": lambda: wp.predict(
            family, wp.Cracked(points, b=given.b, u=given.u, cracks=[[[0.0, 0.0], [1.0, 0.3]]])
        ),
        "nodes on a collar": lambda: wp.predict(
            family, wp.Dirichlet(wp.Points.sheet((9, 9), 1.0), *zeros((2, 81, 2)))
        ),
        "wavelengths > 0 that grow": lambda: ErrorSpectrum(array([2.0, 1.0]), ones(2)),
        "an error ≥ 0 of each": lambda: ErrorSpectrum(array([1.0, 2.0]), ones(1)),
        "units and dim": lambda: replace(family, second=family.second.in_units(("nm", "TPa"))),
        "moduli_error: expected": lambda: replace(
            family, rich=replace(family.linear, provenance={"moduli_error": "x"})
        ).moduli_error,
        "at least four samples": lambda: wp.fit(one, Ensemble(wp.LPS(3.0))),
        "temperature: expected float": lambda: wp.fit(warm, Ensemble(wp.LPS(3.0))),
        "temperature: expected values ≥ 0 K, got -5": lambda: wp.fit(
            replace(warm, arrays={"temperature": 4 * [-5.0]}), Ensemble(wp.LPS(3.0))
        ),
        "wavelength: expected float": lambda: ErrorSpectrum(np.array([1j]), np.ones(1)),
        "temperature: expected a number ≥ 0": lambda: replace(family, temperature=-5.0),
        r"at: expected shape \[m, 2\]": lambda: wp.prediction.strain(points, [1.0, 2.0]),
        "stress: expected positions whose": lambda: wp.prediction.stress(
            family.ensemble_on(points), [(500, 500)]
        ),
        "quantity: expected": lambda: wp.predict(family, given).of(lambda u: None),
    })  # fmt: skip


def test_what_no_member_bears_is_refused_before_any_is_learned(family, monkeypatch):
    monkeypatch.setattr(wp.LPS, "learn", lambda *_, **__: 1 / 0)
    law, four = wp.LPS(HORIZON), as_samples(problem(family)[2])[[0] * 4]
    wide = replace(four.points, interior=norm(four.x, axis=1) < 9)
    fine = lambda of: replace(four, points=replace(of, x=of.x / 2, spacing=0.5))
    one = replace(four, b=four.b * np.eye(4)[0, :, None, None])
    third = wp.ThirdOrder(wp.Crystal(3.0), wp.methods.Smoothing(3.0))
    fit = lambda val, *of, one=four: lambda: wp.fit(one, Ensemble(law, *of), validation=val)
    assert_refused({
        "validation: .* displaced inside": (fit(four[:0]), fit(replace(four, u=0 * four.u))),
        "units: expected": fit(in_units(four, OTHER)),
        "b: expected loads": fit(replace(four, b=None)),
        "validation: interior nodes need": fit(replace(four, points=wide)),
        "validation: horizon: a lattice of spacing 0.5": fit(fine(wide)),
        "validation: spacing: the model is for 1, these": fit(fine(four.points), wp.Crystal(3.0)),
        "loads on each half": fit(None, one=one),
        "samples: b: expected loads, got none on sample 1": fit(None, third, one=one),
    })  # fmt: skip
    warm = replace(four, arrays={"temperature": [0.0, 600.0] * 2})
    with warned("300 K alone, samples are at 0 to 600"), pytest.raises(ZeroDivisionError):
        fit(None, one=warm)()


def test_a_family_is_learned_and_calibrated_by_one_call(tmp_path):
    points = lattice(8, HORIZON)
    samples = manufactured(kernel("positive", HORIZON), points, 8, wave_number=1.0)
    law = wp.Crystal(HORIZON, "4mm", moduli=None)  # eight nodes hold no long waves
    samples.u[0] = samples.b[0] = 0
    fit = wp.fit(samples, Ensemble(law), progress=False)
    assert fit.certificate.holds
    assert fit.material.second.horizon < fit.material.horizon
    assert 0 < fit.material.strain < 10
    wp.save(tmp_path / "family.json", fit.material)
    family = wp.load(tmp_path / "family.json")
    held = manufactured(kernel("positive", HORIZON), points, 4, seed=9, wave_number=0.5)
    answers = wp.predict(family, wp.Dirichlet(held, held.b, held.u), None)
    ratios = [answer.error / far(answer.u, u, points) for answer, u in zip(answers, held.u)]
    assert 0.5 < np.median(ratios) < 3
    assert answers[0].guarantee.contraction == 0


def test_shares_find_the_wavelength_and_members_are_pulled_half_way_to_their_record():
    points = lattice(40, 0.5)
    knots = array([4.0, 8.0, 16.0])
    u = np.stack([cos(2 * pi * points.x[:, 0] / 8), zeros(len(points.x))], axis=1)
    found = spectrum_of(points, knots)(u)
    assert found.argmax() == 1
    assert found.sum() == approx(1, abs=0.02)
    assert ErrorSpectrum(knots, array([0.0, 0.1, 0.0])).of(found) == approx(0.1, rel=0.15)
    assert spectrum_of(points, knots)(1e-3 * points.x).sum() < 1e-9
    assert pulled(0.01, 0.02) == approx(sqrt(2))
    assert pulled(0.01, 0.0025) == approx(0.5)
    assert pulled(0.01, 1.0) == 2
    assert pulled(0.01, None) == pulled(0.0, 1.0) == 1


def held_in(rich, level, count, seed=0):
    """Samples in equilibrium with a nonlinear member, their largest strain as told."""
    points = lattice(14, HORIZON)
    u = smooth(points.x, count, seed, 0.5)
    u = array([level / largest_strain(points, one) * one for one in u])
    return wp.Samples(points, u, held_at(rich, points, u).b)


@shared
def linear_family():
    """Learned from a nonlinear solid strained by 2 %."""
    samples = held_in(solid("filtered"), 0.02, 12)
    return wp.fit(samples, Ensemble(wp.Crystal(3.0, "4mm")), progress=False).material


def test_a_linear_family_tells_what_is_not_linear(family, linear_family):
    """The member itself takes up some of it, and the half that saw a sample too."""
    learned = linear_family
    seen = held_in(family.rich, 0.04, 2, seed=5)
    answers = wp.predict(learned, wp.Dirichlet(seen.points, seen.b, seen.u), None)
    true, placed = family.rich.on(seen.points), learned.ensemble_on(seen.points)
    for answer, truth in zip(answers, seen.u):
        assert any("of the data of a linear law" in one for one in answer.uncovered)
        assert not answer.error < far(answer.u, truth, seen.points) / 1.2  # or unknown
        even = placed.inverse((true(truth) + true(-truth)) / 2, 1e-4)  # what no linear law holds
        assert 0.8 < answer.parts["strain"] / (norm(even) / norm(truth[seen.interior])) < 2
        told = placed.bent(answer.u)
        assert np.vdot(told, even) > 0.7 * norm(told) * norm(even)
    u = 0.1 * cos(seen.x @ np.arange(10).reshape(2, 5) / 30).T[..., None] * noise(seen, 5)[:, :1]
    rounded = [replace(seen, u=u.astype(kind), b=0 * u) for kind in ("f8", "f4")]  # det ∇u = 0
    near(*(array(quadratic(learned, one)) for one in rounded), 1e-3)
    unknown = replace(learned, quadratic=())  # an older file
    answer = wp.predict(unknown, wp.Dirichlet(seen.points, seen.b[0], seen.u[0]), None)
    assert any("nothing in the ensemble tells" in one for one in answer.uncovered)
    assert np.isnan(answer.error)
    assert not answer.kept
    assert "unknown, most of it strain" in answer.why


def test_even_orders_of_a_body_pulled_on_all_sides_are_told_by_waves(linear_family):
    """What pulls on all sides misses more than the waves that a linear law was learned from."""
    rich, learned = solid("filtered"), linear_family
    points = lattice(14, HORIZON)
    middle = points.x - points.x.mean(0)
    for size in (0.005, -0.01):
        u = size * middle * np.exp(-((middle / 5) ** 2).sum(axis=1, keepdims=True))
        posed = held_at(rich, points, u)
        for tolerance in (0.01, None):
            answer = wp.predict(learned, posed, tolerance)
            true = far(answer.u, u, points)
            assert answer.error > true
            assert not (answer.kept and tolerance and true > tolerance)


def test_without_a_tolerance_the_answer_is_as_near_as_any(family):
    """Not by its bar alone: to the answer of the rich member, up to what the bar cannot tell."""
    points, u, given = problem(family, 0.06)
    best = wp.predict(family, given, None)
    off = [far(wp.predict(family, given, t).u, u, points) for t in (0.05, 0.01, 0.005)]
    assert far(best.u, u, points) < min(off) + 1e-4 * best.error


def test_standard_errors_of_moduli_belong_to_the_data():
    """A load of a crystal whose moduli are softer by the error is answered with more by as much."""
    share = 0.03
    crystal = replace(learned(2), provenance={"moduli_error": share})
    points = plain_lattice(2, 9, 6)
    b = 1e-3 * smooth(points.x / points.spacing, 1, wave_number=0.3)[0]
    posed = wp.Dirichlet(points, b, 0 * b)
    answer = wp.predict(crystal, posed, None)
    planted = far(solve(crystal, points, b / (1 - share), 0 * b), answer.u, points)
    near(answer.parts["data"], share, 1e-6)
    near(planted, share, 0.1)
    quantity = answer.of(lambda u: u[points.interior].sum(0))
    assert quantity.bar == approx(share * np.abs(quantity.value), rel=0.1)
    assert not wp.predict(crystal, posed, 0.05).kept
    assert any("moduli" in one for one in answer.uncovered)
    with refused("one model knows nothing of its error"):
        wp.predict(replace(crystal, provenance={}), posed, None)


def test_a_family_has_the_standard_error_of_its_crystal_beside_its_own_data(family):
    posed = along_x(lattice(9, HORIZON))
    sure = wp.predict(replace(family, record=None), posed, None)
    linear = replace(family.rich.linear, provenance={"moduli_error": 0.05})
    unsure = replace(family, record=None, rich=replace(family.rich, linear=linear))
    told = wp.predict(unsure, posed, None).parts
    near(told["data"], np.hypot(sure.parts["data"], 0.05), 1e-3)
    assert told["waves"] == approx(sure.parts["waves"], rel=1e-3)  # a looser solve


def of_linear(rich, *numbers):
    """A second member 1 % stiffer than the rich one, and halves 2 % to either side."""
    second, *halves = (
        replace(rich, **{name: getattr(rich, name) * f for name in numbers})
        for f in (1.01, 1.02, 0.98)
    )
    return EnsembleMaterial(rich, second, tuple(halves), factors=CalibrationFactors(1.0, 1.0, 0.0))


@shared
def lps():
    """Of a certified linear solid."""
    rich = kernel("positive", HORIZON)
    rich = replace(rich, certificate={"1": wp.certify(rich, spacing=1.0).figures()})
    return of_linear(rich, "lam", "mu")


@parametrize("turned", [True, False])
def test_turned_lattices_and_crystals_in_space(lps, turned):
    """Half of the doubts' squares: waves 1 %, data 2 % times √2."""
    points = lattice(9, HORIZON, angle=0.3) if turned else body(3, "cube")
    answer = wp.predict(lps if turned else of_linear(learned(3), "tensors"), along_x(points), None)
    assert answer.uncovered == ()
    near(answer.error, sqrt((0.01**2 + 2 * APART**2) / 2), 0.15)
    assert answer.corrected.shape == points.x.shape
    assert answer.map()[points.interior].min() >= 0


def test_what_data_hold_nothing_of_is_named():
    model, points = kernel("positive", HORIZON), lattice(10, HORIZON)
    long, short = (manufactured(model, points, 4, wave_number=k) for k in (0.25, 2.0))
    family = wp.fit(long, Ensemble(wp.LPS(HORIZON, wp.Bernstein(1))), progress=False).material
    answer = wp.predict(family, wp.Dirichlet(short, short.b[0], short.u[0]), None)
    assert any(one.startswith("short waves") for one in answer.uncovered)
    assert np.isnan(answer.error)
    assert np.isnan(answer.map()[short.interior]).all()
    assert not answer.kept


def test_designed_loads_hold_all_waves_without_a_mean():
    loads = wp.prediction.design_loads(wp.Points.sheet((20, 20), 5.0), shortest_wave=20.0)
    assert loads.shape == (2, 400, 2)
    assert norm(loads, axis=-1).max() == approx(1)
    power = np.abs(np.fft.fft2(loads[0].reshape(20, 20, 2), axes=(0, 1))).sum(-1)
    k = np.hypot(*np.meshgrid(*2 * [np.fft.fftfreq(20)]))
    assert np.array_equal(power > 1e-9 * power.max(), (k > 0) & (k <= 0.25 + 1e-9))
    with refused("box"):
        wp.prediction.design_loads(lattice(4, 1.0), 3.0)
