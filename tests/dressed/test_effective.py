"""What varying periodic solids are as a whole: exact solids, bounds, iterations, refusals."""

import numpy as np
import pytest

import warp_peri as wp
from tests.dressed.solids import SPACING, solid
from tests.micromodulus.crystals import cubic_tensor
from warp_peri.core.elastic import compliance, from_voigt, turned, voigt
from warp_peri.dressed import effective, transferred
from warp_peri.errors import InputError
from warp_peri.launch import set_threads, threads


def isotropic(lam, mu, d):
    m = d * (d + 1) // 2
    C = np.diag([2.0 * mu] * d + [mu] * (m - d))
    C[:d, :d] += lam
    return C


def ball(n, d):
    """1 in a ball of volume .11 (a disk of .28), 0 elsewhere."""
    x = (np.indices((n,) * d) + 0.5) / n - 0.5
    return ((x**2).sum(axis=0) < 0.3**2).astype(int)


def triclinic(d, seed=0):
    m = d * (d + 1) // 2
    A = np.random.default_rng(seed).normal(size=(m, m))
    return A @ A.T + np.eye(m)


def off(found, known):
    return np.abs(found - known).max() / np.abs(known).max()


@pytest.mark.parametrize("sides", [(5, 4), (5, 4, 3)])
def test_an_even_solid_is_itself(sides):
    C = triclinic(len(sides))
    found = effective([C], np.zeros(sides, int), factors=np.full(sides, 3.0))
    assert off(voigt(found.tensor), 3 * C) < 1e-12
    assert found.iterations == (0,) * len(C)
    E = np.eye(len(sides))
    u, strain, stress = found.fields(E)
    assert np.abs(u).max() == 0
    assert off(strain[1, 2], E) < 1e-15
    assert off(stress[0, 1], np.einsum("ijkl,kl->ij", found.tensor, E)) < 1e-12


def laminate(lam, mu, weight, d):
    """Voigt's matrix of isotropic layers across the first axis (G. E. Backus, 1962)."""
    lam, mu, weight = map(np.asarray, (lam, mu, weight))
    M, mean = lam + 2 * mu, lambda f: float(np.sum(weight * f))
    across, along = 1 / mean(1 / M), mean(lam / M)
    C = np.zeros((3 * d - 3,) * 2)
    C[0, 0], C[0, 1] = across, along * across
    C[1, 1] = mean(4 * mu * (lam + mu) / M) + along**2 * across
    C[-1, -1] = 1 / mean(1 / mu)
    if d == 3:
        C[0, 2], C[2, 2], C[3, 3], C[4, 4] = C[0, 1], C[1, 1], mean(mu), C[5, 5]
        C[1, 2] = mean(2 * mu * lam / M) + along**2 * across
    return np.triu(C) + np.triu(C, 1).T


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("axis", [0, 1])
def test_layers_of_whole_elements_are_exact(d, axis):
    phases = np.zeros((6,) * d, int)
    phases[(slice(None),) * axis + (slice(2),)] = 1
    found = effective([isotropic(1, 0.6, d), isotropic(3, 5, d)], phases, tolerance=1e-10)
    turn = np.eye(d)[:, [axis, *(a for a in range(d) if a != axis)]]
    known = laminate([1, 3], [0.6, 5], [2 / 3, 1 / 3], d)
    assert off(found.tensor, turned(from_voigt(known), turn)) < 1e-10


def test_a_smooth_map_at_nodes_comes_closer_with_the_square_of_the_spacing():
    law = solid(2, reach=1.0, size=0.0)
    C = voigt(law.tensor())
    fine = (np.arange(4096) + 0.5) / 4096
    m = 1 + 0.6 * np.sin(2 * np.pi * fine)
    errors, sides = [], np.array([8, 16, 32])
    for n in sides:
        points = wp.Points.sheet((int(n), 6), SPACING)
        map_ = 1 + 0.6 * np.sin(2 * np.pi * points.x[:, 0] / (n * SPACING))
        body = law.on(points, maps=dict.fromkeys(law.parts.names, map_))
        found = voigt(effective(body).tensor)
        errors.append(abs(found[0, 0] * (1 / m).mean() / C[0, 0] - 1))
        assert found[2, 2] * (1 / m).mean() / C[2, 2] == pytest.approx(1 + errors[-1], rel=1e-6)
    order = -np.polyfit(np.log(sides), np.log(errors), 1)[0]
    assert 1.9 < order < 2.2


