"""The law itself and on nodes: symmetry, symbol, moduli, force, energy, and what is refused."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from tests.crystal.crystals import COPPER, huang_defect, lattice, learned, plain_energy, random_law
from tests.support import approx, assert_refused, in_plane_and_space, near, parametrize, sup, warned
from tests.support.problems import OTHER, noise, normal, slope
from warp_peri import Periodic, Points, solve
from warp_peri.core import elastic
from warp_peri.core.elastic import checked_orientation, name_of, point_group, shared_with_nodes
from warp_peri.core.stencil import invariant_basis
from warp_peri.materials.crystal import CrystalMaterial
from warp_peri.materials.crystal_fit import plane_strain, plane_stress


def test_a_family_has_its_numbers_and_a_group_is_known_by_its_rotations():
    for name, d, reach, bonds, numbers in (("1", 2, 2.0, 12, 18), ("m-3m", 3, 6**0.5, 80, 17)):
        found = invariant_basis(reach, shared_with_nodes(point_group(name, d), np.eye(d)))
        assert (2 * len(found.steps), len(found.basis)) == (bonds, numbers)
    for name, d in (("6mm", 2), ("m-3m", 3)):
        group, turn = point_group(name, d), checked_orientation(10.0, d)
        assert_allclose(turn[:2, 0], [np.cos(np.pi / 18), np.sin(np.pi / 18)], rtol=1e-15)
        assert name_of(group[::-1]) == name
        assert_array_equal(name_of(turn @ group @ turn.T), turn @ group @ turn.T)


@in_plane_and_space
def test_moduli_are_those_of_long_waves_in_the_crystals_own_axes(d):
    law, turned = learned(d), learned(d, orientation=20.0)
    assert huang_defect(law) < 1e-10
    assert law.moduli() == approx(COPPER, rel=1e-8)
    assert law.in_units(OTHER).moduli() == approx(law.moduli("GPa"), rel=1e-8)
    k = 1e-4 * normal((4, d), 2)
    local = np.einsum("ijkl,nj,nl->nik", law.tensor(), k, k)
    assert_allclose(law.symbol(k), local, rtol=1e-5, atol=1e-14)
    near(law._surface_traction(), abs(0.122 - 0.076) / 2, 1e-8)
    assert turned.moduli("GPa") == approx(law.moduli("GPa"), rel=1e-8)


@in_plane_and_space
def test_elements_have_the_moduli_of_their_solid(d):
    matrix = normal(2 * (3 * d - 3,), 4)
    C = elastic.voigt_to_tensor(matrix @ matrix.T + np.eye(len(matrix)))
    steps, tensors = elastic.q1_tensors(C)
    law = CrystalMaterial(2.0, steps, tensors / 4.0)
    assert_allclose(law.tensor(), C, atol=1e-10)
    assert huang_defect(law) < 1e-12


def test_plane_strain_does_as_the_law_in_space_and_plane_stress_has_a_thin_sheets_moduli():
    law, across, kept = learned(3), 0, [1, 2]
    flat = plane_strain(law, across)
    assert flat.moduli() == approx(COPPER, rel=1e-8)  # C11, C12, C44 of a cube face
    assert len(flat.group) == 8
    assert flat.certificate.proven >= 0.9 * flat.certificate.sampled > 0
    sheet, solid = (Points.sheet(d * (8,), law.spacing) for d in (2, 3))
    b = noise(sheet, seed=5)
    b -= b.mean(0)
    u = solve(flat, Periodic(sheet, b)).u
    number = np.rint(solid.x[:, kept] / law.spacing).astype(int) @ (8, 1)
    found = solve(law, Periodic(solid, np.insert(b[number], across, 0.0, axis=1))).u
    near(found[:, kept], u[number], 1e-6)
    assert sup(found[:, across]) < 1e-6 * sup(u)
    C11, C12, C44 = COPPER.values()
    sheet = plane_stress(learned(3), 1).moduli()
    near(sheet["C12"], C12 - C12**2 / C11, 1e-8)
    near(sheet["C44"], C44, 1e-8)
    assert elastic.compliance(learned(3).tensor())[0, 1, 0, 1] == approx(1 / C44 / 4)


def body(d, kind):
    n = {2: 12, 3: 6}[d]
    return (
        Points.sheet(d * (n,), 1.5) if kind == "period" else lattice(d, n, 2, ball=kind == "ball")
    )


@in_plane_and_space
@parametrize("kind", ["ball", "period"])
def test_force_and_energy_are_those_of_all_bonds(d, kind, monkeypatch):
    law, points = random_law(d), body(d, kind)
    u, v = normal((2, *points.x.shape))
    v[~points.interior] = 0
    operator = law.on(points)
    force = operator.force(np.stack([v, u]))[1]
    near(operator.energy(u), plain_energy(law, points, u), 1e-10)
    work = law.spacing**d * (force * v[points.interior]).sum()  # exact, for energies are squares
    near(slope(lambda t: plain_energy(law, points, u + t * v), 1.0, order=2), work, 1e-9)
    monkeypatch.setattr("warp_peri.solvers.linear.FFT_BONDS", {2: 0, 3: 0})
    assert_allclose(law.on(points)(u), force, atol=1e-11)
    assert_allclose(operator.matrix() @ u.ravel(), force.ravel(), atol=1e-11)


def test_a_turned_lattice_in_space_has_the_turned_gradient_stress_and_force():
    law, points, turn = learned(3), body(3, "ball"), checked_orientation(25.0, 3)
    stated = replace(points, x=points.x @ turn.T, axis=turn)
    operator, F = law.on(stated), normal((3, 3), 3)
    stress = turn @ np.einsum("ijkl,kl->ij", law.tensor(), (F + F.T) / 2) @ turn.T
    u = stated.x @ (turn @ F @ turn.T).T + [1.0, 2.0, 3.0]
    assert_allclose(operator.stress(u) - stress, 0, atol=1e-12)
    assert_allclose(operator.gradient(u)[0], turn @ F @ turn.T, atol=1e-12)
    u = noise(points, seed=1)
    assert_allclose(operator(u @ turn.T), law.on(points)(u) @ turn.T, atol=1e-11)


def test_how_a_crystal_lies_is_stated_or_its_assumption_said_once():
    law, points, turn = learned(3), body(3, "cube"), checked_orientation(20.0, 3)
    turned = replace(points, x=points.x @ turn.T)
    with warned("how the crystal lies"):
        law.on(turned)
    law.on(turned)  # once for these points
    law.on(replace(turned, axis=turn[:, [1, 2, 0]]))  # a symmetry of the crystal


def test_what_is_wrong_is_named():
    law, flat = random_law(3), np.zeros((2, 2, 2))
    cubic, p = replace(learned(3), certificate=None), body(3, "ball")
    assert_refused({
        "each once": lambda: CrystalMaterial(1.0, np.array([[1, 0], [-1, 0]]), flat),
        "break it":
            lambda: replace(law, tensors=law.tensors * np.where(law.steps[:, :1, None], 2, 1)),
        "expected one of": lambda: point_group("5mm", 2),
        "mirror": lambda: plane_strain(random_law(3, symmetry="-1")),
        "axis 0, 1 or 2": lambda: plane_strain(learned(2)),
        "objective.*per radian": lambda: cubic.on(replace(p, interior=p.interior | True)),
        "spacing": lambda: cubic.on(Points(2 * p.x, p.interior, 3.0)),
        "2 dimensions, the model's": lambda: learned(2).on(p),
        "stands at 20°": lambda: cubic.on(replace(p, axis=checked_orientation(20.0, 3))),
        "expected symmetric matrices": lambda: cubic.on(p).at({"tensors": np.triu(cubic.tensors)}),
        "the operator on these .* nodes is indefinite":
            lambda: (replace(cubic, tensors=-cubic.tensors).on(p).solve(0 * p.x, p.x)),
    })  # fmt: skip
