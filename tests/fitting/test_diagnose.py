"""The diagnosis names the cause that was planted."""

from dataclasses import replace

import numpy as np
from numpy.linalg import lstsq, norm
from numpy.random import default_rng

from tests.crystal.crystals import dispersive
from tests.support import approx, filterwarnings, parametrize, refused, shared, warned
from tests.support.clouds import cube, solid
from tests.support.problems import kernel, lattice, manufactured, noise, normal, on_interior, smooth
from tests.support.symbols import fluctuation, noisy
from warp_peri import LPS, Bernstein, Crystal, Samples, diagnose, fit
from warp_peri.core.elastic import voigt_to_tensor
from warp_peri.core.stencil import invariant_basis
from warp_peri.fitting.diagnose import _families
from warp_peri.materials.crystal_fit import fit_dispersion
from warp_peri.materials.lps_operator import LPSOperator

HORIZON = 2.5
MODEL = kernel("positive", HORIZON, lam=0.1, mu=0.7)
COUNT = 24
PLANTED = {
    "dispersion": lambda samples: kernel("steep", HORIZON, lam=0.4, mu=0.7).on(samples)(samples.u),
    "anisotropy": lambda samples: families(samples)["anisotropy"][0][..., 1],
    "nonlinearity": lambda samples: families(samples)["nonlinearity"][0][..., [3, 20]].sum(-1),
    "heterogeneity": lambda samples: (
        samples.b[:, samples.interior] * normal((samples.interior.sum(), 1))
    ),
}


@shared
def samples():
    return manufactured(MODEL, lattice(9, HORIZON), COUNT, wave_number=0.6)


def with_force(samples, extra):
    """The samples with loads that a model of their own would need besides, a tenth as large."""
    b = samples.b.copy()
    inside = b[:, samples.interior]
    b[:, samples.interior] += 0.1 * extra * norm(inside) / norm(extra)
    return replace(samples, b=b)


def families(samples):
    inside = np.arange(samples.interior.sum())
    found = {}
    for name, columns in _families(samples, LPSOperator(MODEL, samples.points), inside, 0.0):
        found.setdefault(name, []).append(columns)
    return found


@parametrize("cause", PLANTED)
def test_the_planted_cause_is_named(samples, cause):
    diagnosis = diagnose(MODEL, with_force(samples, PLANTED[cause](samples)))
    assert diagnosis.residual == approx(0.1, rel=0.15)
    assert max(diagnosis.shares, key=diagnosis.shares.get) == cause
    assert diagnosis.shares[cause] > 0.5
    assert sum(diagnosis.shares.values()) == approx(1.0)
    assert diagnosis.sentence.startswith("The model leaves ")
    assert cause in diagnosis.sentence or "short waves" in diagnosis.sentence


def test_forces_that_species_share_unlike_their_masses_are_named():
    """Two atoms a cell, one of them loaded: their mean moves by κ b beyond what it answers to b."""
    points = lattice(11, HORIZON)
    operator = MODEL.on(points)
    u = noise(points, COUNT) + manufactured(MODEL, points, COUNT).u
    b = operator.on_all(operator(u))
    seen = Samples(points, u + 0.1 * b * norm(b) / norm(operator(b)), b)
    with warned("^seen: displacements"):
        diagnosis = diagnose(MODEL, replace(seen, arrays={"seen": u[..., 0] > u[0, 0, 0]}))
    assert diagnosis.residual == approx(0.1, rel=0.01)
    assert diagnosis.causes[0] == "species"
    assert diagnosis.shares["species"] > 0.5
    louder = replace(seen, u=u + 2 * (seen.u - u))
    assert "forces in proportion to the masses" in diagnose(MODEL, louder).advice


def test_noise_is_named_where_its_fields_are_given(samples):
    noise = fluctuation(samples, 12, 0.01, seed=2)
    diagnosis = diagnose(MODEL, noisy(samples, 0.01, seed=1), noise)
    assert diagnosis.shares["noise"] == approx(1.0, abs=0.2)


