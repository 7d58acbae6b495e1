"""A hyperelastic solid on a lattice: forces are slopes of the energy, tangents slopes of forces."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.sheets import SPACING, everything, hgo_dictionary, square, waves
from warp_peri import InputError
from warp_peri.materials.hyperelastic.energies import BONDS, EnergyTerm, Hyperelastic
from warp_peri.materials.hyperelastic.equilibrium import TangentPattern
from warp_peri.materials.hyperelastic.operator import HyperelasticOperator, lattice_bonds
from warp_peri.points.points import Points

EDGE = (slice(None, -1), slice(1, None))
"""The lower and the upper of two nodes beside each other."""


def uneven_problem(thickness):
    points = square(3)
    op = HyperelasticOperator(everything(), points, thickness=thickness)
    random = np.random.default_rng(1)
    u = np.stack([waves(points, 0.3, seed) for seed in (0, 1)])
    u += 0.02 * SPACING * random.normal(size=u.shape)
    return op, u, random.normal(size=len(op.dictionary)), SPACING * random.normal(size=u.shape)


@pytest.fixture(scope="module", params=["even", "uneven"])
def problem(request):
    size = len(square(3).x)
    random = np.random.default_rng(3)
    return uneven_problem(
        None if request.param == "even" else np.exp(0.5 * random.normal(size=size))
    )


@pytest.fixture(scope="module")
def even_problem():
    return uneven_problem(None)


def test_force_tangent_and_single_forces_are_those_of_the_energy(problem):
    op, u, c, v = problem
    step = 1e-5
    ends = [op.energy(u + s * step * v, c) for s in (1, -1)]
    work = SPACING**2 * (op.everywhere(u, c) * v).sum(axis=(1, 2))
    np.testing.assert_allclose(work, (ends[0] - ends[1]) / (2 * step), rtol=1e-6)
    ends = [op.everywhere(u + s * 3e-6 * v, c) for s in (1, -1)]
    slope = (ends[0] - ends[1]) / 6e-6
    np.testing.assert_allclose(op.jvp(u, c, v), slope, atol=1e-6 * np.abs(slope).max())
    inside = np.where(op.points.interior[:, None], v[0], 0.0)
    K = TangentPattern(op).matrix(op, u[0], c)
    expected = op.jvp(u[0], c, inside)[op.interior].ravel()
    found = K @ inside[op.interior].ravel()
    np.testing.assert_allclose(found, expected, atol=1e-11 * np.abs(expected).max())
    assert abs(K - K.T).max() < 1e-11 * abs(K).max()
    force, w = op.force(u, c), v[:, op.interior]
    np.testing.assert_allclose(op.features(u) @ c, force, atol=1e-12 * np.abs(force).max())
    assert op.pairing(u, w) @ c == pytest.approx((force * w).sum(), rel=1e-10)


@pytest.mark.parametrize("by", ["angle", "exponent"])
def test_the_force_of_a_fibre_by_its_numbers(problem, by):
    op, u, _, _ = problem
    slopes, first = op.features(u, by=by), op.dictionary.first_term
    for number, term in enumerate(op.dictionary.terms):
        if not term.is_fibre or (by == "exponent" and term.exponent == 0):
            continue
        terms, ends = list(op.dictionary.terms), []
        for shift in (1e-5, -1e-5):
            terms[number] = replace(term, **{by: getattr(term, by) + shift})
            ends.append(op.with_terms(terms).features(u)[..., first + number])
        expected = (ends[0] - ends[1]) / 2e-5
        slope = slopes[..., first + number]
        np.testing.assert_allclose(slope, expected, atol=1e-6 * np.abs(expected).max())


def test_the_force_by_the_thickness_of_every_node(problem):
    op, u, c, _ = problem
    thickness = np.ones(len(op.points.x)) if op.thickness is None else op.thickness
    slopes = op.by_thickness(u, c, np.eye(len(thickness)))
    scale = np.abs(op.force(u, c)).max()
    for n in range(0, len(thickness), 7):
        step = 1e-3 * np.eye(len(thickness))[n]
        ends = [op.with_thickness(thickness + sign * step).force(u, c) for sign in (1, -1)]
        np.testing.assert_allclose(slopes[..., n], (ends[0] - ends[1]) / 2e-3, atol=1e-10 * scale)
    np.testing.assert_allclose(slopes @ thickness, op.force(u, c), atol=1e-12 * scale)


SLOPES = {
    "square": lambda s: (s, 1.0),
    "cube": lambda s: (s**2, 2 * s),
    "tension": lambda s: (max(s, 0), float(s > 0)),
    "tension_cube": lambda s: (max(s, 0) ** 2, 2 * max(s, 0)),
    "log": lambda s: (1 - 1 / (1 + 2 * s), 2 / (1 + 2 * s) ** 2),
    "compression": lambda s: (min(s, 0), float(s < 0)),
}
"""ψ′ and ψ″ of every bond energy, (H2)."""


def test_slopes_of_bonds():
    points = square(1)
    assert set(SLOPES) == set(BONDS)
    for name, slopes in SLOPES.items():
        dictionary = Hyperelastic(3.0, (name,))
        op = HyperelasticOperator(dictionary, points)
        for stretch in (0.8, 1.3):
            u = (stretch - 1) * points.x * [1, 0]
            c = np.zeros(len(dictionary))
            c[1] = 1.0  # the bond (1, 0)
            v = np.zeros_like(u)
            v[op.interior] = [1.0, 0.0]
            K = float(op.jvp(u, c, v)[op.interior][0, 0])
            slope, curve = slopes((stretch**2 - 1) / 2)
            expected = 2 * (curve * stretch**2 + slope) / SPACING**2
            assert K == pytest.approx(expected, rel=1e-12)


def test_no_force_in_uniform_strain(even_problem):
    op, _, c, _ = even_problem
    F = np.array([[1.25, 0.1], [-0.2, 0.9]])
    u = op.points.x @ (F - np.eye(2)).T
    assert np.abs(op.force(u, c)).max() < 1e-9 * np.abs(c).max() / SPACING
    E = op.strain(u)[op.interior]
    C = F.T @ F
    np.testing.assert_allclose(E - [(C[0, 0] - 1) / 2, (C[1, 1] - 1) / 2, C[0, 1]], 0, atol=1e-12)


def test_the_strain_is_of_fourth_order_and_the_force_converges():
    """The force of a smooth field tends to −div P with the fourth power of the spacing."""
    errors = []
    spacings = (0.1, 0.05, 0.025)
    c = np.array([0.1] * 4 + [0.07, 0.08, 0.2])
    for spacing in spacings:
        steps = np.argwhere(np.ones((13, 13), bool)) - 6
        points = Points(spacing * steps, (steps == 0).all(axis=1), spacing)
        op = HyperelasticOperator(hgo_dictionary(), points)
        errors.append(op.force(field(points.x), c)[0])
    fine = HyperelasticOperator(
        hgo_dictionary(), Points(0.005 * steps, (steps == 0).all(axis=1), 0.005)
    )
    limit = fine.force(field(fine.points.x), c)[0]
    sizes = np.linalg.norm(np.array(errors) - limit, axis=1)
    rate = np.polyfit(np.log(spacings), np.log(sizes), 1)[0]
    assert rate > 3.5


def field(x):
    """A smooth field under tension along the fibres everywhere near the origin."""
    y = x @ np.array([[0.1, 0.02], [0.03, 0.25]]).T
    return y + 0.05 * np.sin(2 * x[:, ::-1] + 0.4) + 0.03 * np.cos(1.5 * x + 0.2)


def test_corners_of_cells_are_linear_triangles():
    """Energy and force are means over the four ways to leave one node out of every cell."""
    points = square(3)
    term = EnergyTerm("volumetric", corner=True)
    op = HyperelasticOperator(Hyperelastic(3.0, terms=(term,)), points)
    u = waves(points, 0.3)
    y = (points.x + u).reshape(2 * [int(np.sqrt(len(u)))] + [2]) / SPACING
    total = 0.0
    for apex in np.ndindex(2, 2):
        cell = [np.diff(y, axis=a)[(slice(None),) * (1 - a) + (EDGE[apex[1 - a]],)] for a in (0, 1)]
        D = (cell[0][..., 0] * cell[1][..., 1] - cell[0][..., 1] * cell[1][..., 0]) ** 2
        total += SPACING**2 / 4 * (0.5 * (D - 1 - np.log(D))).sum()
    assert op.energy(u, np.ones(1)) == pytest.approx(total, rel=1e-12)


STRETCH = np.array([1.4, 1.4**-0.5])


@pytest.mark.parametrize(
    ("term", "pull"),
    [
        (EnergyTerm("mooney"), 1 - 1.4**-3),
        (EnergyTerm("yeoh", exponent=2.0), 2 * (1.4 - 1.4**-2) * (1.4**2 + 2 / 1.4 - 3)),
        (EnergyTerm("yeoh", exponent=3.0), 3 * (1.4 - 1.4**-2) * (1.4**2 + 2 / 1.4 - 3) ** 2),
    ],
)
def test_incompressible_sheets_pull_as_their_formulas_say(term, pull):
    """I2 − 3, and powers of I1 − 3, in plane stress."""
    points = square(4)
    op = HyperelasticOperator(Hyperelastic(3.0, (), (), (term,)), points)
    P = op.stress(points.x * (STRETCH - 1), np.array([0.7]))[op.interior]
    np.testing.assert_allclose(P[:, 1, 1], 0, atol=1e-10)
    np.testing.assert_allclose(P[:, 0, 0], 2 * 0.7 * pull, rtol=1e-9)


def test_fibres_see_the_stretch_along_them():
    points, F = square(1), np.array([[1.2, 0.3], [-0.1, 1.1]])
    stretched = np.sum((F @ [np.cos(0.7), np.sin(0.7)]) ** 2) - 1
    op = HyperelasticOperator(
        Hyperelastic(3.0, terms=(EnergyTerm("fibre_power", 0.7, 2.0),)), points
    )
    energy = op.nodal_energy(points.x @ (F - np.eye(2)).T, np.ones(1))[op.interior]
    np.testing.assert_allclose(energy, stretched**2 / 2, rtol=1e-12)


POINTS = square(2)
OPERATOR = HyperelasticOperator(hgo_dictionary(), POINTS)
FIELD, ALL = np.zeros_like(POINTS.x), np.ones(len(POINTS.x), bool)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: OPERATOR.force(np.zeros((3, 2)), np.zeros(7)), "u: expected shape"),
        (lambda: OPERATOR.force(FIELD, np.zeros(6)), "c: expected shape"),
        (lambda: OPERATOR.jvp(FIELD, np.zeros(7), FIELD[None]), "v: expected shape"),
        (lambda: lattice_bonds(Points(POINTS.x, ALL, 0.1), 3.0), "twice the horizon"),
        (lambda: lattice_bonds(Points(POINTS.x, ALL, 0.0), 3.0), "scattered"),
        (lambda: OPERATOR.with_thickness(np.ones(3)), "thickness: expected"),
        (
            lambda: OPERATOR.with_thickness(0 * FIELD[:, 0]),
            "thickness: expected finite numbers > 0",
        ),
    ],
)
def test_what_cannot_be_used_is_refused(call, words):
    with pytest.raises(InputError, match=words):
        call()
