"""Bodies with holes by elements at the outline and the learned operator inside."""

import dataclasses

import numpy as np
import pytest

from examples.exact import hoop_stress, plate_with_hole
from tests.support.plates import plate
from warp_peri import Model, certify
from warp_peri.errors import InputError
from warp_peri.fe_coupling.body import Coupling, long_wave, solve_body
from warp_peri.fe_coupling.boundary_elements import Moduli
from warp_peri.points.outlines import Circle, box, mesh_outline

SPACING, RADIUS, HALF, TENSION = 1.0, 8.0, 32.0, 0.005


@pytest.fixture(scope="module")
def model():
    """A kernel that changes sign, three spacings wide, certified on its lattice."""
    material = Model(lam=0.3, mu=0.8, alpha=1.0, D=[0.4, 0.6, -0.3, 0.6, -0.2], horizon=3.0)
    assert certify(material, spacing=SPACING).holds
    assert material.influence([1.0, 3.0]).prod() < 0
    return dataclasses.replace(material, certified_on=(SPACING,))


def exact(model):
    moduli = long_wave(model, SPACING)
    return lambda x: plate_with_hole(x, RADIUS, TENSION, moduli)


def error(values, expected):
    return np.linalg.norm(values - expected) / np.linalg.norm(expected)


def test_a_hole_has_the_exact_displacement_and_hoop_stress(model):
    field = exact(model)
    mesh = plate(RADIUS, HALF, 16, 80)
    solution = solve_body(model, mesh, displacement={"sides": lambda x: field(x)[0]})
    assert error(solution.u_rim, field(solution.rim.x)[0]) < 5e-4
    assert error(solution.u_bulk, field(solution.points.x)[0]) < 5e-4
    edge = solution.rim.nodes_of("hole")
    x = solution.rim.x[edge]
    expected = hoop_stress(x, field(x)[1])
    assert (
        np.abs(hoop_stress(x, solution.rim_stress[edge]) - expected).max() < 0.01 * expected.max()
    )
    assert solution.exchange.exchanges <= 12
    assert solution.exchange.mismatch <= 1e-8
    assert solution.exchange.rim_residual < 1e-8
    assert solution.exchange.bulk_residual < 1e-8


@pytest.mark.filterwarnings("ignore:mesh. no triangle")
def test_stress_along_a_hole_converges_with_the_mesh(model):
    """Its largest error at nodes of curved elements, over the tension."""
    field, counts, errors = exact(model), np.array([10, 14, 20]), []
    coupling = Coupling(spacing=SPACING, overlap=9.0)
    for n in counts:
        mesh, held = plate(RADIUS, HALF, n, 4 * n), {"sides": lambda x: field(x)[0]}
        solution = solve_body(model, mesh, displacement=held, coupling=coupling)
        edge = solution.rim.nodes_of("hole")
        right = field(solution.rim.x[edge] * (1 + 1e-12))[1]
        errors.append(np.abs(solution.rim_stress[edge] - right).max() / TENSION)
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] > 1.9
    assert errors[-1] < 0.01


@pytest.mark.parametrize("degree", [1, 2])
def test_an_affine_field_is_exact(model, degree):
    gradient = np.array([[2e-3, 7e-4], [-3e-4, -1e-3]])
    stress = long_wave(model, SPACING).stress(gradient)
    solution = solve_body(
        model,
        plate(RADIUS, HALF, 12, 40),
        displacement={"sides": lambda x: x @ gradient.T},
        traction={"hole": lambda x, n: n @ stress},
        coupling=Coupling(spacing=SPACING, degree=degree, tolerance=1e-12),
    )
    assert error(solution.u_rim, solution.rim.x @ gradient.T) < 1e-10
    assert error(solution.u_bulk, solution.points.x @ gradient.T) < 1e-10
    np.testing.assert_allclose(
        solution.rim_stress,
        np.broadcast_to(stress, solution.rim_stress.shape),
        atol=1e-10 * np.abs(stress).max(),
    )
    u, everywhere = solution.on_corners()
    assert error(u, solution.rim.mesh.x @ gradient.T) < 1e-10
    assert np.abs(everywhere - stress).max() < 1e-9 * np.abs(stress).max()