@pytest.mark.parametrize(("ratio", "sides"), [(4.0, (8, 16, 32, 64)), (10.0, (8, 16, 32, 64))])
def test_a_checkerboard_conducts_as_the_root_of_both(ratio, sides):
    """√(k₁ k₂) (A. M. Dykhne, 1971); the corners' singularity r^λ says how fast it is met."""
    errors = []
    for n in sides:
        i, j = np.indices((n, n)) // (n // 2)
        found = effective([np.eye(2), ratio * np.eye(2)], (i + j) % 2).tensor
        assert off(found, found[0, 0] * np.eye(2)) < 1e-10
        errors.append(found[0, 0] / ratio**0.5 - 1)
    rate = -np.polyfit(np.log(sides), np.log(errors), 1)[0]
    assert rate == pytest.approx(8 / np.pi * np.arctan(ratio**-0.5), abs=0.1)


def test_layers_in_space_conduct_in_parallel_and_in_series():
    phases = np.indices((4, 3, 2))[0] % 2
    found = effective([np.eye(3), 3 * np.eye(3)], phases)
    assert off(found.tensor, np.diag([1.5, 2, 2])) < 1e-12
    _, gradient, flux = found.fields([1.0, 0, 0])
    assert off(flux, np.broadcast_to([1.5, 0, 0], flux.shape)) < 1e-8
    assert off(gradient[:, 0, 0, 0], np.array([1.5, 0.5, 1.5, 0.5])) < 1e-8


def grains(n, d, count, seed=0):
    """Cubic crystals turned at random, and the grain of each element."""
    rng = np.random.default_rng(seed)
    C = cubic_tensor(d, 3.0, 1.0, 2.5)
    laws = [turned(C, np.linalg.qr(rng.normal(size=(d, d)))[0]) for _ in range(count)]
    return np.array(laws), rng.integers(count, size=(n,) * d)


@pytest.mark.parametrize("d", [2, 3])
def test_bounds_of_voigt_and_reuss_hold_and_the_answer_is_symmetric_and_positive(d):
    laws, number = grains(6, d, 5)
    found = effective(laws, number)
    C = voigt(found.tensor)
    share = np.bincount(number.ravel(), minlength=5) / number.size
    stiff = voigt(np.tensordot(share, laws, 1))
    soft = voigt(compliance(np.tensordot(share, [compliance(law) for law in laws], 1)))
    assert np.array_equal(C, C.T)
    low, high = np.linalg.eigvalsh(C - soft), np.linalg.eigvalsh(stiff - C)
    for apart in (low, high):  # bulk, which all cubic grains share, is what both bounds are
        assert abs(apart[0]) < 1e-12 * C.max()
        assert apart[1] > 1e-3 * C.max()


@pytest.mark.parametrize("d", [2, 3])
def test_local_fields_balance_and_have_the_means_of_the_whole(d):
    laws, number = grains(6, d, 4)
    found = effective(laws, number, spacing=0.5, tolerance=1e-10)
    E = np.random.default_rng(1).normal(size=(d, d))
    E = E + E.T
    u, strain, stress = found.fields(E)
    axes = tuple(range(d))
    assert off(strain.mean(axis=axes), E) < 1e-12
    assert off(stress.mean(axis=axes), np.einsum("ijkl,kl->ij", found.tensor, E)) < 1e-9
    # the fluctuation's mean slope in an element, of its corners
    for other in range(1, d):
        u = (u + np.roll(u, -1, axis=other)) / 2
    slope = (np.roll(u, -1, axis=0) - u)[..., 0] / 0.5
    assert off(slope + E[0, 0], strain[..., 0, 0]) < 1e-10


