"""A hyperelastic sheet: forces are slopes of the energy, tangents slopes of forces; its numbers."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from numpy import array, cos, eye, nan, ones, sin, zeros
from numpy.linalg import norm
from numpy.random import default_rng
from scipy.ndimage import binary_dilation

import warp_peri as wp
from tests.support import approx, assert_refused, near, sup
from tests.support.problems import fitted_order, on_interior, slope
from tests.support.sheets import SPACING, everything, hgo_dictionary, sheet_on, square, waves
from warp_peri.hyperelastic import EnergyTerm, Hyperelastic, HyperelasticMaterial, ThicknessField
from warp_peri.materials.hyperelastic.model_selection import (
    febio_material,
    select_model,
    uniaxial_stress,
)
from warp_peri.points.points import Points, grid_places
from warp_peri.testing import check_energy, check_product

POINTS, HGO = square(4), hgo_dictionary()
FRAMES = wp.Samples(POINTS, np.stack([waves(POINTS, 0.3, seed) for seed in range(3)]))
LOADS = wp.Samples(POINTS, FRAMES.u, np.ones_like(FRAMES.u))
AFFINE = np.stack([0.1 * POINTS.x, POINTS.x @ [[0.2, 0.1], [0.0, 0.3]]])
ALL, FEW = ones(len(POINTS.x), bool), POINTS.interior.copy()
FEW[np.flatnonzero(FEW)[3:]] = False
BOND = (EnergyTerm("neo_hookean"), EnergyTerm("fibre_exponential", step=(1, 0)))


@pytest.fixture(scope="module", params=["even", "uneven"])
def problem(request):
    """A sheet of every energy, and rough fields."""
    points, random = square(2), default_rng(3)
    thickness = np.exp(0.5 * random.normal(size=len(points.x)))
    u = np.stack([waves(points, 0.3, seed) for seed in (0, 1)])
    u += 0.02 * SPACING * random.normal(size=u.shape)
    c = random.normal(size=len(everything()))
    op = sheet_on(points, everything(), c, None if request.param == "even" else thickness)
    return op, u, SPACING * random.normal(size=u.shape)


def test_force_tangent_and_single_forces_are_those_of_the_energy(problem):
    op, u, v = problem
    check_energy(op, u[0])
    check_product(op, u[0], step=3e-6, tolerance=1e-6)
    K, inside = op.interior_tangent(u[0]), on_interior(op.points, v[0])
    near(K @ v[0, op.interior].ravel(), op.jvp(u[0], inside).ravel(), 1e-11)
    assert abs(K - K.T).max() < 1e-11 * abs(K).max()
    near(op.features(u) @ op.model.coefficients, op.force(u), 1e-12)


def test_the_force_of_a_fibre_by_its_numbers_and_of_a_sheet_by_its_thickness(problem):
    op, u, v = problem
    dictionary = op.model.dictionary
    first = dictionary.first_term
    fibres = [number for number, term in enumerate(dictionary.terms) if term.is_fibre]
    every = op.features(u, [first + number for number in fibres])[..., len(dictionary) :]

    def force(number, by, shift):
        terms = [*dictionary.terms]
        terms[number] = replace(terms[number], **{by: getattr(terms[number], by) + shift})
        moved = replace(op.model, dictionary=dictionary.with_terms(terms))
        return op.changed(moved, op.thickness).force(u)

    for by, leave, numbers in zip(("angle", "exponent"), (None, 0.0), np.split(every, 2, axis=-1)):
        for number, found in zip(fibres, np.moveaxis(numbers, -1, 0)):
            if getattr(dictionary.terms[number], by) != leave:
                near(found, slope(partial(force, number, by), 1e-5, order=2), 1e-6)
    slopes = 10 * v[0]
    thickness = ones(len(slopes)) if op.thickness is None else op.thickness
    moved = lambda t: op.changed(op.model, thickness + t * slopes[:, 1]).force(u)
    found, expected = op.by_thickness(u, slopes)[..., 1], slope(moved, 1e-2, order=2)
    near(found, expected, 1e-11, sup(op.force(u)))


def test_a_uniform_strain_is_seen_along_fibres_too_and_has_no_force():
    op = sheet_on(square(2), everything())
    F = array([[1.25, 0.1], [-0.2, 0.9]])
    u, C = op.points.x @ (F - eye(2)).T, F.T @ F
    assert sup(op.force(u)) < 1e-9 / SPACING
    E = [(C[0, 0] - 1) / 2, (C[1, 1] - 1) / 2, C[0, 1]]
    assert sup(op.strain(u)[op.interior] - E) <= 1e-12
    stored = float(everything().uniform(torch.tensor(E)).sum())
    assert op.nodal_energy(u)[op.interior] == approx(stored, rel=1e-12)
    assert op.largest_stretch(u) == approx(norm(F, 2))
    one = sheet_on(op.points, Hyperelastic(3.0, terms=(EnergyTerm("fibre_power", -0.2, 2.0),)))
    stretched = np.sum((F @ [cos(0.2), -sin(0.2)]) ** 2) - 1
    assert one.nodal_energy(u)[op.interior] == approx(stretched**2 / 2, rel=1e-12, abs=0)


def test_the_force_converges_with_the_fourth_power_of_the_spacing():
    """To −div P of a smooth field under tension along the fibres."""
    c, spacings = [0.1] * 4 + [0.07, 0.08, 0.2], (0.1, 0.05, 0.025, 0.005)
    steps, forces = grid_places((13, 13)) - 6, []
    for h in spacings:
        points = Points(h * steps, (steps == 0).all(1), h)
        x = points.x
        u = x @ array([[0.1, 0.02], [0.03, 0.25]]).T
        u += 0.05 * sin(2 * x[:, ::-1] + 0.4) + 0.03 * cos(1.5 * x + 0.2)
        forces.append(sheet_on(points, c=c).force(u)[0])
    assert fitted_order(spacings[:3], norm(array(forces[:3]) - forces[3], axis=1)) > 3.5


def test_energies_of_bonds_and_corners_are_those_of_their_formulas():
    """The corners of cells are linear triangles."""
    points = square(3)
    u, inside = waves(points, 0.3), points.interior.reshape(15, 15)
    y = (points.x + u).reshape(15, 15, 2) / SPACING
    near_it = binary_dilation(inside, ones((3, 3)))
    ahead = lambda field, *step: np.roll(field, np.negative(step), (0, 1))
    mooney = lambda C, D, seen: (D + C / D - 3)[seen].sum()

    def at(p, q):
        a, b = (ahead(y, p, 0) - y) / p, (ahead(y, 0, q) - y) / q
        seen = inside | ahead(inside, p, 0) | ahead(inside, 0, q)
        return mooney((a**2 + b**2).sum(-1), np.linalg.det(np.stack([a, b], -1)) ** 2, seen)

    long = ((ahead(y, 1, -2) - y) ** 2).sum(-1) / 5
    bonds = mooney(long + 1, long, near_it | ahead(near_it, 1, -2))
    two, cells = (at(1, -2) + at(-1, 2)) / 2, sum(at(p, q) for p in (1, -1) for q in (1, -1)) / 4
    for corner, step, expected in (False, (1, -2), bonds), (True, (), cells), (True, (1, -2), two):
        term = EnergyTerm("mooney", corner=corner, step=step)
        found = sheet_on(points, Hyperelastic(3.0, terms=(term,))).energy(u)
        near(found, SPACING**2 * expected, 1e-12)


def test_every_coefficient_has_a_label_and_terms_without_one_can_go():
    labels = [energy.label for energy in everything().energies]
    assert len(set(labels)) == len(labels)
    assert (labels[0], labels[5]) == ("deviation (0, 1)", "neo_hookean")
    solid = HyperelasticMaterial(hgo_dictionary(), array([0, 0, 0, 0.1, 0.07, 0.0, 0.2]), 0.1)
    kinds = [term.kind for term in solid.sparse.dictionary.terms]
    assert kinds == ["neo_hookean", "fibre_exponential"]
    assert solid.sparse.coefficients.tolist() == [0, 0, 0, 0.1, 0.07, 0.2]


def solid(dictionary, count=None):
    return HyperelasticMaterial(dictionary, ones(count or len(dictionary)), 0.1)


def fit(samples=FRAMES, u=None, **options):
    samples = samples if u is None else wp.Samples(samples.points, u)
    return partial(wp.fit, samples, HGO, **options)


REFUSED = {
    "kind: expected one of": lambda: EnergyTerm("ogden"),
    "fibre_power: expected an exponent": lambda: EnergyTerm("fibre_power", 0.0, 1.0),
    "mooney: expected no angle or exponent":
        (lambda: EnergyTerm("mooney", 1.0), lambda: EnergyTerm("mooney", exponent=5.0)),
    "bonds of a half family": lambda: Hyperelastic(3.0, ((-1, 0),)),
    "steps: expected int values": lambda: Hyperelastic(3.0, (1.0, 2.0)),
    "steps: expected an array": lambda: Hyperelastic(terms=(replace(BOND[1], step=[[1], [1, 2]]),)),
    "stretch: expected a number > 0": lambda: replace(solid(HGO), stretch=0),
    "sides of a corner": lambda: EnergyTerm("mooney", corner=True, step=(1, 0)),
    "at least one energy": Hyperelastic,
    "coefficients: expected finite values, got nan":
        lambda: replace(solid(HGO), coefficients=np.full(7, nan)),
    r"coefficients: expected shape \[7\]": lambda: solid(HGO, 6),
    "coefficients: expected one other than 0":
        lambda: sheet_on(POINTS, HGO, zeros(7)).interior_tangent(0 * POINTS.x),
    "twice the horizon": lambda: sheet_on(Points(POINTS.x, ALL, 0.1)),
    "spacing|scattered": lambda: sheet_on(Points(POINTS.x, ALL, 0.0)),
    "axis: directions of a hyperelastic": lambda: sheet_on(replace(POINTS, axis=10.0)),
    "thickness: expected shape": lambda: sheet_on(POINTS, thickness=ones(3)),
    "thickness: expected finite numbers > 0": lambda: sheet_on(POINTS, thickness=0 * ALL),
    "seen: expected shape": fit(replace(FRAMES, arrays={"seen": 3 * [[True]]})),
    "whole number from 1 to 6": lambda: ThicknessField.over(POINTS.x, 7),
    "x: expected nodes": lambda: ThicknessField.over(POINTS.x[:0], 2),
    "count: expected 1 to 10 000": lambda: wp.hyperelastic.fibre_fan(10**15),
    r"numbers: expected shape \[5\]":
        lambda: replace(ThicknessField.over(POINTS.x, 2), numbers=ones(4)),
    "expected neo_hookean and volumetric": lambda: febio_material(solid(Hyperelastic(terms=BOND))),
    r"stretches: expected shape \[n\]": lambda: uniaxial_stress(solid(HGO), 1.1),
    "stretches: expected such": lambda: uniaxial_stress(solid(HGO), [0.1]),
    "a load on it, got none in number 0; without": fit(wp.Samples(POINTS, FRAMES.u, 0 * FRAMES.u)),
    "expected one or more, .* got no sample": fit(LOADS[:0]),
    "a displacement of it, got none in number 1": fit(u=FRAMES.u * [[[1]], [[0]], [[1]]]),
    "stiffness: expected a number ≥ 0": fit(LOADS, stiffness=-1.0),
    "options among positive, .*, got rigde": fit(LOADS, rigde=0.0),
    "sample 1 folds the sheet": fit(u=FRAMES.u * [[[1]], [[-40]], [[1]]]),
    "a homogeneous body of any material": fit(u=AFFINE),
    r"expected strains of 2 % or more in one, got [01]\.\d": fit(u=0.05 * FRAMES.u),
    "70 measured components inside for 7 numbers, got 18":
        fit(wp.Samples(replace(POINTS, interior=FEW), FRAMES.u)),
    "start: expected shape": fit(start=ones(2)),
    "start: expected .* 7 of 7 masked": fit(LOADS, start=np.ma.masked_all(7)),
    "loads that the energies explain, 100 %": fit(wp.Samples(POINTS, 0 * FRAMES.u, LOADS.b)),
    "0 or at least 8": partial(select_model, FRAMES[[0, 1, 2, 2]], fibres=3),
    "at most 16, one": partial(select_model, FRAMES[[0, 1, 2, 2]], fibres=17),
    "frames: expected at least 4, got 3": partial(select_model, FRAMES),
}  # fmt: skip


@torch.inference_mode()
def test_what_makes_no_sheet_and_what_tells_nothing_is_refused():
    assert_refused(REFUSED)
