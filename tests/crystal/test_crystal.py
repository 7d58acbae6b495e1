"""The law itself: symmetry, symbol, moduli, units and files."""

import numpy as np
import pytest

import warp_peri
from tests.crystal.crystals import COPPER, cubic_tensor, huang_defect, lattice, learned, random_law
from warp_peri.core import elastic
from warp_peri.core.groups import checked_orientation, name_of, point_group, shared_with_nodes
from warp_peri.core.stencil import invariant_basis, q1_tensors
from warp_peri.errors import InputError
from warp_peri.materials.crystal import CrystalMaterial
from warp_peri.materials.crystal_fit import plane_strain, plane_stress


@pytest.mark.parametrize(
    ("name", "d", "reach", "bonds", "numbers"),
    [("1", 2, 2.0, 12, 18), ("m-3m", 3, 6**0.5, 80, 17), ("-1", 3, 2**0.5, 18, 54)],
)
def test_numbers_of_a_family(name, d, reach, bonds, numbers):
    found = invariant_basis(reach, shared_with_nodes(point_group(name, d), np.eye(d)))
    assert (2 * len(found.steps), len(found.basis)) == (bonds, numbers)


@pytest.mark.parametrize("d", [2, 3])
def test_symbol_is_the_sum_over_all_bonds(d):
    law = random_law(d)
    k = np.random.default_rng(1).normal(size=(5, d))
    xi = law.spacing * np.concatenate([law.steps, -law.steps])
    C = np.concatenate([law.tensors] * 2)
    plain = np.einsum("nij,kn->kij", C, 1 - np.cos(k @ xi.T))
    np.testing.assert_allclose(law.symbol(k), plain, rtol=1e-12, atol=1e-12)
    g = law.group[3]
    turned = g @ law.symbol(k) @ g.T
    np.testing.assert_allclose(law.symbol(k @ g.T), turned, rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize("d", [2, 3])
def test_moduli_are_those_of_long_waves(d):
    law = learned(d)
    assert huang_defect(law) < 1e-10
    assert law.moduli() == pytest.approx(COPPER, rel=1e-8)
    assert law.moduli("GPa")["C44"] == pytest.approx(76.0, rel=1e-8)
    assert law.in_units(("nm", "GPa")).moduli() == pytest.approx(law.moduli("GPa"), rel=1e-8)
    k = 1e-4 * np.random.default_rng(2).normal(size=(4, d))
    local = np.einsum("ijkl,nj,nl->nik", law.tensor(), k, k)
    np.testing.assert_allclose(law.symbol(k), local, rtol=1e-5, atol=1e-14)
    assert law._surface_traction() == pytest.approx(abs(0.122 - 0.076) / 2, rel=1e-8)
    assert law.describe()["symmetry"] == ("square" if d == 2 else "cubic")
    assert law.describe()["zener"] == pytest.approx(2 * 0.076 / 0.048)


def test_extremes_of_directional_moduli_of_a_cubic_crystal():
    """Young's modulus along edges and corners, Poisson's number of a face's diagonal."""
    C11, C12, C44 = COPPER.values()
    S11, S12 = np.array([C11 + C12, -C12]) / (C11 - C12) / (C11 + 2 * C12)
    J = S11 - S12 - 1 / C44 / 2
    young, poisson = elastic.extremes(cubic_tensor(3))
    assert young == pytest.approx([1 / S11, 1 / (S11 - 2 * J / 3)])
    assert poisson == pytest.approx(np.array([S12 + J / 2, S12]) / (J / 2 - S11))
    lam, mu = 1.0, 1.0  # of plane stress λ becomes 2 λ μ/(λ + 2 μ)
    sheet = elastic.plane_stress(cubic_tensor(3, 3.0, 1.0, 1.0))
    assert sheet[0, 0, 1, 1] == pytest.approx(2 * lam * mu / (lam + 2 * mu))


@pytest.mark.parametrize("d", [2, 3])
def test_a_turned_crystal_is_told_in_its_own_axes(d):
    axis = checked_orientation(30.0, d) @ np.eye(d)[0]  # turned towards the second one
    np.testing.assert_allclose(axis[:2], [np.sqrt(0.75), 0.5], rtol=1e-15)
    told, turned = learned(d).describe("GPa"), learned(d, orientation=20.0).describe("GPa")
    assert turned["symmetry"] == told["symmetry"]
    for key in ("moduli", "zener", "E_range", "nu_range"):
        assert turned[key] == pytest.approx(told[key], rel=1e-8)


@pytest.mark.parametrize(("name", "d"), [("4mm", 2), ("6mm", 2), ("m-3m", 3), ("6/mmm", 3)])
def test_a_group_is_known_by_its_rotations(name, d):
    group = point_group(name, d)
    assert name_of(group[::-1]) == name
    turn = checked_orientation(10.0, d)
    np.testing.assert_array_equal(name_of(turn @ group @ turn.T), turn @ group @ turn.T)


@pytest.mark.parametrize("d", [2, 3])
def test_elements_have_the_moduli_of_their_solid(d):
    rng = np.random.default_rng(4)
    matrix = rng.normal(size=(3, 3) if d == 2 else (6, 6))
    C = elastic.voigt_to_tensor(matrix @ matrix.T + np.eye(len(matrix)))
    law = CrystalMaterial(2.0, *(lambda s, t: (s, t / 4.0))(*q1_tensors(C)))
    np.testing.assert_allclose(law.tensor(), C, atol=1e-10)
    assert huang_defect(law) < 1e-12


@pytest.mark.parametrize("normal", [0, 2])
def test_plane_strain_is_what_the_law_in_space_does_with_fields_of_the_plane(normal):
    law = learned(3)
    flat = plane_strain(law, normal)
    kept = [a for a in range(3) if a != normal]
    assert flat.moduli() == pytest.approx(COPPER, rel=1e-8)  # C11, C12, C44 of a cube face
    assert len(flat.group) == 8
    assert flat.certificate.proven >= 0.9 * flat.certificate.sampled > 0
    sheet = lattice(2, 8, 0, box=True)
    rng = np.random.default_rng(5)
    b = rng.normal(size=sheet.x.shape)
    b -= b.mean(axis=0)
    u = warp_peri.solve(flat, warp_peri.Periodic(sheet, b)).u
    solid = lattice(3, 8, 0, box=True)
    number = np.rint(solid.x[:, kept] / law.spacing).astype(int) @ (8, 1)
    load = np.zeros_like(solid.x)
    load[:, kept] = b[number]
    found = warp_peri.solve(law, warp_peri.Periodic(solid, load)).u
    np.testing.assert_allclose(found[:, kept], u[number], atol=1e-6 * np.abs(u).max())
    assert np.abs(found[:, normal]).max() < 1e-6 * np.abs(u).max()


def test_plane_stress_has_the_moduli_of_a_thin_sheet_and_low_axes_are_refused():
    law = learned(3)
    C11, C12, C44 = COPPER.values()
    sheet = plane_stress(law, 1).moduli()
    assert sheet["C12"] == pytest.approx(C12 - C12**2 / C11, rel=1e-8)
    assert sheet["C44"] == pytest.approx(C44, rel=1e-8)
    with pytest.raises(InputError, match="mirror"):
        plane_strain(random_law(3, symmetry="-1"))
    with pytest.raises(InputError, match="axis 0, 1 or 2"):
        plane_strain(learned(2))


def test_what_is_wrong_is_named():
    law = random_law(3)
    skew = law.tensors.copy()
    skew[0, 0, 0] += 1.0
    for words, given in (
        ("each once", (np.array([[1, 0], [-1, 0]]), np.zeros((2, 2, 2)))),
        ("symmetric", (np.array([[1, 0]]), np.array([[[1.0, 2.0], [0.0, 1.0]]]))),
        ("break it", (law.steps, skew)),
    ):
        with pytest.raises(InputError, match=words):
            CrystalMaterial(1.0, *given, symmetry="m-3m" if words == "break it" else "")
    with pytest.raises(InputError, match="expected one of"):
        point_group("5mm", 2)