@pytest.mark.parametrize("d", [2, 3])
def test_phases_may_change_their_numbers(d):
    a, b, phases = isotropic(1, 1, d), isotropic(20, 8, d), ball(8, d)
    first, second = effective([a, b], phases), effective([b, a], 1 - phases)
    assert off(first.tensor, second.tensor) < 1e-12
    assert first.iterations == second.iterations


@pytest.mark.parametrize("contrast", [2, 20])
@pytest.mark.parametrize(("d", "sides"), [(2, (32, 64, 128)), (3, (16, 32))])
def test_iterations_of_the_worst_load_do_not_grow_with_the_period(d, sides, contrast):
    """Of the worst: a symmetric load of a small symmetric period ends early."""
    C = isotropic(1, 1, d)
    counts = [max(effective([C, contrast * C], ball(n, d)).iterations) for n in sides]
    assert np.ptp(counts) <= 2
    assert min(counts) > 5


def test_iterations_grow_no_faster_than_the_root_of_the_contrast():
    phases = np.random.default_rng(0).integers(2, size=(32, 32))
    contrasts = np.array([4.0, 16, 64, 256])
    C = isotropic(1, 1, 2)
    most = [max(effective([C, k * C], phases).iterations) for k in contrasts]
    assert 0.3 < np.polyfit(np.log(contrasts), np.log(most), 1)[0] < 0.55
    # the bound of conjugate gradients, its factor √κ for the residual's norm in place of energy's
    bound = 0.5 * contrasts**0.5 * np.log(2 * contrasts**0.5 / 1e-9) + 1
    assert (most <= bound).all()


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_units_change_nothing(d, factor):
    laws, number = grains(5, d, 3)
    one = effective(laws, number)
    other = effective(factor * laws, number, spacing=factor)
    assert off(other.tensor, factor * one.tensor) < 1e-12
    assert other.iterations == one.iterations
    E = np.eye(d) - np.eye(d)[::-1]
    for mine, its, scale in zip(one.fields(E), other.fields(E), (1, 0, 1)):
        assert off(its, factor**scale * mine) < 1e-9


def dense(body):
    """The tensor of a body by its own sparse matrices, G and K in full."""
    d, pairs = 2, [(0, 0), (1, 1), (0, 1)]
    even = []  # Gauss strains of a mean strain, shears as √2 ε
    for i, j in pairs:
        one = np.zeros(len(pairs))
        one[pairs.index((i, j))] = 1.0 if i == j else 0.5**0.5
        even.append(np.tile(one, len(body.grid) * 2**d))
    e, G = np.array(even).T, body.dressings[0]
    inner = 0.0
    for a, factor in enumerate(body.factors):
        for share, M in body.tensors(a):
            inner = inner + np.kron(np.diag(share * factor), M)
    B = (body.strains @ G).toarray()
    K, b = B.T @ inner @ B, -(B.T @ inner @ e)
    u = np.linalg.lstsq(K, b, rcond=1e-12)[0]
    assert off(K @ u, b) < 1e-9
    return e.T @ inner @ (e + B @ u) / len(body.grid)


def test_a_dressed_body_with_maps_is_what_its_matrices_say_and_g_changes_nothing():
    points = wp.Points.sheet((7, 6), SPACING)
    found = []
    for size in (0.0, 0.03):
        law = solid(2, size=size)
        rng = np.random.default_rng(3)
        maps = {name: rng.uniform(0.1, 2, size=len(points.x)) for name in law.parts.names}
        body = law.on(points, maps=maps)
        found.append(voigt(effective(body, tolerance=1e-10).tensor))
        assert off(found[-1], dense(body)) < 1e-10
    assert off(*found) < 1e-12


def test_grains_of_a_dressed_body():
    law = solid(2)
    turned_law = transferred(law, law.spacing, rotation=30.0)
    points = wp.Points.sheet((8, 6), SPACING)
    number = (points.x[:, 0] > points.x[:, 0].mean()).astype(int)
    body = law.on(points, grains=([law, turned_law], number))
    found = effective(body, tolerance=1e-10)
    assert off(voigt(found.tensor), dense(body)) < 1e-10


