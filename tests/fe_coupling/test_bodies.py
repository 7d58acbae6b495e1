"""Bodies by elements at the outline and the operator inside: holes, uniform fields, crystals."""

from dataclasses import replace

import numpy as np
import pytest
from netgen import csg

from examples.exact import plate_with_hole, relative_error
from tests.crystal.crystals import learned
from tests.support import each_refused, filterwarnings, near, parametrize, shared, slow, sup, warned
from tests.support.plates import MODEL, plate
from tests.support.problems import fitted_order, normal
from warp_peri.fe_coupling.body import Coupling, long_wave, solve_body
from warp_peri.fe_coupling.boundary_elements import loads_on
from warp_peri.fe_coupling.schwarz import bulk_lattice
from warp_peri.points.mesh import REST, make_mesh
from warp_peri.points.outlines import Circle, box, mesh_outline

SPACING, RADIUS, HALF, TENSION = 1.0, 8.0, 32.0, 0.005
TURNED = {2: 20.0, 3: ((0.6, -0.8, 0.0), (0.8, 0.6, 0.0), (0.0, 0.0, 1.0))}
SIDES = ("left", "right", "top", "bottom")
holed = lambda: mesh_outline(box(60, 60), [Circle(10, size=1.0)], size=2.0)


@shared
def field():
    """Displacement and stress of a plate with a hole, of the model's long waves."""
    moduli = long_wave(MODEL, SPACING)
    return lambda x: plate_with_hole(x, RADIUS, TENSION, moduli)


@shared
def held(field):
    """What moves the sides."""
    return {"sides": lambda x: field(x)[0]}


def test_a_hole_has_the_exact_displacement_and_a_bare_model_is_proven(field, held):
    mesh = plate(RADIUS, HALF, 16, 80)
    solution = solve_body(MODEL, mesh, displacement=held)
    assert solution.spacing == solution.tried[-1].spacing == 1.0
    again = solve_body(replace(MODEL, certified_on=()), mesh, displacement=held)
    near(again.on_corners()[0], solution.on_corners()[0], 1e-8, 1)
    assert relative_error(solution.u_rim, field(solution.rim.x)[0]) < 5e-4
    assert relative_error(solution.u_bulk, field(solution.points.x)[0]) < 5e-4
    told = solution.exchange
    assert told.exchanges <= 12
    assert max(told.mismatch, told.rim_residual, told.bulk_residual) < 1e-8


@filterwarnings("ignore:mesh. no triangle")
def test_stress_along_a_hole_converges_with_the_mesh(field, held):
    """Its largest error at nodes of curved elements, over the tension."""
    counts, errors = np.array([10, 14, 20]), []
    coupling = Coupling(spacing=SPACING, overlap=9.0)
    for n in counts:
        mesh = plate(RADIUS, HALF, n, 4 * n)
        solution = solve_body(MODEL, mesh, displacement=held, coupling=coupling)
        edge = solution.rim.nodes_of("hole")
        right = field(solution.rim.x[edge] * (1 + 1e-12))[1]
        errors.append(sup(solution.rim_stress[edge] - right) / TENSION)
    assert fitted_order(1 / counts, errors) > 1.9
    assert errors[-1] < 0.01


def test_bad_input_is_named():
    tiny, small, huge = (plate(RADIUS * size, HALF * size, 8, 32) for size in (1e-10, 1, 1e10))
    on = {"coupling": Coupling(spacing=SPACING)}
    small = replace(small, parts=small.parts | {"top": np.zeros(0, int)})
    given = {"mesh": small, "displacement": {"sides": (0.0, 0.0)}}
    own = np.ones((3, 2))
    loads_on(small, {}, None, lambda x: x.__imul__(2)).b(own)
    assert (own == 1).all()  # a function has its positions to itself
    each_refused(lambda change: solve_body(MODEL, **given | on | change), {
        "part 'top': the outline has hole, sides": {"displacement": {"top": (0, 0)}},
        "hold the body against shifts and turns": {"displacement": {"sides": (0, np.nan)}},
        "part 'hole': expected shape": {"traction": {"hole": lambda x, n: n[:, :1]}},
        "part 'hole': expected a function of positions and": {"traction": {"hole": lambda x: x}},
        r"b: expected shape \[\d+, 2\], got": {"b": lambda x: x[:, 0]},
        "expected positions of a": {"mesh": huge},
        "expected positions of a body that a": {"mesh": tiny, "coupling": Coupling()},
        "a hole of 4 Å is smaller than the over": {"mesh": plate(2.0, HALF, 12, 32)},
    })  # fmt: skip


