"""Laws from fields, from phonons, from other laws."""

from dataclasses import replace

import ase
import ase.build
import numpy as np
from ase.calculators.emt import EMT
from ase.calculators.lj import LennardJones
from numpy import cos, eye, nan, pi, sin, sqrt
from numpy.linalg import eigvalsh, norm
from numpy.random import default_rng
from numpy.testing import assert_allclose

import warp_peri as wp
from tests.crystal.crystals import CUBES, cubic_tensor, dispersive, huang_defect, lattice, learned
from tests.support import approx, filterwarnings, in_plane_and_space, near, sup
from tests.support.materials import DEEP
from tests.support.problems import OTHER, kernel, loaded, manufactured, normal
from tests.support.problems import lattice as plane_lattice
from tests.support.told import all_refused, assert_refused, each_refused, refused, warned
from warp_peri.atoms.force_constants import NonAnalyticCorrection, Supercell, from_supercell
from warp_peri.atoms.phonons import from_calculator
from warp_peri.core.elastic import checked_orientation, point_group, voigt
from warp_peri.materials.crystal import crystal_from_lps
from warp_peri.materials.crystal_fit import fit_dispersion, fit_phonons, transfer_to_lattice
from warp_peri.methods import GaussNewton

fit = lambda samples, horizon, **asked: wp.Crystal(horizon, **asked).learn(samples).material
"""The material that is learned."""


@in_plane_and_space
def test_a_law_is_found_again_from_its_forces(d):
    law = learned(d)
    samples = manufactured(law, lattice(d, {2: 12, 3: 5}[d], 2), 8)
    found = fit(samples, law.horizon, symmetry=law.symmetry, moduli=None)
    near(found.tensors, law.tensors, 1e-9)
    assert found.provenance["fit"]["cuts"] == 0
    assert found.certificate.proven >= 0.9 * found.certificate.sampled
    if d == 2:
        given = np.array([[0.2, 0.1, 0], [0.1, 0.2, 0], [0, 0, 0.06]])
        held = fit(samples, law.horizon, symmetry=[*point_group("4mm", 2)], moduli=given)
        assert_allclose(held.elastic_tensor(), given, atol=1e-12)


def test_what_data_tell_is_told_in_single_precision_too():
    """One wave a load, eight in all: no half of them tells the fourteen numbers of 4mm apart."""
    points = plane_lattice(11, 2.5)
    model, rng = kernel("1/r", 2.5), default_rng(0)
    u = cos(points.x @ rng.uniform(-1, 1, (2, 8))).T[..., None] * rng.normal(size=(8, 1, 2))
    samples, found = loaded(model.on(points), u), []
    for kind in (np.float64, np.float32):
        given = replace(samples, u=samples.u.astype(kind), b=samples.b.astype(kind))
        with refused("expected enough to tell 30 numbers without any symmetry"):
            fit(given, 2.5)
        found.append(fit(given, 2.5, symmetry="4mm", moduli=None))
    assert {one.provenance["fit"]["symmetry_ratio"] for one in found} == {None}
    assert_allclose(found[1].elastic_tensor(), found[0].elastic_tensor(), rtol=1e-5, atol=1e-7)


@filterwarnings("ignore:axis. lattice or crystal are turned")  # said once a process
def test_the_symmetry_is_found_and_one_that_is_wrong_costs():
    law, turned, points = learned(2), learned(2, orientation=20.0), lattice(2, 14, 2)
    found = fit(manufactured(law, points, 10), law.horizon, moduli=None)
    assert found.symmetry == "4mm"  # not isotropic: Zener 3.2
    assert found.provenance["fit"]["loss"] < 1e-9
    samples = manufactured(turned, points, 10)
    assert fit(samples, turned.horizon, moduli=None).symmetry == "4"
    with warned(r"contradict what is told: in .* leaves .*% of the loads"):
        wrong = fit(samples, turned.horizon, symmetry="4mm", moduli=None)
    assert wrong.provenance["fit"]["loss"] > 0.01
    assert wrong.provenance["fit"]["symmetry_ratio"] > 1.5