def test_a_block_of_elements_in_space_is_as_its_phases():
    law = solid(3, size=0.0, reach=1.0)
    points = wp.Points.sheet((6, 5, 5), SPACING)
    layer = np.where(points.x[:, 1] > 3 * SPACING, 3.0, 1.0)
    body = law.on(points, maps=dict.fromkeys(law.parts.names, layer))
    factor = layer.reshape(6, 5, 5)
    for axis in range(3):
        factor = (factor + np.roll(factor, -1, axis=axis)) / 2
    known = effective([law.elastic], np.zeros((6, 5, 5), int), factors=factor)
    assert off(effective(body).tensor, known.tensor) < 1e-10


C2 = isotropic(1, 1, 2)
ZERO = np.zeros((4, 4), int)


@pytest.mark.parametrize(
    ("given", "options", "said"),
    [
        ([C2], {}, "phases: expected the number"),
        ([C2], {"phases": ZERO + 1}, "whole numbers from 0 to 0"),
        ([C2], {"phases": ZERO - 1}, "whole numbers from 0 to 0"),
        ([C2], {"phases": ZERO + 0.5}, "whole numbers"),
        ([C2], {"phases": np.zeros(4)}, "solid, phases: expected moduli"),
        ([C2], {"phases": np.zeros((0, 4))}, "whole numbers"),
        ([isotropic(1, 1, 3)], {"phases": ZERO}, "solid, phases: expected moduli"),
        ([C2 * 0], {"phases": ZERO}, r"solid\[0\]: expected a symmetric positive definite"),
        ([C2, -C2], {"phases": ZERO}, r"solid\[1\]: expected a symmetric positive definite"),
        ([C2 * np.nan], {"phases": ZERO}, "solid: "),
        ([C2 + np.triu(C2, 1)], {"phases": ZERO}, "symmetric"),
        ([C2], {"phases": ZERO, "factors": ZERO + 0.0}, "factors: expected numbers > 0"),
        ([C2], {"phases": ZERO, "factors": ZERO - 1.0}, "factors: expected numbers > 0"),
        ([C2], {"phases": ZERO, "factors": ZERO * np.nan}, "factors: "),
        ([C2], {"phases": ZERO, "factors": np.ones(4)}, "factors: expected numbers > 0"),
        ([C2], {"phases": ZERO, "spacing": 0.0}, "spacing, tolerance"),
        ([C2], {"phases": ZERO, "tolerance": 2.0}, "spacing, tolerance"),
    ],
)
def test_bad_phases_are_refused(given, options, said):
    with pytest.raises(InputError, match=said):
        effective(given, **options)


def test_bad_bodies_and_strains_are_refused():
    law, points = solid(2), wp.Points.sheet((8, 8), SPACING)
    maps = {"shear": np.ones(64)}
    maps["shear"][9] = 0
    for value in (0.0, -1.0, np.nan):
        whole = {"shear": np.full(64, value)}
        with pytest.raises(InputError, match="maps"):
            effective(law.on(points, maps=whole))
    bond = solid(2, "bonds").on(points, maps={"shear": np.ones(64)})
    split = solid(2, split=True).on(points, maps={"shear": np.ones(64)})
    for body in (bond, split):
        with pytest.raises(InputError, match="elements under one G"):
            effective(body)
    torn = law.on(points, edges=True, broken=[[0, 1]])
    with pytest.raises(InputError, match="broken"):
        effective(torn)
    with pytest.raises(InputError, match="none beside a dressed body"):
        effective(law.on(points, maps={"shear": np.ones(64)}), np.zeros((8, 8)))
    found = effective([C2], ZERO)
    for E in (np.eye(3), [[0, 1], [0, 0]], [[np.nan, 0], [0, 0]]):
        with pytest.raises(InputError, match="strain"):
            found.fields(E)


def test_the_number_of_threads_changes_no_bit():
    laws, number = grains(13, 3, 3)
    count, found = threads(), []
    for some in (1, 3):
        set_threads(some)
        try:
            found.append(effective(laws, number).tensor)
        finally:
            set_threads(count)
    assert np.array_equal(*found)
