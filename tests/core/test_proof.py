"""What is proven of a stencil's symbol holds, and what does not hold is not proven."""

from dataclasses import replace
from itertools import product

import numpy as np
from numpy import array, cos, eye, inf, ones, pi, sin, zeros
from numpy.linalg import eigvalsh
from numpy.random import default_rng

import warp_peri as wp
from tests.crystal.crystals import learned, random_law
from tests.support import approx, in_plane_and_space, parametrize, refused, sup
from tests.support.problems import difference, fitted_order, kernel
from tests.support.symbols import anywhere, zone
from warp_peri.core import elastic, proof
from warp_peri.core.elastic import lattice_group, plane_isotropic, voigt_to_tensor
from warp_peri.core.proof import StencilCertificate, largest, long_wave_radius, parts, prove
from warp_peri.core.stencil import Stencil, laplacian, laplacian_stencil
from warp_peri.materials.certificate import squared

NOTHING = {d: array([eye(d), -eye(d)], dtype=int) for d in (2, 3)}
SQUARE = lattice_group(2)
STEPS = array([[2, 0], [0, 2], [1, 0], [0, 1]])
springs = lambda *sizes: Stencil(1.0, STEPS, array(sizes)[:, None, None] * eye(2))
SOFT = springs(1.0, 1.0, -3.9, -3.9)
"""Positive at long waves alone, not far beyond the ball."""


def waves(d):
    phase = anywhere(4000, 0, d)
    phase[::2] *= 1e-2
    return phase


@in_plane_and_space
def test_nearly_all_of_the_sampled_minimum_is_proven_with_the_wedge_and_without(d):
    law = learned(d)
    for group in (law.group, NOTHING[d]) if d == 2 else (law.group,):
        found = prove(law.stencil, group)
        assert found.proven == approx(0.99 * found.sampled)
        assert found.sampled == approx(0.024, rel=0.01)  # (C11 − C12)/2, the softest shear
    D = law.stencil.symbol(waves(d)) * law.spacing**2
    assert (eigvalsh(D)[:, 0] > found.proven * laplacian(waves(d))).all()


def test_a_dip_between_the_points_of_the_sample_is_not_overlooked(monkeypatch):
    """Positive at the sampled waves, negative in between: nothing may be proven."""
    monkeypatch.setattr(proof, "zoomed", lambda _, k, reach: (np.full(len(k), inf), k))
    d, law, sample = 2, learned(2), proof.SAMPLE[2]
    far = zeros((2, d), int)
    far[:, 0] = 2 * sample, 4 * sample  # 1 − cos k·ξ vanishes on the sampled grid
    dip = zeros((2, d, d))
    dip[:, 0, 0] = -0.2, 0.2
    steps = np.concatenate([law.steps, far])
    below = Stencil(1.0, steps, np.concatenate([law.tensors * law.spacing**2, dip]))
    wave = zeros((1, d))
    wave[0, 0] = pi / far[0, 0]
    assert eigvalsh(below.symbol(wave))[0, 0] < 0
    found = prove(below, NOTHING[d])
    assert found.sampled > 0
    assert not found.holds


@parametrize("lam", [-0.2, 0.8])  # both parts, deviatoric alone
@parametrize("name", ["1/r", "sign-changing"])
def test_the_parts_of_the_proof_bound_what_they_claim(name, lam):
    """Slopes are right, no symbol is below its affine part by more than the rest, and some are."""
    stencil = kernel(name, 3.0, lam=lam).stencil(1.0).minus(laplacian_stencil(1.0, 2, 2), 0.1)
    rest, half = proof._most(stencil, sum(parts(stencil.tensors))), 0.05
    random, worst = default_rng(4), 0.0
    for k in (*random.uniform(-pi, pi, (20, 2)), array([1e-2, 1e-2])):
        value, slopes = (one[..., 0, :, :] for one in proof._symbol_slopes(stencil, k[None]))
        assert slopes == approx(difference(lambda k: stencil.symbol(k[None])[0], k, 0.01), abs=1e-9)
        t = half * random.uniform(-1, 1, (200, 2))
        gap = eigvalsh(stencil.symbol(k + t) - (value + np.tensordot(t, slopes, 1)))[:, 0].min()
        assert gap >= -rest * half**2
        worst = max(worst, -gap / (rest * half**2))
    assert worst > 1e-3


@parametrize(("height", "positive"), [(1.0, False), (3.0, True)])
def test_a_function_that_bends_down_within_a_cell_is_seen_to(height, positive, monkeypatch):
    """height − 2 x² on |x| ≤ 1, whose affine part at the middle is positive everywhere."""
    monkeypatch.setattr(proof, "FIRST", 1)

    def affine(x):
        return height - 2 * x[:, :, None] ** 2, -4 * x.T[:, :, None, None]

    def every(x, half):
        return ones(len(x), bool)

    assert proof._positive(affine, 1.0, 1, 2.0, 0.0, every, 1000)[0] == positive