def test_what_cannot_be_told_is_refused(samples):
    with refused("expected 8 at least on a lattice, got 3"):
        diagnose(MODEL, samples[:3])
    with refused("noise: expected displacements of the unloaded body"):
        diagnose(MODEL, samples, samples)
    for u in (0 * samples.u, samples.u[:, :1] + 0 * samples.u):
        with refused("samples: expected displacements with forces"):
            diagnose(MODEL, replace(samples, u=u))
    u = default_rng(0).normal(size=(8, len(cube(2, 2.0).x), 3))
    with refused("samples in the plane, got 3 dimensions"):
        diagnose(solid(2.0), Samples(cube(2, 2.0), u, u))


def test_forces_that_grow_with_the_cube_are_nonlinear_and_pairs_of_bonds_dispersion(samples):
    """The first change sign with u, as a linear solid's do; at small strains none can be as large.
    The dilatation joins nodes 2δ apart, which bonds of the family do not reach."""
    loaded = replace(samples, u=0.02 * samples.u, b=0.02 * samples.b)
    cubic = families(loaded)["nonlinearity"][1][..., 9]
    assert diagnose(MODEL, with_force(loaded, cubic)).shares["nonlinearity"] > 0.7
    weak = replace(samples, u=1e-3 * loaded.u, b=1e-3 * loaded.b)
    assert diagnose(MODEL, with_force(weak, cubic)).shares["nonlinearity"] < 0.05
    near, far = families(samples)["dispersion"]
    far, near = far[..., -1], near.reshape(far[..., -1].size, -1)
    far = far - (near @ lstsq(near, far.ravel(), rcond=None)[0]).reshape(far.shape)
    assert diagnose(MODEL, with_force(samples, far)).shares["dispersion"] > 0.7


def test_one_solid_of_two_phases_is_warned_of():
    """An inclusion four times as stiff: λ + μ of the fit are below those of the softest phase."""
    points = lattice(15, HORIZON)
    mu = np.where(np.hypot(*(points.x - 7.0).T) < 5, 4.0, 1.0)
    home = replace(kernel("1/r", HORIZON, lam=0.375, mu=1.0), units=points.units)
    b = on_interior(points, smooth(points.x, 24, 5, wave_number=0.5))
    samples = Samples(points, home.on(points, lam=0.375 * mu, mu=mu).solve(b, 0 * b).u, b)
    with warned(r"heterogeneity: .* Try fields λ\(x\), μ\(x\) of the LPS"):
        found = fit(samples, LPS(HORIZON, Bernstein(2))).material
    assert diagnose(found, samples).shares["heterogeneity"] > 0.6


@filterwarnings("ignore")
def test_a_crystal_is_told_what_symmetry_it_lacks():
    """Square tensors on an orthotropic sheet, with the ripple that smoothing leaves."""
    C = voigt_to_tensor(np.array([[0.7, 0.1, 0.0], [0.1, 1.1, 0.0], [0.0, 0.0, 0.4]]))
    sheet = fit_dispersion(dispersive(C), 1.0, HORIZON, symmetry="2mm", tensor=C)
    made = manufactured(sheet, replace(lattice(9, HORIZON), axis=0.0), COUNT, wave_number=0.25)
    size = norm(made.b, axis=(1, 2), keepdims=True) / np.sqrt(made.b[0].size)
    samples = replace(made, b=made.b + 0.01 * size * noise(made, COUNT))
    square, without = (Crystal(HORIZON, name).learn(samples).material for name in ("4mm", "2mm"))
    assert diagnose(square, samples).causes[0] == "anisotropy"
    assert diagnose(without, samples).residual < 0.05
    placed, inside = square.on(samples.points), np.arange(samples.interior.sum())
    bonds = dict(_families(samples, placed, inside, 1.0))["dispersion"]
    assert bonds.shape[-1] == len(invariant_basis(HORIZON, square.group).basis)  # none is rounding


def test_rounding_is_called_rounding(samples):
    rough = normal(samples.b.shape)
    for size in (0.0, 1e-14):
        told = diagnose(MODEL, replace(samples, b=samples.b * (1 + size * rough)))
        assert (told.causes, told.advice) == (["rounding"], "")
        assert "100 % of its square is rounding" in told.sentence
    seen = replace(samples, b=samples.b * (1 + 1e-9 * rough))
    assert "rounding" not in diagnose(MODEL, seen).shares
