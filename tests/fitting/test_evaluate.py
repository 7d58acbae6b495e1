"""Errors of a model on data, against their definitions; bands of the bootstrap on known truth."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
from numpy.random import default_rng

from tests.support import approx, near, norms, parametrize, reference, refused, shared, warned
from tests.support.problems import kernel, lattice, manufactured, noise, periodic
from tests.support.solving import solve
from warp_peri import LPS, Bernstein, Samples, evaluate
from warp_peri.core.stencil import Stencil
from warp_peri.fitting.evaluate import residuals
from warp_peri.materials.lps_fit import displacement_error
from warp_peri.methods import BootstrapResult, bootstrap

HORIZON = 3.0
MODEL = kernel("sign-changing", HORIZON)
OTHER = kernel("positive", HORIZON)
NOISE, LOADS = 0.3, 10
POINTS = lattice(5, 2.0)
quantities = lambda c: np.array([c, 1 / c, c**2])
"""What is linear in the stiffness, and what is not."""


@shared
def points():
    """Three samples in equilibrium with another model."""
    return manufactured(OTHER, lattice(3, HORIZON), 3)


def test_numbers_are_their_definitions(points):
    table, inside = evaluate(MODEL, points), points.interior
    force = np.array([reference.operator(points.x, inside, MODEL, u) for u in points.u])
    off = (solve(MODEL, points, points.b, points.u) - points.u)[:, inside]
    u, b = points.u[:, inside], points.b[:, inside]
    residual, load, wrong, size = norms(force - b, b, off, u)
    expected = {"E_res": residual / load, "E_res_abs": residual, "E_u": wrong / size}
    for key, values in expected.items():
        assert table[f"{key}_samples"] == approx(values, rel=1e-9), key
        assert table[key] == approx(values.mean(), rel=1e-9), key
    assert table["E_res"] > 0.01


def test_a_fit_judges_stencils_by_the_same_error_on_bodies_and_on_periods(points):
    found = displacement_error(MODEL.stencil(1.0), points, least=6)
    near(found, evaluate(MODEL, points)["E_u"], 1e-6)
    assert displacement_error(Stencil(1.0, 9 * np.eye(2, dtype=int), np.eye(2)), points) == np.inf
    sheet = periodic((14, 14))[0]
    b = noise(sheet, 3)
    b -= b.mean(axis=1, keepdims=True)
    solved, true = (one.on(sheet).solve_periodic(b).u for one in (MODEL, OTHER))
    wrong, size = norms(solved - true, true)
    moved = Samples(sheet, true + 0.3, b)  # by a translation, which is nobody's answer
    found = displacement_error(MODEL.stencil(1.0), moved, least=6)
    near(found, (wrong / size).mean(), 1e-6)
    own = evaluate(OTHER, moved)
    assert max(own["E_u"], own["E_shape"]) < 1e-9


def test_samples_at_rest_have_no_relative_error(points):
    with refused("the set has no samples"):
        evaluate(MODEL, points[:0])
    first, _, last = evaluate(MODEL, points)["E_u_samples"]
    errors = evaluate(MODEL, replace(points, u=points.u * [[[1]], [[0]], [[1]]]))
    assert errors["E_u_samples"] == [approx(first), None, approx(last)]
    assert errors["E_u"] == approx((first + last) / 2)


@parametrize("level", [0.0, 1e-16])
def test_without_load_there_is_no_residual_to_be_relative_to(points, level):
    """Displacement is solved for as ever: only the sample's E_res is left out."""
    b = points.b.copy()
    b[1, points.interior] = level
    some, every = evaluate(MODEL, replace(points, b=b)), evaluate(MODEL, points)
    first, _, last = every["E_res_samples"]
    assert some["E_res_samples"] == [approx(first), None, approx(last)]
    assert some["E_res"] == approx((first + last) / 2)
    assert some["E_u_samples"][0] == approx(every["E_u_samples"][0])
    none = evaluate(MODEL, replace(points, b=np.full_like(b, level)))
    assert none["E_res"] is None
    assert min(none["E_res_abs"], none["E_u"]) > 0


def test_the_error_of_shape_does_not_see_rigid_motion(points):
    plain = evaluate(MODEL, points)
    turn = 0.5 * np.stack([-points.x[:, 1], points.x[:, 0]], axis=1)
    moved = evaluate(MODEL, replace(points, u=points.u + 100.0 + turn))
    assert moved["E_u"] < 0.1 * plain["E_u"]
    near(moved["E_shape"], plain["E_shape"], 1e-6)
    assert plain["E_shape"] > plain["E_u"]


@parametrize("use", [partial(evaluate, MODEL), LPS(HORIZON, Bernstein(1)).learn])
def test_displacements_that_were_filled_in_are_told_where_they_count(points, use):
    seen = np.ones(points.u.shape[:2], bool)
    use(replace(points, arrays={"seen": seen}))
    with refused("^seen: expected bool values"):
        use(replace(points, arrays={"seen": 1 * seen}))
    seen[0, 0] = False
    with warned("^seen: displacements of nodes that were not seen"):
        use(replace(points, arrays={"seen": seen}))


class Springs:
    """b = c u at every node: one stiffness, by least squares over the loads."""

    def learn(self, samples, **options):
        return SimpleNamespace(material=float((samples.u * samples.b).sum() / (samples.u**2).sum()))


def noisy(seed):
    """Loads of springs of stiffness 1; each load's own noise on its forces, of any size."""
    rng = default_rng(seed)
    u = rng.normal(size=(LOADS, *POINTS.x.shape))
    size = NOISE * rng.uniform(0.5, 1.5, (LOADS, 1, 1))
    return Samples(POINTS, u, u + size * rng.normal(size=u.shape))


def test_a_band_leaves_half_of_the_rest_on_each_side():
    """Of draws 0, 1 and 2, by a table of Student's distribution: 2.132 for 4 at 95 %."""
    low, high = BootstrapResult([0.0, 1.0, 2.0], loads=5, knows="").band(1.0, float)
    near((high - low) / 2, 2.132 * 0.6826 * np.sqrt(5 / 4), 1e-4)
    assert (high + low) / 2 == approx(1)


def test_bands_of_90_percent_hold_the_truth_of_so_many_sets():
    inside = []
    for seed in range(100):
        samples = noisy(seed)
        best = Springs().learn(samples).material
        low, high = bootstrap(samples, Springs()).band(best, quantities)
        inside.append((low <= 1) & (high >= 1))
    assert 0.85 <= np.mean(inside) <= 0.97


def test_as_many_choices_as_asked_among_four_exact_loads_or_more_give_one_solid():
    samples = manufactured(kernel("1/r", 2.0), lattice(5, 2.0), 6)
    found = bootstrap(samples, LPS(2.0), draws=10)
    assert found.deviation(lambda solid: [solid.lam, solid.mu]).max() < 1e-6
    assert len(found.materials) == 10
    assert "not an error that all loads share" in found.knows
    with refused("at least 4 loads, got 3"):
        bootstrap(samples[:3], Springs())
    with refused("bootstrap: expected options among noise, progress, got foo"):
        bootstrap(samples, LPS(2.0), foo=1)


def test_a_sample_without_a_force_is_named():
    with warned("force on sample 1 is no number"):
        found = residuals(np.asarray, np.array([[[3.0]], [[np.nan]]]), np.ones((2, 1, 1)))
    assert found[0] == 2