def test_the_exact_field_is_in_balance_and_kirsch_when_isotropic():
    moduli = Moduli.square(C11=1.2, C12=0.4, C44=0.4)
    angle = np.linspace(0, 2 * np.pi, 17)[:-1]
    x = RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    _, stress = plate_with_hole(x, RADIUS, TENSION, moduli)
    assert np.abs(np.einsum("nab,nb->na", stress, x)).max() < 1e-6 * TENSION * RADIUS
    np.testing.assert_allclose(
        hoop_stress(x, stress), TENSION * (1 - 2 * np.cos(2 * angle)), atol=1e-6 * TENSION
    )
    step = 1e-4
    u = [
        plate_with_hole(1.7 * x + d, RADIUS, TENSION, moduli)[0]
        for d in step * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    ]
    gradient = np.stack([u[0] - u[1], u[2] - u[3]], axis=-1) / (2 * step)
    _, beyond = plate_with_hole(1.7 * x, RADIUS, TENSION, moduli)
    np.testing.assert_allclose(moduli.stress(gradient), beyond, atol=1e-5 * TENSION)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"displacement": {"top": (0, 0)}}, "part 'top': the outline has hole, sides"),
        ({"displacement": {"sides": (0, np.nan)}}, "hold the body against shifts and turns"),
        ({"displacement": {"sides": (0, 0, 0)}}, "part 'sides': expected vectors of shape"),
        ({"traction": {"rim": (0, 1)}}, "part 'rim': the outline has"),
        ({"displacement": {"sides": (np.inf, 0)}}, "part 'sides': expected finite values"),
        ({"displacement": {"sides": "left"}}, "part 'sides': expected float values"),
        ({"traction": {"hole": (np.nan, 0)}}, "part 'hole': expected finite values"),
        ({"traction": {"hole": 0.1}}, "part 'hole': expected vectors of shape"),
        ({"traction": {"hole": [0.1]}}, "part 'hole': expected vectors of shape"),
        ({"traction": {"hole": lambda x, n: n[:, :1]}}, "part 'hole': expected vectors of shape"),
        ({"b": (0.0, 0.0)}, "b: expected a function"),
        ({"b": lambda x: x[:, 0]}, r"b: expected vectors of shape \[\d+, 2\], got shape"),
        ({"b": lambda x: np.nan * x}, "b: expected finite values"),
        ({"edge": {"hole": "soft"}}, "edge 'hole': expected a finite stiffness"),
        ({"edge": {"hole": -100.0}}, "edge: with this negative stiffness"),
    ],
)
def test_bad_input_is_named(model, change, message):
    asked = {"displacement": {"sides": (0.0, 0.0)}} | change
    with pytest.raises(InputError, match=message):
        solve_body(model, plate(RADIUS, HALF, 8, 32), **asked)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"degree": 3}, "degree: expected 1 or 2"),
        ({"spacing": 0.0}, "spacing: expected a lattice spacing > 0"),
        ({"overlap": np.nan}, "overlap: expected a length > 0"),
        ({"overlap": -1.0}, "overlap: expected a length > 0"),
        ({"depth": 0.0}, "depth: expected a length > 0"),
        ({"tolerance": 0.0}, "tolerance: expected a number between 0 and 1"),
        ({"tolerance": "fine"}, "tolerance: expected a number between 0 and 1"),
    ],
)
def test_a_coupling_that_cannot_be(change, message):
    with pytest.raises(InputError, match=message):
        Coupling(**change)


def test_elements_reach_as_deep_as_asked(model):
    """Beyond a collar, and no less than that where less is asked for."""
    field, mesh, found = exact(model), plate(RADIUS, HALF, 16, 80), []
    for depth in (None, 0.1, 1.2):
        coupling = Coupling(spacing=SPACING, overlap=5.0, depth=depth and depth * 2 * model.horizon)
        solution = solve_body(
            model, mesh, displacement={"sides": lambda x: field(x)[0]}, coupling=coupling
        )
        unknown = solution.points.x[solution.points.interior]
        found.append(mesh.distance(unknown, SPACING / 10).min())
        assert error(solution.u_bulk, field(solution.points.x)[0]) < 5e-4
    assert found[1] == found[0] >= 2 * model.horizon
    assert found[2] >= 1.2 * 2 * model.horizon > found[0]


def test_a_depth_that_leaves_no_room_is_named(model):
    coupling = Coupling(spacing=SPACING, overlap=9.0, depth=10 * HALF)
    with pytest.warns(UserWarning, match="Room for the lattice: .*a smaller depth"):
        solve_body(
            model, plate(RADIUS, HALF, 8, 32), displacement={"sides": (0, 0)}, coupling=coupling
        )


@pytest.mark.parametrize("unit", [1e-10, 1e10])
@pytest.mark.parametrize("spacing", [SPACING, None])
def test_a_mesh_in_another_unit_is_refused(model, unit, spacing):
    mesh, coupling = plate(RADIUS * unit, HALF * unit, 8, 32), Coupling(spacing=spacing)
    with pytest.raises(InputError, match="expected positions of a body that a lattice of"):
        solve_body(model, mesh, displacement={"sides": (0, 0)}, coupling=coupling)


def test_a_hole_smaller_than_the_overlap_is_refused(model):
    mesh = plate(2.0, HALF, 12, 32)
    coupling = Coupling(spacing=SPACING)
    with pytest.raises(InputError, match="a hole of 4 Å is smaller than the overlap"):
        solve_body(model, mesh, displacement={"sides": (0, 0)}, coupling=coupling)


def test_a_thin_body_is_solved_by_elements_alone(model):
    field = exact(model)
    mesh = plate(RADIUS, 14.0, 12, 80)
    with pytest.warns(UserWarning, match="elements alone"):
        solution = solve_body(model, mesh, displacement={"sides": lambda x: field(x)[0]})
    assert solution.points is None
    assert error(solution.u_rim, field(solution.rim.x)[0]) < 5e-4


def test_a_narrow_strip_with_a_small_hole_is_solved_by_elements_alone(model):
    mesh = mesh_outline(box(40, 5), [Circle(1.0, size=0.5)], size=1.5)
    with pytest.warns(UserWarning, match="elements alone"):
        solution = solve_body(
            model, mesh, displacement={"left": (0, 0)}, traction={"right": (TENSION, 0)}
        )
    u, stress = solution.on_corners()
    assert u[:, 0].max() == pytest.approx(TENSION / 1.85 * 40, rel=0.1)  # E = 1.85 TPa
    assert stress[:, 0, 0].max() > 2 * TENSION


def test_moduli_without_positive_energy_are_refused(model):
    unsound = dataclasses.replace(model, D=[2.0, -1.0, 0.0])
    with pytest.raises(InputError, match="long-wave moduli of positive energy"):
        solve_body(
            unsound,
            plate(RADIUS, HALF, 8, 32),
            displacement={"sides": (0, 0)},
            coupling=Coupling(spacing=SPACING),
        )
