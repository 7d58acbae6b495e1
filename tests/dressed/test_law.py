"""The law itself: parts, learning, proof, files."""

from dataclasses import replace

import numpy as np
import pytest
from ase.build import bulk
from ase.calculators.emt import EMT

import warp_peri as wp
from tests.dressed.solids import SPACING, solid
from tests.micromodulus.crystals import cubic_tensor, lattice
from tests.micromodulus.test_learning import waves
from warp_peri.core.groups import point_group
from warp_peri.core.stencil import q1_tensors
from warp_peri.dressed.law import DressedSolid, _dressing, _Monomials, from_phonons, transferred
from warp_peri.dressed.sweeps import base, bonds, dilatation_range, half
from warp_peri.errors import InputError
from warp_peri.micromodulus.force_constants import from_calculator
from warp_peri.micromodulus.law import tensors_of
from warp_peri.micromodulus.waves import from_phonons as tensors_from_phonons

SHEET = dict(C11=1.25, C12=-0.2, C44=0.725)


@pytest.mark.parametrize("d", [2, 3])
def test_elements_are_those_of_one_stencil(d):
    C = cubic_tensor(d)
    parts = base("elements", C)
    assert parts.names == ("tetragonal", "shear", "bulk")
    for M in parts.parts:
        assert np.linalg.eigvalsh(M)[0] > -1e-15
    steps, tensors = half(parts.stencils.sum(axis=0))
    order = {tuple(s): t for s, t in zip(*q1_tensors(C))}
    order |= {tuple(-s for s in key): t for key, t in list(order.items())}
    for step, tensor in zip(steps.tolist(), tensors):
        np.testing.assert_allclose(tensor, order[tuple(step)], atol=1e-14)


def test_bonds_are_the_peridynamic_solid_of_two_spacings():
    C = cubic_tensor(2, **SHEET)
    model = wp.Model(lam=-0.2, mu=0.725, alpha=1.0, D=np.ones(1), horizon=2.0)
    expected = tensors_of(model, 1.0)
    steps, tensors = half(base("bonds", C).stencils.sum(axis=0))
    k = np.random.default_rng(0).normal(size=(20, 2))
    own = 2 * np.tensordot(1 - np.cos(k @ steps.T), tensors, 1)
    np.testing.assert_allclose(own, expected.symbol(k), atol=1e-13)
    with pytest.raises(InputError, match="expected an isotropic sheet, got a crystal"):
        base("bonds", cubic_tensor(2), 0.2)


@pytest.mark.parametrize(("lam", "side"), [(-0.2, 1), (-0.2, -1), (0.5, 1)])
def test_two_functions_may_break_as_far_as_is_said(lam, side):
    """θ² ≤ 4 M q (theory, Dr26): what one node's bonds store has a negative value beyond."""
    C = cubic_tensor(2, C11=lam + 1.45, C12=lam, C44=0.725)
    for over in (0.999, 1.001):
        one = bonds(C, 1 / 8 + side * over * dilatation_range(C))
        least = np.linalg.eigvalsh(np.tensordot(one.moduli, one.parts, 1))[0]
        assert (least > 0) == (over < 1)
        steps, tensors = half(one.stencils.sum(axis=0))
        k = 1e-3 * np.array([0.8, 0.6])
        own = 2 * np.tensordot(1 - np.cos(k @ steps.T), tensors, 1)
        np.testing.assert_allclose(own, np.einsum("ijkl,j,l->ik", C, k, k), atol=1e-11)
    with pytest.raises(InputError, match=r"dilatation: expected a weight within 0\.\d+ of 0\.125"):
        base("bonds", C, 1 / 8 + side * 1.001 * dilatation_range(C))
    hard = cubic_tensor(2, C11=2.3, C12=0.8, C44=0.75)
    one = bonds(hard, -3.0)
    assert np.linalg.eigvalsh(np.tensordot(one.moduli, one.parts, 1))[0] > 0


