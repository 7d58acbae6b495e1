"""The diagnosis names the cause that was planted."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.cubes import cube, solid
from tests.support.problems import kernel, lattice, manufactured, noise, smooth
from tests.support.waves import fluctuation
from warp_peri import LPS, Bernstein, Crystal, InputError, Samples, diagnose, fit
from warp_peri.fitting.diagnose import _families
from warp_peri.materials.lps_operator import LPSOperator

HORIZON = 2.5
MODEL = kernel("positive", HORIZON, lam=0.1, mu=0.7)
COUNT = 24


@pytest.fixture(scope="module")
def samples():
    return manufactured(MODEL, lattice(9, HORIZON), COUNT, wave_number=0.6)


def with_force(samples, extra):
    """The samples with loads that a model of their own would need besides, a tenth as large."""
    b = samples.b.copy()
    inside = b[:, samples.interior]
    b[:, samples.interior] += 0.1 * extra * np.linalg.norm(inside) / np.linalg.norm(extra)
    return replace(samples, b=b)


def families(samples):
    inside = np.arange(samples.interior.sum())
    found = {}
    for name, columns in _families(samples, LPSOperator(MODEL, samples.points), inside, 0.0):
        found.setdefault(name, []).append(columns)
    return found


def planted(samples, cause):
    if cause == "dispersion":
        other = kernel("steep", HORIZON, lam=0.4, mu=0.7)
        return other.on(samples.points)(samples.u)
    if cause == "anisotropy":
        return families(samples)["anisotropy"][0][..., 0]
    if cause == "nonlinearity":
        return families(samples)["nonlinearity"][0][..., [3, 20]].sum(axis=-1)
    factor = np.random.default_rng(0).normal(size=(samples.interior.sum(), 1))
    return factor * samples.b[:, samples.interior]


@pytest.mark.parametrize("cause", ["dispersion", "anisotropy", "nonlinearity", "heterogeneity"])
def test_the_planted_cause_is_named(samples, cause):
    diagnosis = diagnose(MODEL, with_force(samples, planted(samples, cause)))
    assert diagnosis.residual == pytest.approx(0.1, rel=0.15)
    assert max(diagnosis.shares, key=diagnosis.shares.get) == cause
    assert diagnosis.shares[cause] > 0.5
    assert sum(diagnosis.shares.values()) == pytest.approx(1.0)
    assert diagnosis.sentence.startswith("The model leaves ")
    assert cause in diagnosis.sentence or "short waves" in diagnosis.sentence


def test_forces_that_species_share_unlike_their_masses_are_named():
    """Two atoms a cell, one of them loaded: their mean moves by κ b beyond what it answers to b."""
    points = lattice(11, HORIZON)
    operator, inside = MODEL.on(points), points.interior
    u = noise(points, COUNT) + manufactured(MODEL, points, COUNT).u
    b = np.zeros_like(u)
    b[:, inside] = operator(u)
    left = operator(b)
    seen = Samples(points, u + 0.1 * b * np.linalg.norm(b[:, inside]) / np.linalg.norm(left), b)
    diagnosis = diagnose(MODEL, seen)
    assert diagnosis.residual == pytest.approx(0.1, rel=0.01)
    assert diagnosis.causes[0] == "species"
    assert diagnosis.shares["species"] > 0.5
    louder = replace(seen, u=u + 2 * (seen.u - u))
    assert "forces in proportion to the masses" in diagnose(MODEL, louder).advice


def test_noise_is_named_where_its_fields_are_given(samples):
    noisy = replace(samples, u=samples.u + fluctuation(samples, COUNT, 0.01, seed=1).u)
    diagnosis = diagnose(MODEL, noisy, fluctuation(samples, 12, 0.01, seed=2))
    assert max(diagnosis.shares, key=diagnosis.shares.get) == "noise"
    assert diagnosis.shares["noise"] == pytest.approx(1.0, abs=0.2)


def test_what_cannot_be_told_is_refused(samples):
    few = replace(samples, u=samples.u[:3], b=samples.b[:3])
    u = np.random.default_rng(0).normal(size=(8, len(cube(2, 2.0).x), 3))
    for model, given, words in (
        (MODEL, few, "expected 8 at least on a lattice, got 3"),
        (solid(2.0), Samples(cube(2, 2.0), u, u), "samples in the plane, got 3 dimensions"),
    ):
        with pytest.raises(InputError, match=words):
            diagnose(model, given)


def stretched(points, count):
    """Fields of an orthotropic solid, C11 a third below C22, with the ripple that smoothing leaves.

    Loads are those that second differences of three steps along x and y need.
    """
    generator = np.random.default_rng(4)
    x, h = points.x, points.spacing
    u, b = np.zeros((2, count, len(x), 2))
    for s in range(count):
        k = generator.uniform(0.08, 0.25) * np.array([np.cos(s), np.sin(s)])
        angle, phase = generator.uniform(0, 2 * np.pi, 2)
        e, wave = np.array([np.cos(angle), np.sin(angle)]), np.cos(x @ k + phase)
        c, s2 = (2 - 2 * np.cos(k * h)) / h**2, np.sin(k * h) / h
        D = np.array([[0.7 * c[0] + 0.4 * c[1], 0.5 * s2[0] * s2[1]]])
        D = np.vstack([D, [D[0, 1], 1.1 * c[1] + 0.4 * c[0]]])
        u[s], b[s] = wave[:, None] * e, wave[:, None] * (D @ e)
    size = np.linalg.norm(b, axis=(1, 2)) / np.sqrt(b[0].size)
    b += 0.01 * size[:, None, None] * generator.normal(size=b.shape)
    return Samples(points, u, b)


def test_forces_that_grow_with_the_cube_are_nonlinear(samples):
    """They change sign with u, as a linear solid's do; at small strains none can be as large."""
    loaded = replace(samples, u=0.02 * samples.u, b=0.02 * samples.b)
    cubic = families(loaded)["nonlinearity"][1][..., 9]
    assert diagnose(MODEL, with_force(loaded, cubic)).shares["nonlinearity"] > 0.7
    weak = replace(samples, u=1e-3 * loaded.u, b=1e-3 * loaded.b)
    assert diagnose(MODEL, with_force(weak, cubic)).shares["nonlinearity"] < 0.05


