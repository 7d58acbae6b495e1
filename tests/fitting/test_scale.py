"""A fit follows the scale of its data: stiffness and lengths of any size, and says what it took."""

from dataclasses import replace

import numpy as np
import torch

from tests.support import approx, each_refused, near, parametrize, refused, shared, sup, warned
from tests.support.clouds import larger
from tests.support.problems import OTHER, kernel, lattice, manufactured, normal
from tests.support.solving import fit, solve
from tests.support.symbols import waves
from warp_peri import Bernstein, Samples
from warp_peri.materials.lps_fit import RELATIVE_ZETA, stiffness_of
from warp_peri.methods import StabilityConditions, TwoStage

HORIZON = 2.5
TRUE = kernel("positive", HORIZON, lam=0.1, mu=0.7)


@shared
def data():
    return manufactured(TRUE, lattice(6, HORIZON), 5)


def at_scale(samples, length=1.0, stress=1.0, units=None):
    """The same body of another size, of a material that is so much stiffer."""
    points = larger(samples.points, length, units=units or samples.points.units)
    return replace(samples, points=points, u=length * samples.u, b=samples.b * (stress / length))


def learned(samples, length=1.0, **options):
    return fit(samples, HORIZON * length, Bernstein(3), progress=False, **options)


@shared
def plain(data):
    return learned(data)


@parametrize(
    ("length", "stress", "units"), [(1.0, 1e11, None), (1e-10, 1.0, None), (0.1, 1000.0, OTHER)]
)
def test_stiffness_and_lengths_of_any_size_and_unit(data, plain, length, stress, units):
    there = at_scale(data, length, stress, units)
    result = learned(there, length)
    found, expected = (
        [(s.parameters.lam, s.parameters.mu) for s in one.history] for one in (result, plain)
    )
    assert np.array(found) / stress == approx(np.array(expected), rel=1e-5)
    near(result.material.mu / stress, 0.7, 1e-4)
    assert (result.material.horizon, result.material.certified_on) == (HORIZON * length, (length,))
    solved = solve(result.material, there, there.b, there.u)
    assert solved == approx(there.u, rel=0, abs=1e-4 * sup(there.u))
    near(result.certificate.symbol_bound / stress, plain.certificate.symbol_bound, 1e-4)
    stiffness = stress * stiffness_of([data], HORIZON)
    zeta = result.law.conditions.zeta
    assert zeta == approx(RELATIVE_ZETA * stiffness)
    kept = result.material.provenance["zeta"]
    assert kept == approx({"zeta": zeta, "stiffness of the data": stiffness})
    if units:
        shown = repr(result)
        assert (" GPa" in shown, "TPa" in shown, "Å" in shown) == (True, False, False)
        assert "spacing 0.1 nm, with" in result.certificate.statement
        with refused(r"noise: expected the 256 nodes .* in units \(.angstrom.*nm"):
            learned(data, noise=there)


def test_steps_that_end_on_their_way_are_those_of_any_size():
    small, length, stress = manufactured(TRUE, lattice(4, HORIZON), 3), 1e6, 3e-6
    how = TwoStage(epochs=20, inner_epochs=10, outer_iterations=2)
    with warned("two-stage method takes nothing off"), torch.no_grad():
        first = learned(small, method=how, noise=replace(small, b=None)).material
    found = learned(at_scale(small, length, stress), length, method=how).material
    assert (found.lam / stress, found.mu / stress) == approx((first.lam, first.mu), rel=1e-9)
    assert found.D == approx(first.D, rel=1e-9)


def test_noise_does_not_soften_the_stiffness(data):
    many = Samples(data.points, *(np.tile(one, (60, 1, 1)) for one in (data.u, data.b)))
    noisy = replace(many, u=many.u + 0.3 * normal(many.u.shape))
    near(stiffness_of([noisy], HORIZON), stiffness_of([data], HORIZON), 0.05)


def test_wave_vectors_are_taken_at_any_length():
    small = at_scale(waves(TRUE, cells=4, highest=4), 1e-10)
    small.arrays["wave_vector"] = small.arrays["wave_vector"] * 1e10
    near(learned(small, 1e-10, loss="output").material.mu, 0.7, 1e-4)


def test_data_that_no_solid_answers_are_refused_and_a_modulus_on_its_bound_is_told(data):
    """A ζ far above the material makes every kernel too stiff by far."""
    each_refused(lambda of, zeta: learned(of, conditions=StabilityConditions(zeta=zeta)), {
        "work of opposite sign": (at_scale(data, stress=-1.0), None),
        "work of opposite sign, or none": (replace(data, u=0 * data.u), None),
        r"the best model leaves [0-9.]+ % of the loads, no less": (data, 50.0),
    })  # fmt: skip
    said = r"^μ and λ \+ μ ended on the lower bound, 0\.758 TPa, where the data show .* 0\.553 TPa"
    with warned(said):
        learned(data, conditions=StabilityConditions(zeta=0.75))
