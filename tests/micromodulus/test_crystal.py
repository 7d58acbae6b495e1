"""The law itself: symmetry, symbol, moduli, units and files."""

import numpy as np
import pytest

import warp_peri
from tests.micromodulus.crystals import (
    COPPER,
    cubic_tensor,
    huang_defect,
    lattice,
    learned,
    random_law,
)
from warp_peri.core import elastic
from warp_peri.core.groups import checked_orientation, name_of, point_group, shared_with_nodes
from warp_peri.core.stencil import invariant_basis, q1_tensors
from warp_peri.errors import InputError
from warp_peri.materials.crystal import Crystal
from warp_peri.materials.crystal_fit import plane_strain, plane_stress


@pytest.mark.parametrize(
    ("name", "d", "reach", "bonds", "numbers"),
    [
        ("4mm", 2, 2.5, 20, 9),
        ("4mm", 2, 3.0, 28, 13),
        ("1", 2, 2.0, 12, 18),
        ("m-3m", 3, 2**0.5, 18, 5),
        ("m3m", 3, 2.0, 32, 9),
        ("m-3m", 3, 6**0.5, 80, 17),
        ("m-3m", 3, 3.0, 122, 26),
        ("-1", 3, 2**0.5, 18, 54),
    ],
)
def test_numbers_of_a_family(name, d, reach, bonds, numbers):
    found = invariant_basis(reach, shared_with_nodes(point_group(name, d), np.eye(d)))
    assert (2 * len(found.steps), len(found.basis)) == (bonds, numbers)


@pytest.mark.parametrize(
    ("name", "d", "order"), [("6mm", 2, 12), ("m-3m", 3, 48), ("6/mmm", 3, 24), ("23", 3, 24)]
)
def test_groups_hold_their_inversion(name, d, order):
    group = point_group(name, d)
    assert len(group) == order
    assert np.abs(group + np.eye(d)).max(axis=(1, 2)).min() < 1e-12


def test_degrees_turn_the_first_axis_of_a_crystal_towards_the_second():
    for d in (2, 3):
        turned = checked_orientation(30.0, d) @ np.eye(d)[0]
        np.testing.assert_allclose(turned[:2], [np.sqrt(0.75), 0.5], rtol=1e-15)


def test_a_turned_crystal_shares_less_with_its_nodes():
    turn = np.deg2rad(20)
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    assert len(shared_with_nodes(point_group("4mm", 2), R)) == 4  # quarter turns alone
    assert len(shared_with_nodes(point_group("2mm", 2), R)) == 2


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
    k = 1e-4 * np.random.default_rng(2).normal(size=(4, d))
    local = np.einsum("ijkl,nj,nl->nik", law.tensor(), k, k)
    np.testing.assert_allclose(law.symbol(k), local, rtol=1e-5, atol=1e-14)
    assert law.describe()["symmetry"] == ("square" if d == 2 else "cubic")
    assert law.describe()["zener"] == pytest.approx(2 * 0.076 / 0.048)


def test_brackets_and_elastic_tensors_are_inverse_to_one_another():
    rng = np.random.default_rng(3)
    matrix = rng.normal(size=(6, 6))
    C = elastic.from_voigt(matrix + matrix.T)
    again = elastic.elastic_from_brackets(elastic.brackets_from_elastic(C))
    np.testing.assert_allclose(again, C, atol=1e-12)
    np.testing.assert_allclose(elastic.voigt(C), matrix + matrix.T, atol=1e-12)


def test_directional_moduli_and_anisotropy():
    C = cubic_tensor(3)
    axes = np.eye(3)
    C11, C12, C44 = COPPER.values()
    E, nu = elastic.directional(C, axes[0], axes[1])
    assert E == pytest.approx((C11 - C12) * (C11 + 2 * C12) / (C11 + C12))
    assert nu == pytest.approx(C12 / (C11 + C12))
    zener = 2 * C44 / (C11 - C12)
    assert elastic.universal_anisotropy(C) == pytest.approx(6 / 5 * (zener**0.5 - zener**-0.5) ** 2)
    isotropic = cubic_tensor(3, 3.0, 1.0, 1.0)
    assert elastic.universal_anisotropy(isotropic) == pytest.approx(0, abs=1e-12)
    assert elastic.named_symmetry(isotropic) == "isotropic"
    lam, mu = 1.0, 1.0  # of plane stress λ becomes 2 λ μ/(λ + 2 μ)
    assert elastic.plane_stress(isotropic)[0, 0, 1, 1] == pytest.approx(
        2 * lam * mu / (lam + 2 * mu)
    )