def test_moduli_that_nothing_has_or_tells_are_named():
    law = learned(2)
    samples = manufactured(law, lattice(2, 8, 2), 6)
    of = lambda moduli: fit(samples, 3.0, symmetry="4mm", moduli=moduli)
    C, wrong, u = cubic_tensor(2), cubic_tensor(2, 0.1, 0.2, 0.05), np.triu(np.ones((2, 2)))
    how = {"target": dispersive(C), "tensor": C, "symmetry": "4mm", "spacing": 1.0}
    assert_refused({
        "None or a Voigt matrix, got 'phonons'": lambda: of("phonons"),
        "moduli: expected those of 2 dimensions, got 3": lambda: of(eye(6)),
        "are moduli in TPa": lambda: of(1e3 * voigt(cubic_tensor(2))),
        "expected a linear peridynamic solid, got Crystal": lambda: crystal_from_lps(law, 1.5),
    })  # fmt: skip
    each_refused(lambda given: fit_dispersion(**how | given, horizon=2.5), {
        "stable crystal, got a sound wave": {"tensor": wrong},
        "^target: expected a stable crystal, got a wave": {"target": dispersive(wrong)},
        "^target: expected shape": {"target": lambda k: u},
        "^target: expected symmetric": {"target": lambda k: dispersive(C)(k) * u},
        "^tensor: expected C_ijkl": {"tensor": C * u},
        "^moduli: expected symmetric": {"tensor": C * C[..., :1, :1]},
        "^tensor: expected shape": {"tensor": u},
        "^tensor, orientation: expected": {"tensor": None},
        "^stress: expected": {"stress": u},
        "^largest_wave: expected": {"largest_wave": -2.0},
        "^record: expected": {"record": {"a": nan}},
    } | {f"^tensor: .* off {off} times": {"tensor": by * C}
         for off, by in {"3": 3.0, "4": 0.25, r"1e\+03": 1e-3}.items()})  # fmt: skip
    with warned("of the symbol, .* off by up to 2 times"):
        fit_dispersion(**how | {"tensor": 2.0 * C}, horizon=2.5)
    noise = 0.5 * samples.b.std() * normal(samples.b.shape)
    with warned("moduli: those of the longest waves leave .*%"):
        found = fit(replace(samples, b=samples.b + noise), law.horizon, symmetry="4mm")
    assert found.provenance["fit"]["long_wave_misfit"] > 0.1


def test_a_crystal_from_phonons_alone_and_of_too_few_bonds():
    atoms = from_calculator(ase.build.bulk("Cu", "fcc", a=3.59, cubic=True), EMT(), (3, 3, 3))
    assert len(atoms.group()) == 48
    law = fit_phonons(atoms, 3.59, 3.59 * 6**0.5)
    assert law.symmetry == "m-3m"
    assert_allclose(law.elastic_tensor(), voigt(atoms.elastic(CUBES)), rtol=1e-6, atol=1e-9)
    e = [[1, 0, 0], [1, 1, 0], [1, 1, 1]] / sqrt([[1], [2], [3]])
    k = np.concatenate([size * e for size in (0.1, 0.25, pi / 2 / 3.59)])
    own, true = (eigvalsh(D) for D in (law.symbol(k), atoms.effective(k)))
    assert sup(sqrt(own / true) - 1) < 0.03
    with warned("with 6 bonds they are up to .*% of the largest away"):
        fit_phonons(atoms, 3.59, 3.59, symmetry="m-3m")


def test_a_larger_cell_of_the_same_crystal_has_the_same_symbol():
    """n atoms eliminated onto their mean: the cubic cell of four against the primitive one."""
    pull = LennardJones(sigma=2.3, epsilon=0.4, ro=3.0, rc=4.0, smooth=True)
    small, large = (ase.build.bulk("Cu", "fcc", a=3.59, cubic=cubic) for cubic in (False, True))
    one, four = (from_calculator(cell, pull, (n, n, n)) for cell, n in ((small, 5), (large, 3)))
    k = normal((6, 3)) * 0.4
    assert_allclose(four.effective(k), one.effective(k), rtol=1e-7, atol=1e-10)


def test_a_piezoelectric_crystal_is_refused():
    """Zinc blende of springs and charges: no elastic tensor has the stiffness of its long waves."""
    cell = ase.build.bulk("ZnS", "zincblende", a=5.4, cubic=True)
    box, every = cell.repeat((2, 2, 2)), range(8)
    far = box.get_all_distances(mic=True, vector=True)[:8]
    size = norm(far, axis=-1)
    bonded = (size > 0.1) & (size < np.min(size[size > 0.1]) * 1.5)
    e = far / np.maximum(size, 1e-9)[..., None]
    spring = -4.0 * bonded[..., None, None] * (0.2 * eye(3) + e[..., :, None] * e[..., None, :])
    spring[every, every] -= spring.sum(1)
    born = np.tile([1.5, -1.5], 4)[:, None, None] * eye(3)
    exact = NonAnalyticCorrection(born, 2.0 * eye(3), decay=2.2)
    field = Supercell(cell, box, every, polar=exact).field_of_ions()
    polar = NonAnalyticCorrection(born, 2.0 * eye(3))
    whole = from_supercell(cell, box, spring + field, every, polar=polar)
    ends = lambda x: polar.at_long_waves(x, x)
    for way in whole.effective, ends, lambda x: polar.matrix(eye(3), eye(3), x):
        all_refused(way, "^(k|e|positions): expected", ([[1j, 0, 0]], [[True] * 3], [1.0]))
    assert_refused({
        "piezoelectric": lambda: whole.elastic(CUBES),
        "dielectric: .* symmetric": tuple(
            lambda size=size: replace(polar, dielectric=size * np.tri(3)) for size in (1.0, 1e-3)
        ),
        "decay: expected": lambda: replace(polar, decay=-1.0),
    })  # fmt: skip