def test_two_functions_are_found_again(tmp_path):
    law = solid(2, "bonds", 2**0.5, 0.02, dilatation=0.16)
    samples = waves(law, lattice(2, 10, 6, SPACING), 6)
    asked = wp.Dressed("bonds", 8, law.symmetry, moduli=law.elastic, two_functions=True)
    fit = wp.fit(samples, asked)
    assert fit.material.dilatation == pytest.approx(0.16, abs=1e-7)
    assert (
        fit.history["numbers"]
        == 1 + wp.fit(samples, replace(asked, two_functions=False)).history["numbers"]
    )
    np.testing.assert_allclose(fit.material.tensors, law.tensors, atol=1e-7)
    wp.save(tmp_path / "m.json", fit.material)
    assert wp.load(tmp_path / "m.json").dilatation == fit.material.dilatation
    assert transferred(fit.material, 0.9 * SPACING).dilatation != 1 / 8
    for wrong in ({"base": "elements"}, {"split": True}):
        with pytest.raises(InputError, match="two_functions: expected a base of bonds"):
            wp.fit(samples, replace(asked, **wrong))


@pytest.mark.parametrize(
    ("d", "kind", "neighbours", "split"),
    [(2, "elements", 8, False), (2, "bonds", 12, False), (3, "elements", 6, True)],
)
def test_a_law_is_found_again_from_its_forces(d, kind, neighbours, split):
    reach = {8: 2**0.5, 12: 2.0, 6: 1.0}[neighbours]
    law = solid(d, kind, reach, 0.02, split)
    samples = waves(law, lattice(d, {2: 10, 3: 3}[d], {2: 6, 3: 3}[d], SPACING), 6)
    asked = wp.Dressed(kind, neighbours, law.symmetry, moduli=law.elastic, split=split)
    fit = wp.fit(samples, asked)
    np.testing.assert_allclose(fit.material.tensors, law.tensors, atol=1e-9)
    assert fit.history["loss"] < 1e-9 < fit.history["loss_of_base"]
    assert fit.certificate.proven > 0.9 * fit.certificate.sampled
    with pytest.raises(InputError, match="numbers apart"):
        wp.fit(wp.Samples(samples.points, 0 * samples.u + samples.points.x, samples.b), asked)


def test_moduli_are_those_of_long_waves_and_stay():
    law = solid(2, "bonds")
    samples = waves(law, lattice(2, 24, 4, SPACING), 12)
    found = wp.fit(samples, wp.Dressed("bonds", 8)).material
    for name, value in law.moduli().items():
        assert found.moduli()[name] == pytest.approx(value, abs=0.05)
    np.testing.assert_allclose(found.crystal.elastic_tensor(), found.elastic, atol=1e-12)


def test_a_crystal_is_learned_from_phonons():
    """Split dressing beats elements by far, with the elastic constants of the atoms."""
    atoms = from_calculator(bulk("Cu", "fcc", a=3.59, cubic=True), EMT(), (3, 3, 3))
    law = from_phonons(atoms, 3.59, neighbours=18, symmetry="m-3m")
    tensors = tensors_from_phonons(atoms, 3.59, 3.59 * 2, symmetry="m-3m")
    for name, value in tensors.moduli().items():
        assert law.moduli()[name] == pytest.approx(value, rel=1e-8)
    record = law.provenance["fit"]
    assert record["numbers"] == 15
    assert record["loss"] < 0.25 * record["loss_of_base"]
    assert law.certificate.proven > 0.9 * law.certificate.sampled
    k = np.array([[0.3, 0.1, 0.2]])
    true = atoms.effective(k)
    bare = replace(law, tensors=0 * law.tensors)
    off, alone = (np.abs(one.symbol(k) - true).max() / np.abs(true).max() for one in (law, bare))
    assert off < 0.02 < 0.2 * alone