def test_extremes_bound_every_direction_and_are_met():
    C = cubic_tensor(3)
    E, nu = elastic.extremes(C)
    edge, corner = np.array([1.0, 1, 0]) / 2**0.5, np.array([1.0, 1, 1]) / 3**0.5
    assert E[0] == pytest.approx(elastic.directional(C, np.eye(3)[0], np.eye(3)[1])[0])
    assert E[1] == pytest.approx(elastic.directional(C, corner, np.array([1, -1, 0]) / 2**0.5)[0])
    assert nu[0] == pytest.approx(elastic.directional(C, edge, np.array([1, -1, 0]) / 2**0.5)[1])
    assert nu[1] == pytest.approx(elastic.directional(C, edge, np.eye(3)[2])[1])
    rng = np.random.default_rng(0)
    matrix = rng.normal(size=(6, 6))
    C = elastic.from_voigt(matrix @ matrix.T + np.eye(6))
    E, nu = elastic.extremes(C)
    frames = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(2000)]
    some = np.array([elastic.directional(C, Q[0], Q[1]) for Q in frames])
    for (low, high), values in zip((E, nu), some.T):
        room = 0.01 * (high - low)
        assert low - 0.02 * room <= values.min()
        assert values.max() <= high + 0.02 * room
    flat = cubic_tensor(2)
    E, _ = elastic.extremes(flat)
    diagonal = np.array([[1.0, 1], [-1, 1]]) / 2**0.5
    ends = [elastic.directional(flat, *axes)[0] for axes in (np.eye(2), diagonal)]
    assert E == pytest.approx(sorted(ends))


@pytest.mark.parametrize("d", [2, 3])
def test_a_turned_crystal_is_told_in_its_own_axes(d):
    law = learned(d)
    told, turned = law.describe("GPa"), learned(d, orientation=20.0).describe("GPa")
    for key in ("symmetry", "moduli", "zener", "universal_anisotropy"):
        expected = told[key] if isinstance(told[key], str) else pytest.approx(told[key], rel=1e-8)
        assert turned[key] == expected
    assert turned["E_range"] == pytest.approx(told["E_range"], rel=1e-8)
    assert turned["nu_range"] == pytest.approx(told["nu_range"], rel=1e-8)


def test_zener_is_of_cubic_crystals_alone():
    matrix = np.diag([3.0, 3.0, 4.0, 1.0, 1.0, 1.2])
    matrix[:3, :3] += 1 - np.eye(3)
    steps, tensors = q1_tensors(elastic.from_voigt(matrix))
    told = Crystal(1.0, steps, tensors).describe()
    assert told["symmetry"] == "tetragonal"
    assert told["zener"] is None


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
    C = elastic.from_voigt(matrix @ matrix.T + np.eye(len(matrix)))
    law = Crystal(2.0, *(lambda s, t: (s, t / 4.0))(*q1_tensors(C)))
    np.testing.assert_allclose(law.tensor(), C, atol=1e-10)
    assert huang_defect(law) < 1e-12


@pytest.mark.parametrize("d", [2, 3])
def test_surface_traction_is_half_the_cauchy_defect(d):
    assert learned(d)._surface_traction() == pytest.approx(abs(0.122 - 0.076) / 2, rel=1e-8)


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
    with pytest.raises(InputError, match="each once"):
        Crystal(1.0, np.array([[1, 0], [-1, 0]]), np.zeros((2, 2, 2)))
    with pytest.raises(InputError, match="symmetric"):
        Crystal(1.0, np.array([[1, 0]]), np.array([[[1.0, 2.0], [0.0, 1.0]]]))
    skew = law.tensors.copy()
    skew[0, 0, 0] += 1.0
    with pytest.raises(InputError, match="break it"):
        Crystal(1.0, law.steps, skew, symmetry="m-3m")
    with pytest.raises(InputError, match="expected one of"):
        point_group("5mm", 2)
