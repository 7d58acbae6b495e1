"""The solid as a value: numbers, file, spacings; influence functions of any shape; stress."""

from dataclasses import replace

import numpy as np
import scipy.linalg
from matplotlib.pyplot import figure
from numpy import array, cos, eye, nan, ones, pi, sin
from numpy.testing import assert_allclose

from tests.support import approx, assert_refused, clouds, near, parametrize, refused, sup, warned
from tests.support.clouds import cloud, larger, periodic_cloud, plain
from tests.support.problems import ROUNDING, cut, fitted_order, kernel, lattice, noise, normal
from tests.support.shapes import HORIZON, LENGTHS, SHAPES, solid
from warp_peri import Points, certify
from warp_peri.influence import InfluenceFunction, gaussian, table
from warp_peri.materials.lps import bernstein_basis
from warp_peri.materials.lps_law import ShapeKernel
from warp_peri.materials.lps_operator import node_fields
from warp_peri.plots import influence_function
from warp_peri.points.families import bond_classes

made = lambda function, **parameters: lambda: InfluenceFunction(function, parameters)(LENGTHS)
bounded = lambda bounds: lambda: InfluenceFunction(gaussian, {"width": 2.0}, bounds)
numbers = lambda **change: lambda: plain(HORIZON, **change)
jagged = lambda r: 1.0 + (np.round(r * 1e3) % 2)
tabled = lambda *r: lambda: table(r, [1.0, 0.5]).coefficients(LENGTHS, HORIZON)


def test_k_over_m_is_drawn_of_its_dimension():
    ax = influence_function(clouds.solid(2.5), spacing=1.0, ax=figure().add_subplot())
    assert (len(ax.lines[-1].get_ydata()), ax.get_ylabel()) == (6, "K / m  [Å⁻⁵]")


def test_continuum_constants_are_those_of_plane_stress_and_of_space():
    model, deep = plain(3.0, 0.4), clouds.solid(2.5)
    assert model.E / (2 * (1 + model.nu)) == approx(0.8)  # μ
    assert model.E * model.nu / (1 - model.nu**2) == approx(0.4)  # λ in the plane
    bulk = deep.lam + 2 * deep.mu / 3
    assert deep.E == approx(9 * bulk * deep.mu / (3 * bulk + deep.mu))
    assert deep.nu == approx(deep.E / (2 * deep.mu) - 1)


def test_a_spacing_is_the_certified_one_to_a_millionth():
    """Of a plain kernel at the bond lengths of the lattice that swings by a million beside them."""
    unseen = scipy.linalg.null_space(bernstein_basis(bond_classes(5.0, 12.5).r, 12.5, 10))
    D, here = ones(11) + 1e6 * unseen.sum(1), lattice(6, 12.5, 5.0)
    wild, u = plain(12.5, D=D, certified_on=(5.0,)), noise(here)
    little = 1 - 0.99e-6
    assert certify(wild, spacing=little * 5) == certify(wild, spacing=5.0)
    near(wild.on(larger(here, little))(u), wild.on(here)(u), ROUNDING)
    for factor in (0.5, 1 + 1.001e-6):
        with refused("the model is certified on"):
            wild.on(larger(here, factor), transfer=False)
        with refused("the model is certified on"):
            replace(wild, certified_on=(1e-9,)).check_spacing(1e-9 * factor)
        with warned("the model is certified on 5 Å, not on"):
            wild.check_spacing(5.0 * factor, allow_uncertified=True)


@parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_the_polynomial_is_the_function_at_every_bond_and_near_it_between(shape):
    model = solid(shape, 1.0, 0.8)
    for spacing in (1.0, 0.8):
        r = bond_classes(spacing, HORIZON).r
        near(model.influence(r), shape(r), 1e-8)
    model, r = solid(shape, 1.0), np.linspace(LENGTHS[0] / 2, HORIZON, 1001)
    departure = sup(model.influence(r) - shape(r)) / sup(shape(LENGTHS))
    if shape is SHAPES["table"]:  # of a function with kinks it is said
        assert model.provenance["influence"]["departure"] == approx(departure, rel=0.2)
    assert (departure > 1e-4) == (shape is SHAPES["table"])


def test_slopes_beside_zero_and_at_the_bounds_and_those_of_the_formula():
    for phase in (1e-12, 0.0, 1.0):
        wave = lambda r, phase: cos(r + phase)
        shape = InfluenceFunction(wave, {"phase": phase}, {"phase": (0.0, 1.0)})
        expected = -sin(LENGTHS + phase)[:, None]
        assert_allclose(shape.slopes(LENGTHS), expected, atol=1e-10)
    expected = 2 * LENGTHS**2 / 1.9**3 * gaussian(LENGTHS, 1.9)
    assert_allclose(SHAPES["gaussian"].slopes(LENGTHS)[:, 0], expected, rtol=1e-11)


