"""Uniform fields, and crystals: anisotropic triangles and tetrahedra at the edge."""

import dataclasses

import numpy as np
import pytest
from netgen import csg

from tests.crystal.crystals import learned
from tests.support.plates import MODEL
from tests.support.plates import plate as round_hole
from warp_peri.errors import InputError
from warp_peri.fe_coupling.body import Coupling, long_wave, solve_body
from warp_peri.points.mesh import REST, make_mesh
from warp_peri.points.outlines import Circle, box, mesh_outline

TURNED = {2: 20.0, 3: ((0.6, -0.8, 0.0), (0.8, 0.6, 0.0), (0.0, 0.0, 1.0))}
SIDES = ("left", "right", "top", "bottom")


def plate(size=2.0):
    return mesh_outline(box(60, 60), [Circle(10, size=size / 2)], size=size)


def ball():
    geometry = csg.CSGeometry()
    geometry.Add(csg.Sphere(csg.Pnt(0, 0, 0), 19.0))
    made = geometry.GenerateMesh(maxh=4.0, grading=0.2)
    cells = [[p.nr - 1 for p in cell.points] for cell in made.Elements3D()]
    return make_mesh([point.p for point in made.Points()], cells)


BODIES = {2: (plate, SIDES, 2), 3: (ball, (REST,), 1)}


@pytest.fixture(scope="module", params=[2, pytest.param(3, marks=pytest.mark.slow)])
def body(request):
    """A law of a turned crystal, a mesh, its held parts and the degree of its elements."""
    d = request.param
    law = learned(d, orientation=TURNED[d])
    make, held, degree = BODIES[d]
    return law, make(), held, degree


@pytest.mark.parametrize("crystal", [True, False])
def test_an_affine_field_is_exact_and_its_stress_too(body, crystal):
    law, mesh, held, degree = body
    if not crystal:
        law, mesh, held, degree = MODEL, round_hole(8.0, 32.0, 12, 40), ("sides",), 2
    A = 1e-3 * np.random.default_rng(0).normal(size=(law.dimension,) * 2)
    spacing = law.spacing if crystal else 1.0
    stress = long_wave(law, spacing).stress(A)
    found = solve_body(
        law,
        mesh,
        displacement={name: lambda x: x @ A.T for name in held},
        traction={name: lambda x, n: n @ stress for name in mesh.parts if name not in held},
        coupling=Coupling(spacing=spacing, degree=degree, tolerance=1e-11),
    )
    assert found.points.interior.sum() > 300
    corners, everywhere = found.on_corners()
    for x, u in ((found.rim.x, found.u_rim), (found.points.x, found.u_bulk), (mesh.x, corners)):
        assert np.abs(u - x @ A.T).max() < 1e-10 * np.abs(x @ A.T).max()
    for values in (found.rim_stress, everywhere):
        assert np.abs(values - stress).max() < 1e-9 * np.abs(stress).max()


def test_a_turned_body_with_free_faces_feels_nothing(body):
    law, mesh, held, degree = body
    W = np.zeros((law.dimension,) * 2)
    W[0, 1], W[1, 0] = 1e-3, -1e-3
    found = solve_body(
        law,
        mesh,
        displacement={held[0]: lambda x: x @ W.T},
        coupling=Coupling(degree=degree, tolerance=1e-11),
    )
    feels = 1e-3 * law._surface_traction()  # of cut bonds
    assert feels > 0.01 * 1e-3 * np.abs(law.tensor()).max()
    assert np.abs(found.rim_stress).max() < 1e-8 * feels
    assert np.abs(found.bulk_stress).max() < 1e-8 * feels


def test_bad_input_is_named():
    law, flat = learned(2), plate()
    pressed = dataclasses.replace(law, stress=0.01 * np.eye(2))
    tetrahedron = make_mesh(np.eye(4)[[3, 0, 1, 2], :3], [[0, 1, 2, 3]])
    for model, mesh, spacing, message in (
        (law, flat, 1.0, "coupling: expected spacing 1.5 or None, got 1"),
        (law, tetrahedron, None, "mesh: expected triangles, for a model of 2 dimensions"),
        (pressed, flat, None, "model: expected a crystal at rest"),
    ):
        held = {next(iter(mesh.parts)): (0.0,) * mesh.dimension}
        with pytest.raises(InputError, match=message):
            solve_body(model, mesh, displacement=held, coupling=Coupling(spacing=spacing))