def test_pairs_of_bonds_are_dispersion(samples):
    """The dilatation joins nodes 2δ apart; bonds of the family do not reach them."""
    near, far = families(samples)["dispersion"]
    far, near = far[..., -1], near.reshape(far[..., -1].size, -1)
    far = far - (near @ np.linalg.lstsq(near, far.ravel(), rcond=None)[0]).reshape(far.shape)
    assert diagnose(MODEL, with_force(samples, far)).shares["dispersion"] > 0.7


def test_dispersion_leaves_long_waves_isotropic(samples):
    """A quadratic field feels of it what two Lamé parameters do, the same at every node."""
    x = samples.x[None]
    bent = np.stack([x[..., 0] ** 2 - x[..., 0] * x[..., 1], x[..., 1] ** 2], axis=-1)
    for columns in families(replace(samples, u=bent, b=bent))["dispersion"]:
        forces = columns[0].reshape(-1, columns.shape[-1])
        assert np.linalg.matrix_rank(forces, tol=1e-9 * np.linalg.norm(forces)) == 2


def test_one_solid_of_two_phases_is_warned_of():
    """An inclusion four times as stiff: λ + μ of the fit are below those of the softest phase."""
    points = lattice(15, HORIZON)
    mu = np.where(np.hypot(*(points.x - 7.0).T) < 5, 4.0, 1.0)
    home = replace(kernel("1/r", HORIZON, lam=0.375, mu=1.0), units=points.units)
    op = home.on(points, lam=0.375 * mu, mu=mu)
    b = np.zeros((24, *points.x.shape))
    b[:, points.interior] = smooth(points.x, 24, 5, wave_number=0.5)[:, points.interior]
    samples = Samples(points, op.solve(b, 0 * b).u, b)
    with pytest.warns(UserWarning, match=r"heterogeneity: .* Try fields λ\(x\), μ\(x\) of the LPS"):
        found = fit(samples, LPS(HORIZON, Bernstein(2))).material
    assert diagnose(found, samples).shares["heterogeneity"] > 0.6


@pytest.mark.filterwarnings("ignore")
def test_a_crystal_is_told_what_symmetry_it_lacks():
    """Square tensors on an orthotropic sheet; tensors without symmetry leave nothing."""
    samples = stretched(lattice(9, HORIZON), 24)
    square, without = (Crystal(HORIZON, name).learn(samples).material for name in ("4mm", "2mm"))
    assert diagnose(square, samples).causes[0] == "anisotropy"
    assert diagnose(without, samples).residual < 0.05


def test_rounding_is_called_rounding(samples):
    random = np.random.default_rng(0)
    exact = diagnose(MODEL, samples)
    nearly = replace(samples, b=samples.b * (1 + 1e-14 * random.normal(size=samples.b.shape)))
    for told in (exact, diagnose(MODEL, nearly)):
        assert told.causes == ["rounding"]
        assert "100 % of its square is rounding" in told.sentence
    seen = replace(samples, b=samples.b * (1 + 1e-9 * random.normal(size=samples.b.shape)))
    assert "rounding" not in diagnose(MODEL, seen).shares
    assert exact.advice == ""