def vanishing():
    """Of a weighted volume of zero."""
    classes = bond_classes(1.0, HORIZON)
    K = [1, -1, 0, 0, 0, 0] / (classes.count * classes.r**2 * classes.weight)
    return ShapeKernel([classes], InfluenceFunction(lambda r: np.interp(r, LENGTHS, K)))


def test_what_makes_no_sense_is_refused_in_words():
    assert_refused({
        "expected μ > 0 and λ . μ > 0, got -0.8, 0.8": numbers(lam=-0.8),
        "μ > 0 and λ . 2μ/3 > 0": numbers(lam=-0.6, dimension=3),
        "dimension: expected 2 or 3, got 4": numbers(dimension=4),
        "D: expected at least one coefficient, at most 1001, got 0": numbers(D=[]),
        "D: expected a coefficient other than 0": numbers(D=[0.0, 0.0]),
        "D: expected a list of numbers, got lists": numbers(D=[[1.0, 2.0]]),
        "width: expected finite values": made(gaussian, width=nan),
        r"bounds of width: expected \(lowest, highest\), got 5": bounded({"width": 5}),
        "no parameter 'reach'; there are: width": bounded({"reach": (0, 1)}),
        "are not within": bounded({"width": (3, 4)}),
        r"that of r: expected shape \[6\], got \[\]": made(lambda r: r[0]),
        "K is zero at": lambda: InfluenceFunction(lambda r: 0 * r).coefficients(LENGTHS, 3.0),
        "no polynomial of degree 80 takes its values":
            lambda: solid(InfluenceFunction(jagged), 5.0, 2.5, 2.0, 1.0, horizon=20.0),
        "weighted volume": vanishing,
        "of one shape": lambda: table([0, 1], [1.0]),
        "rising": lambda: table([1, 0], [1.0, 1.0]),
        "table: expected K at all bonds, 1 to 3, got it at": (tabled(0.1, 1), tabled(1.1, 3)),
        "certified_on: expected a list, got array": numbers(certified_on=array(1.0)),
    })  # fmt: skip


@parametrize("points", [cloud(5, HORIZON), clouds.cube(2, 2.0)])
def test_an_affine_field_has_the_stress_of_hooke(points):
    d = points.dimension
    G = normal((d, d), 2)
    model = plain(HORIZON) if d == 2 else clouds.solid(2.0)
    fields, strain = node_fields(model, points, points.x @ G.T), (G + G.T) / 2
    stress = model.lam * np.trace(G) * eye(d) + 2 * model.mu * strain
    assert_allclose(fields.stress - stress, 0, atol=1e-9)
    assert_allclose(fields.strain - strain, 0, atol=1e-9)
    if points.spacing:
        assert_allclose(fields.dilatation, np.trace(G), atol=1e-12)
        assert_allclose(fields.energy, (stress * strain).sum() / 2, rtol=1e-12)


def test_its_divergence_balances_the_force_to_second_order():
    errors, spacings, k = [], (1.0, 0.5, 0.25), 2 * pi / 24
    for h in spacings:
        n = round(24 / h)
        points, model = Points.sheet((n, n), h), kernel("1/r", 3 * h, h)
        x, y = points.x.T
        u = np.c_[sin(k * x) * cos(k * y), cos(2 * k * x + k * y)]
        stress = node_fields(model, points, u).stress.reshape(n, n, 2, 2)
        wave, of = 2j * pi * np.fft.fftfreq(n, h), np.fft.fft2(stress, axes=(0, 1))
        divergence = of[..., 0] * wave[:, None, None] + of[..., 1] * wave[None, :, None]
        balance = np.fft.ifft2(divergence, axes=(0, 1)).real.reshape(-1, 2)
        force = model.on(points)(u)
        errors.append(sup(balance + force) / sup(force))
    assert fitted_order(spacings, errors) > 1.9


def test_stress_is_that_of_nearest_images_and_of_complete_families():
    points = periodic_cloud(9)
    moved = replace(points, x=np.mod(points.x + array([3.3, 4.7]), points.box))  # cut elsewhere
    model, u = kernel("positive", HORIZON), noise(points)
    here, there = (node_fields(model, one, u) for one in (points, moved))
    for part, expected in vars(here).items():
        assert_allclose(vars(there)[part], expected, rtol=0, atol=1e-9, err_msg=part)
    body = lattice(4, HORIZON)
    with refused("outside: expected none"):
        node_fields(model, cut(body, body.x[:, 0] > 5), body.x)