def test_elements_reach_as_deep_as_asked(field, held):
    """Beyond a collar, and no less than that where less is asked for."""
    mesh, found = plate(RADIUS, HALF, 16, 80), []
    for depth in (None, 1.2):
        coupling = Coupling(spacing=SPACING, overlap=5.0, depth=depth and depth * 2 * MODEL.horizon)
        solution = solve_body(MODEL, mesh, displacement=held, coupling=coupling)
        found.append(mesh.distance(solution.points.x[solution.points.interior], SPACING / 10).min())
        assert relative_error(solution.u_bulk, field(solution.points.x)[0]) < 5e-4
    assert 2 * MODEL.horizon <= found[0] < 1.2 * 2 * MODEL.horizon <= found[1]


@parametrize(
    ("half", "depth", "words"),
    [(14.0, None, "elements alone"), (HALF, 10 * HALF, "a smaller spacing, overlap or depth")],
)
def test_without_room_for_the_lattice_elements_are_alone(field, held, half, depth, words):
    trained = replace(MODEL, trained_strain=0.5 * TENSION)
    mesh = plate(RADIUS, half, 16, 80)
    coupling = Coupling(spacing=SPACING, depth=depth)
    with warned(words), warned("strain: the sol"):
        solution = solve_body(trained, mesh, displacement=held, coupling=coupling)
    assert solution.points is None
    assert relative_error(solution.u_rim, field(solution.rim.x)[0]) < 5e-4


def wave(length):
    return lambda x: np.stack([np.sin(2 * np.pi * x[:, 1] / length), 0 * x[:, 0]], axis=1)


def test_the_body_asks_for_a_finer_lattice_and_so_do_short_waves():
    wide, tried = bulk_lattice(MODEL, plate(30.0, 120.0, 10, 48), None, Coupling())
    assert tried[-1].spacing == 2.0
    assert tried[-1].verdict == "taken"
    assert wide.is_certified_on(2.0)
    same, tried = bulk_lattice(MODEL, plate(RADIUS, HALF, 10, 48), None, Coupling())
    assert same is MODEL
    assert [a.spacing for a in tried] == [2.0, 1.5, 1.0]
    assert "of the body is two horizons inside" in tried[0].verdict
    assert tried[-1].share >= 0.5
    _, tried = bulk_lattice(MODEL, plate(30.0, 120.0, 10, 48), wave(9.0), Coupling())
    assert tried[-1].spacing == 1.5
    assert tried[0].verdict == "the waves of the load are not resolved"
    assert tried[0].wave_error > 0.005


def ball():
    geometry = csg.CSGeometry()
    geometry.Add(csg.Sphere(csg.Pnt(0, 0, 0), 19.0))
    made = geometry.GenerateMesh(maxh=4.0, grading=0.2)
    cells = [[p.nr - 1 for p in cell.points] for cell in made.Elements3D()]
    return make_mesh([point.p for point in made.Points()], cells)


BODIES = {2: (holed, SIDES, 2), 3: (ball, (REST,), 1)}


@pytest.fixture(scope="module", params=[2, pytest.param(3, marks=slow)])
def body(request):
    """A law of a turned crystal, a mesh, its held parts and the degree of its elements."""
    d = request.param
    make, held, degree = BODIES[d]
    return learned(d, orientation=TURNED[d]), make(), held, degree


def test_an_affine_field_is_exact_and_its_stress_too(body):
    law, mesh, held, degree = body
    A = 1e-3 * normal((law.dimension,) * 2)
    stress = long_wave(law, law.spacing).stress(A)
    how = {"displacement": {name: lambda x: x @ A.T for name in held}}
    how["traction"] = {p: lambda x, n: n @ stress for p in mesh.parts if p not in held}
    coupling = Coupling(spacing=law.spacing, degree=degree, tolerance=1e-11)
    found = solve_body(law, mesh, **how, coupling=coupling)
    assert found.points.interior.sum() > 300
    corners, everywhere = found.on_corners()
    for x, u in ((found.rim.x, found.u_rim), (found.points.x, found.u_bulk), (mesh.x, corners)):
        near(u, x @ A.T, 1e-10)
    for values in (found.rim_stress, everywhere):
        near(values - stress, 0 * values, 1e-9, sup(stress))


def test_bodies_of_crystals_that_do_not_fit_are_named():
    law, flat = learned(2), holed()
    tetrahedron = make_mesh(np.eye(4)[[3, 0, 1, 2], :3], [[0, 1, 2, 3]])

    def held(model, mesh, spacing=None):
        at_rest = {next(iter(mesh.parts)): (0.0,) * mesh.dimension}
        solve_body(model, mesh, displacement=at_rest, coupling=Coupling(spacing=spacing))

    each_refused(held, {
        "coupling: expected spacing 1.5 or None, got 1": (law, flat, 1.0),
        "mesh: expected triangles, for a model of 2 dimensions": (law, tetrahedron),
        "model: expected a crystal at rest": (replace(law, stress=0.01 * np.eye(2)), flat),
    })  # fmt: skip