def test_a_law_is_carried_to_other_nodes():
    """To its own spacing it is itself; to others it answers long waves as at home."""
    law = solid(2, "elements", size=0.01)
    lifted = np.where(np.abs(law.steps).sum(axis=1) == 1, -0.12, 0.034)  # about graphene's
    law = replace(law, tensors=law.tensors + lifted[None, :, None, None] * np.eye(2))
    same = transferred(law, SPACING)
    np.testing.assert_allclose(same.tensors, law.tensors, atol=1e-6)
    k = 0.5 / SPACING * np.array([[1.0, 0.0], [0.6, 0.8]])
    for spacing, turn in ((0.8 * SPACING, None), (1.4 * SPACING, None), (SPACING, 90.0)):
        there = transferred(law, spacing, rotation=turn)
        assert there.spacing == spacing
        np.testing.assert_allclose(there.symbol(k), law.symbol(k), rtol=0.02, atol=0.01)
        np.testing.assert_allclose(there.elastic, law.elastic, atol=1e-12)
        assert there.certificate.proven > 0.9 * there.certificate.sampled
    turned = transferred(law, SPACING, rotation=30.0)
    bare = replace(turned, tensors=0 * turned.tensors)
    R = np.array([[3**0.5, -1], [1, 3**0.5]]) / 2
    k = 2 * k  # of six spacings
    expected = R @ law.symbol(k @ R) @ R.T
    off, alone = (np.abs(one.symbol(k) - expected).max() for one in (turned, bare))
    assert off < 0.2 * alone
    with pytest.raises(InputError, match="neighbours: expected one of 4, 8, 12, 20"):
        transferred(law, SPACING, neighbours=7)


def test_nodes_that_state_another_axis_are_refused():
    law = solid()
    points = lattice(2, 4, 3, SPACING)
    turned = wp.Points(points.x, points.interior, SPACING, axis=20.0)
    with pytest.raises(InputError, match="axis: the crystal stands at 20°"):
        law.on(turned)
    with pytest.raises(InputError, match="axis: the crystal stands at 20°"):
        law.on(turned, edges=True)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"base": "springs"}, "base: expected one of elements, bonds"),
        ({"elastic": np.diag([1.0, 1.0, -1.0])}, "expected a stable crystal"),
        ({"tensors": np.zeros((1, 3, 2, 2))}, "tensors: expected shape"),
        ({"tensors": np.zeros((2, 4, 2, 2))}, "one for each of tetragonal, shear, bulk, got 2"),
        ({"steps": [[0.5, 1]]}, "steps: expected whole numbers"),
        ({"spacing": -1.0}, "spacing: expected a number > 0"),
        ({"dilatation": 0.2}, "dilatation: expected a base of bonds, got elements"),
    ],
)
def test_numbers_that_are_no_law_are_refused(change, message):
    law = solid()
    fields = {"spacing": SPACING, "base": "elements", "elastic": law.elastic, "steps": law.steps}
    with pytest.raises(InputError, match=message):
        DressedSolid(**(fields | {"tensors": law.tensors} | change))


def test_a_poorer_law_has_a_smaller_dressing():
    assert [wp.Dressed(neighbours=n).poorer().neighbours for n in (20, 8, 26)] == [12, 4, 18]
    with pytest.raises(InputError, match="more than the fewest, got 6"):
        wp.Dressed(neighbours=6).poorer()


@pytest.mark.parametrize(
    ("kind", "split", "two"), [("elements", True, False), ("bonds", False, True)]
)
def test_slopes_are_those_of_central_differences(kind, split, two):
    C = cubic_tensor(2, **SHEET)
    dressing = _dressing(8, point_group("4mm", 2).astype(int))
    found = _Monomials(kind, C, dressing, split, 1.0, two)
    x = 0.05 * np.random.default_rng(0).normal(size=len(found.bases) * found.count + two)
    step = 1e-5 * np.eye(len(x))
    slopes = [(found.coefficients(x + e) - found.coefficients(x - e)) / 2e-5 for e in step]
    np.testing.assert_allclose(found.slopes(x), np.transpose(slopes), atol=1e-10)