def test_a_crystal_held_under_stress_keeps_its_moduli_apart():
    tensor, stress = cubic_tensor(2), np.array([[0.02, 0.004], [0.004, -0.01]])

    def symbol(k):
        held = np.einsum("nk,nl,kl->n", k, k, stress)
        return dispersive(tensor)(k) + held[:, None, None] * eye(2)

    law = fit_dispersion(symbol, 1.5, 3.75, symmetry="1", tensor=tensor, stress=stress)
    assert_allclose(law.tensor(), tensor, atol=1e-12)
    assert huang_defect(law) < 1e-10
    k = 1e-4 * normal((4, 2), 2)
    assert_allclose(law.symbol(k), symbol(k), rtol=1e-5, atol=1e-14)
    again = law.in_units(OTHER)
    assert_allclose(again.stress, 1e3 * stress)
    assert again.elastic_tensor()[0, 0] == approx(170.0)
    turned = transfer_to_lattice(law, 1.5, rotation=90.0)
    assert_allclose(turned.stress, [[-0.01, -0.004], [-0.004, 0.02]], atol=1e-12)


def test_a_law_on_other_nodes_answers_smooth_waves_alike_and_a_turned_one_is_turned():
    law = learned(2)
    finer = transfer_to_lattice(law, 1.2)
    assert finer.moduli() == approx(law.moduli(), rel=1e-8)
    k = normal((20, 2), 1)
    k *= 0.6 / norm(k, axis=1)[:, None]
    assert sup(np.linalg.solve(finer.symbol(k), law.symbol(k)) - eye(2)) < 0.02
    # a quarter turn is exact, in space too; others are a fit with the turned moduli
    for law in (learned(2), learned(3)):
        quarter = checked_orientation(90.0, law.dimension)
        same = transfer_to_lattice(law, law.spacing, rotation=np.rint(quarter))
        k = normal((5, law.dimension), 2)
        assert_allclose(same.symbol(k @ quarter.T), quarter @ law.symbol(k) @ quarter.T, atol=1e-12)
    turned = transfer_to_lattice(learned(2), 1.5, rotation=checked_orientation(20.0, 2))
    assert_allclose(turned.tensor(), learned(2, orientation=20.0).tensor(), atol=1e-9)
    assert abs(turned.elastic_tensor()[0, 2]) > 0.01
    assert turned.certificate.holds


def test_a_solid_in_space_is_found_again_with_its_proof_and_moduli_are_held():
    """From rough and smooth fields on a period, and the loads that it answers them with."""
    law, points = crystal_from_lps(DEEP, 1.0), wp.Points.sheet((10, 10, 10), 1.0)
    random = default_rng(0)
    k = 2 * pi / 10 * random.integers(-2, 3, size=(4, 3))
    u = random.normal(size=(4, 1000, 3)) + 10 * sin(points.x @ k.T).T[:, :, None]
    samples = loaded(law.on(points), u)
    fit = wp.fit(samples, wp.LPS(2.0, wp.Bernstein(2)))
    near(fit.material.lam, 0.5, 1e-6)
    found, influence = (one.influence(np.linspace(0.5, 2.0, 9)) for one in (fit.material, DEEP))
    assert_allclose(found / found[0], influence / influence[0], rtol=1e-6)
    assert fit.certificate.symbol_bound == approx(law.certificate.proven)
    for held in ("isotropic", (0.5, 0.8)):
        fit = wp.fit(samples, wp.LPS(2.0, wp.Bernstein(2), method=GaussNewton(moduli=held)))
        C = crystal_from_lps(fit.material, 1.0).moduli()
        assert C["C11"] - C["C12"] == approx(2 * C["C44"])
        assert held == "isotropic" or (C["C12"], C["C44"]) == approx(held)
