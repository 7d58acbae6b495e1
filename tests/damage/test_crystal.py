"""Crystals whose bonds break: their tensors, what their planes cost, and where they cleave."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import warp_peri as wp
import warp_peri.damage.slow_growth as slow
from tests.support.bodies import random_breaking
from warp_peri import InputError
from warp_peri.core.elastic import from_voigt, turned, voigt
from warp_peri.damage import BrittleCrystal, Cracked, CrystalBonds, box, lattice_body
from warp_peri.damage.operator import bond_matrix, bonds_of
from warp_peri.points.families import bond_classes

SLANTED = np.array([[1, 1, -2], [1, 1, 1], [1, -1, 0]]) / np.sqrt([[6], [3], [2]])
PLANE = np.ix_([0, 1, 5], [0, 1, 5])
CUBIC = {"silicon": (151.4, 76.4, 56.4), "tungsten": (522.0, 204.0, 161.0), "soft": (200.0, 20, 70)}
"""C11, C12, C44; of the last C12 < C44, so that the dilatation takes something away."""
ANGLES = np.radians([0, 30, 60, 90, 120, 150])


def moduli(name, d, turn=SLANTED):
    C11, C12, C44 = CUBIC[name]
    C = np.diag([C11] * 3 + [C44] * 3)
    C[:3, :3] += C12 * (1 - np.eye(3))
    C = voigt(turned(from_voigt(C), turn))
    C = (C + C.T) / 2
    return C[PLANE] if d == 2 else C


def brittle(name="tungsten", horizon=4.0, **options):
    """In plane strain; planes across 90° cost 1, across 0° 1.1, the others 1.3."""
    normals = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])
    energies = np.array([1.1, 1.3, 1.3, 1.0, 1.3, 1.3])
    return BrittleCrystal(CrystalBonds(moduli(name, 2), horizon), 1.0, normals, energies, **options)


@pytest.mark.parametrize("d", [2, 3])
def test_an_isotropic_crystal_is_the_linear_peridynamic_solid(d):
    lam, mu = 0.4, 0.8
    C = np.diag([lam + 2 * mu] * d + [mu] * (2 * d - 3))
    C[:d, :d] += lam * (1 - np.eye(d))
    crystal, classes = CrystalBonds(C, 3.0), bond_classes(1.0, 3.0, dimension=d)
    model = wp.Model(lam, mu, 1.0, [1.0], 3.0, dimension=d)
    for own, its in zip(crystal.bonds(classes), bonds_of(model, classes)):
        np.testing.assert_allclose(own, its, rtol=1e-10)
    assert crystal.largest_stiffness(classes) == pytest.approx(
        wp.damage.solid.largest_stiffness(model, classes)
    )


@pytest.mark.parametrize("name", CUBIC)
@pytest.mark.parametrize("d", [2, 3])
def test_the_bonds_have_the_tensor(name, d):
    C, classes = moduli(name, d), bond_classes(1.0, 3.0, dimension=d)
    stiffness, share, excess = CrystalBonds(C, 3.0).bonds(classes)
    assert stiffness.min() >= 0
    assert (excess < 0) == (name == "soft")
    strain = np.random.default_rng(0).normal(size=(d, d))
    strain = strain + strain.T
    e = np.einsum("bi,ij,bj->b", classes.xi, strain, classes.xi)
    energy = stiffness @ e**2 / 2 + excess * (share @ e) ** 2 / 2
    expected = np.einsum("ij,ijkl,kl", strain, from_voigt(C), strain) / 2
    assert energy == pytest.approx(expected, rel=1e-9)
    assert share @ e == pytest.approx(np.trace(strain))


@pytest.mark.parametrize("name", CUBIC)
@pytest.mark.parametrize("d", [2, 3])
def test_no_breaking_leaves_a_negative_energy_and_none_is_stiffer_than_proven(name, d):
    body = lattice_body(box((7, 6, 4)[:d], 1.0), 1.0, 3.0)
    crystal, random = CrystalBonds(moduli(name, d), 3.0), np.random.default_rng(1)
    bound = crystal.largest_stiffness(body.classes)
    for broken in (0.0, 0.7):
        neighbour = random_breaking(body, random, broken)
        L = bond_matrix(body, neighbour, *crystal.bonds(body.classes)).toarray()
        values = np.linalg.eigvalsh(L)
        assert values[0] > -1e-12 * bound
        assert values[-1] <= bound
    assert values[-1] > 0.05 * bound


def test_a_cut_across_the_second_axis_spends_its_own_energy_and_other_planes_no_less():
    solid, classes = brittle("silicon", horizon=3.0), bond_classes(1.0, 3.0)
    stretches, (stiffness, share, excess) = solid.stretches(classes), solid.model.bonds(classes)
    rows, e = classes.steps[:, 1], stretches * classes.r[classes.bond_class] ** 2
    pulled = stiffness * e**2
    dilated = [np.sum((share * e)[rows > k]) for k in range(3)]
    whole = np.sum((rows * pulled)[rows > 0]) + excess * np.square(dilated).sum()
    assert whole == pytest.approx(solid.toughness)
    assert stretches.max() > 1.1 * stretches.min()  # by direction
    planes = np.abs(solid.normals @ classes.xi.T) @ pulled / 2
    assert (planes / planes[3] > 0.9 * solid.energies).all()
    even = replace(solid, energies=np.full(6, 1e-3) + (np.arange(6) == 3)).stretches(classes)
    assert even.max() == pytest.approx(even.min())  # nothing asks for more
    spent = replace(solid, spent=4.0).stretches(classes)
    np.testing.assert_allclose(spent, stretches / 2)


def test_growth_by_a_change_of_low_rank_is_that_of_fresh_factors(monkeypatch):
    x = box((14.0, 12.0), 1.0)
    held = np.abs(x[:, 1]) > 3
    u = np.outer(np.sign(x[:, 1]) * held, (0.1, 1.0))
    problem = Cracked(wp.Points(x, ~held, 1.0), u=u, cracks=[[(-7, 0), (0, 0)]])
    runs = {}
    for most in (0, 9, 1000):
        monkeypatch.setattr(slow, "MOST_LOST", most)
        runs[most] = wp.move(brittle(horizon=3.0), problem, events=12)
    for most in (9, 1000):
        np.testing.assert_array_equal(runs[most].details, runs[0].details)
        np.testing.assert_allclose(runs[most].time, runs[0].time, rtol=1e-11)
        np.testing.assert_allclose(runs[most]["energy"], runs[0]["energy"], rtol=1e-11)


SPENT = 1.27
"""By apparent_toughness at 20 spacings, which the slow test measures."""


@pytest.mark.slow
def test_a_crack_grows_at_griffiths_load():
    spent = slow.apparent_toughness(brittle(), 1.0)
    assert spent == pytest.approx(SPENT, rel=0.05)
    strip = slow.cleaved(brittle(spent=spent), 1.0, cells=14, length=4)
    griffith = np.sqrt(brittle().toughness / strip.release)
    assert strip.loads[2:].max() == pytest.approx(griffith, rel=0.05)


def test_a_crack_runs_above_griffiths_load_and_stops_below():
    solid, cells, wide = brittle(spent=SPENT), 12, 36
    x = box((wide, cells + 8), 1.0)
    held = np.abs(x[:, 1]) > cells / 2
    unit = np.outer(np.sign(x[:, 1]) * held, (0, 0.5))
    unit *= np.sqrt(solid.toughness / slow.strip_release(solid, 1.0, cells=cells))
    problem = Cracked(wp.Points(x, ~held, 1.0), u=0.7 * unit, cracks=[[(-wide, 0), (0, 0)]])
    problem = replace(problem, u=wp.solve(solid, problem).u)
    step = 0.5 * solid.longest_step(1.0)
    slowly = 250 / np.sqrt(solid.model.elastic[2, 2])
    ran = {}
    for share in (0.9, 1.1):
        motion = wp.move(
            solid, problem, step=step, steps=int(1.5 * slowly / step), every=50,
            grip=unit * (share - 0.7) / slowly, ramp=lambda t: float(t < slowly), no_fail=held,
        )  # fmt: skip
        hurt = (motion.details.damage > 0.3) & (np.abs(x[:, 1]) < 1)
        ran[share] = x[hurt, 0].max(initial=0.0)
        assert motion.missing < 5e-3
    assert ran[0.9] < 4
    assert ran[1.1] > 15


def test_a_motion_has_the_gradient_between_breakings():
    solid, x, random = brittle(horizon=3.0), box((8.0, 8.0), 1.0), np.random.default_rng(0)
    points, crack = wp.Points(x, x[:, 1] > -3, 1.0), [[(-4, 0), (0, 0)]]
    step, weights = 0.5 * solid.longest_step(1.0), random.normal(size=x.shape)
    v = torch.tensor(0.8 * x * [0, 1] + 0.1 * random.normal(size=x.shape), requires_grad=True)
    load, along = random.normal(size=x.shape), random.normal(size=x.shape)

    def end(v):
        run = wp.move(solid, Cracked(points, load, cracks=crack), v=v, step=step, steps=12)
        return run.u, run.details.damage.sum()

    with pytest.warns(UserWarning, match="ends of bonds broke"):
        u, damage = end(v)
    assert damage > 0.1
    (u * torch.from_numpy(weights)).sum().backward()
    ends = [end(v.detach().numpy() + side * 1e-5 * along) for side in (1, -1)]
    assert ends[0][1] == ends[1][1] == damage
    slope = ((ends[0][0] - ends[1][0]) * weights).sum() / 2e-5
    assert (v.grad.numpy() * along).sum() == pytest.approx(slope, rel=1e-7)


def test_a_crystal_is_kept(tmp_path):
    solid = brittle(spent=1.2)
    wp.save(tmp_path / "crystal.json", solid)
    again = wp.load(tmp_path / "crystal.json")
    classes = bond_classes(1.0, 4.0)
    np.testing.assert_array_equal(again.stretches(classes), solid.stretches(classes))


def hexagonal():
    C = np.diag([3.0, 3.0, 4.0, 1.0, 1.0, 0.9])
    C[:3, :3] += np.array([[0, 1.2, 0.3], [1.2, 0, 0.3], [0.3, 0.3, 0]])
    return C


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (lambda: CrystalBonds(-np.eye(3), 3.0), "expected a stable crystal"),
        (lambda: CrystalBonds(hexagonal(), 3.0), "C_iijj − C_ijij alike"),
        (
            lambda: CrystalBonds(moduli("silicon", 2), 2.0).bonds(bond_classes(1.0, 2.0)),
            "no bonds up to 2 on a lattice of spacing 1",
        ),
        (lambda: replace(brittle(), energies=np.ones(5)), "each of 5 energies"),
        (lambda: replace(brittle(), energies=-np.ones(6)), "energies: expected numbers > 0"),
        (lambda: replace(brittle(), normals=np.eye(2)[[0]], energies=[1.0]), "the second axis"),
        (lambda: slow.strip_release(brittle(), 1.0, cells=9), "cells: expected an even number"),
        (
            lambda: wp.solve(
                brittle(), Cracked(wp.Points(box((3, 3, 3), 1.0), np.arange(27) > 3, 1.0))
            ),
            "expected 2 dimensions, the crystal's",
        ),
    ],
)
def test_what_is_no_crystal_is_refused(made, message):
    with pytest.raises(InputError, match=message):
        made()