@parametrize("name", ["steep", "positive", "soft"])
def test_the_ball_around_zero_is_sound(name):
    weight = laplacian_stencil(1.0, 2, 2)
    stencil = SOFT if name == "soft" else kernel(name, 3.0).stencil(1.0)
    long, _ = proof._long_waves(stencil, SQUARE)
    assert long > 0
    angle = np.linspace(0, pi, 50)
    ring = np.stack([cos(angle), sin(angle)], 1)
    for c in array([0.0, 0.5, 0.9, 0.999]) * long:
        less = stencil.minus(weight, c)
        radius = long_wave_radius(less, long - c)
        k = np.concatenate([radius * part * ring for part in (0.01, 0.3, 0.7, 1.0)])
        assert (eigvalsh(less.symbol(k))[:, 0] > 0).all()


def test_nothing_above_the_minimum_is_proven_and_curvature_is_set_aside(monkeypatch):
    """By the proof itself, told that more was sampled than there is."""
    stencil = kernel("1/r", 2.0).stencil(1.0)
    assert prove(stencil, SQUARE).holds
    assert prove(stencil, SQUARE, shares=(4.0, 1.02)).proven == 0
    monkeypatch.setattr(proof, "MOST_CELLS", {2: 5000})
    monkeypatch.setattr(proof, "_most", lambda *_: 1e6)
    assert not prove(stencil, SQUARE).holds


def test_a_weight_is_what_it_says():
    """Of an odd field the square, of which the proof is a bound over all waves."""
    steps = array([s for s in product((-1, 0, 1), repeat=2) if any(s)])
    field = steps / (steps**2).sum(1)[:, None] / 3.0
    weight, phase = squared(1.0, steps, field), waves(2)
    expected = ((sin(phase @ steps.T) @ field) ** 2).sum(1)
    assert weight.symbol(phase)[:, 0, 0] == approx(expected, rel=1e-9, abs=1e-15)
    stencil = kernel("1/r", 2.0).stencil(1.0)
    found = prove(stencil, SQUARE, weight)
    assert eigvalsh(stencil.minus(weight, found.proven).symbol(phase))[:, 0].min() > 0
    assert found.proven == approx(0.99 * found.sampled)


def top(stencil):
    k = zone(201 if stencil.dimension == 2 else 41, stencil.dimension)
    return eigvalsh(stencil.symbol(k))[:, -1].max()


def test_the_upper_bound_is_above_the_zone_and_near_it_or_takes_too_much_work(monkeypatch):
    for name, horizon in (("1/r", 2.0), ("sign-changing", 4.0)):
        stencil = kernel(name, horizon, lam=-0.2).stencil(1.0)
        assert top(stencil) <= largest(stencil, SQUARE) <= 1.002 * top(stencil)
    law = learned(3)
    assert top(law.stencil) <= law.max_symbol_eigenvalue() <= 1.01 * top(law.stencil)
    stencil = kernel("positive", 3.0).stencil(1.0)
    tight = largest(stencil, SQUARE)
    monkeypatch.setattr(proof, "MOST_CELLS", {2: 1})
    assert largest(stencil, SQUARE, tolerance=1e-9) > tight


def test_what_breaks_its_symmetry_by_little_is_proven_where_it_is_worst():
    found = prove(springs(1.0, 1.0, 0.6e-8, -0.3e-8), SQUARE)
    assert found.sampled > 0
    assert not found.holds


def test_files_claim_what_is_proven_and_nothing_else(tmp_path):
    """Nothing of a law whose smallest sampled ratio is below zero by rounding."""
    law, path = random_law(2), tmp_path / "law.json"
    proof = StencilCertificate(proven=0.0, sampled=-1e-13, long_waves=0.0, cells=0, seconds=0.0)
    wp.save(path, replace(law, certificate=proof))
    assert wp.load(path).certificate.statement == "Nothing is proven."
    law = learned(2)
    for times in (0.995, 1.7, 2 * law.certificate.proven / law.certificate.sampled):
        forged = replace(law.certificate, sampled=times * law.certificate.sampled)
        wp.save(path, replace(law, certificate=forged))
        with refused("is not proven of these tensors"):
            wp.load(path)


@parametrize("reach", [1, 2, 4])
def test_differences_of_elasticity_have_their_order(reach):
    """Their symbol is that of the local solid, to (k h) to the power of twice their reach."""
    C, k = voigt_to_tensor(plane_isotropic(0.3, 0.7)), array([0.3, 0.5])
    halvings = 0.5 ** np.arange(3)
    stencil = Stencil(1.0, *elastic.difference_tensors(C, reach))
    local = np.einsum("ijkl,j,l->ik", C, k, k)
    wrong = [sup(stencil.symbol(t * k[None])[0] / t**2 - local) for t in halvings]
    assert fitted_order(halvings, wrong) == approx(2 * reach, abs=0.1)
