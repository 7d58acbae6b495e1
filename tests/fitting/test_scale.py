"""A fit follows the scale of its data: stiffness and lengths of any size, and says what it took."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.learning import fit
from tests.support.problems import kernel, lattice, manufactured
from tests.support.solving import solve
from tests.support.waves import waves
from warp_peri import Bernstein, InputError, evaluate
from warp_peri.materials.lps import Model
from warp_peri.materials.lps_adam import stiffness_of
from warp_peri.materials.lps_fit import RELATIVE_ZETA
from warp_peri.methods import Conditions, TwoStage
from warp_peri.points.samples import Samples
from warp_peri.points.unit_names import symbols

HORIZON = 2.5
TRUE = kernel("positive", HORIZON, lam=0.1, mu=0.7)


@pytest.fixture(scope="module")
def data():
    return manufactured(TRUE, lattice(6, HORIZON), 5)


def at_scale(samples, length=1.0, stress=1.0):
    """The same body of another size, of a material that is so much stiffer."""
    points = replace(samples.points, x=length * samples.x, spacing=length * samples.spacing)
    return replace(samples, points=points, u=length * samples.u, b=samples.b * (stress / length))


def learned(samples, length=1.0, **options):
    return fit(samples, HORIZON * length, Bernstein(3), progress=False, **options)


@pytest.fixture(scope="module")
def plain(data):
    return learned(data)


@pytest.mark.parametrize("stress", [1e-4, 1e11])
def test_stiffness_of_any_size(data, plain, stress):
    result = learned(at_scale(data, stress=stress))
    for one, other in zip(result.history, plain.history):
        found, expected = ((s.parameters.lam, s.parameters.mu) for s in (one, other))
        assert np.array(found) / stress == pytest.approx(np.array(expected), rel=1e-5)
    assert result.material.mu / stress == pytest.approx(0.7, rel=1e-4)
    zeta = RELATIVE_ZETA * stiffness_of([data], HORIZON)
    assert plain.law.conditions.zeta == pytest.approx(zeta)
    assert result.law.conditions.zeta / stress == pytest.approx(zeta)
    bound = result.certificate.symbol_bound
    assert bound / stress == pytest.approx(plain.certificate.symbol_bound, rel=1e-4)


@pytest.mark.parametrize(("bounds", "conditions"), [("projected", "symbol"), ("relu", "dense")])
@pytest.mark.parametrize(("length", "stress"), [(1.0, 3e-6), (1e6, 1.0)])
def test_steps_that_end_on_their_way_are_those_of_any_size(bounds, conditions, length, stress):
    small = manufactured(TRUE, lattice(5, HORIZON), 5)
    how = TwoStage(bounds, conditions, epochs=40, inner_epochs=20, outer_iterations=2)
    first, found = (
        fit(given, horizon, Bernstein(2), progress=False, method=how).material
        for given, horizon in (
            (small, HORIZON),
            (at_scale(small, length, stress), HORIZON * length),
        )
    )
    assert (found.lam / stress, found.mu / stress) == pytest.approx((first.lam, first.mu), rel=1e-9)
    assert found.D == pytest.approx(first.D, rel=1e-9)


@pytest.mark.parametrize("length", [1e-10, 3.4])
def test_lengths_in_any_unit(data, plain, length):
    there = at_scale(data, length)
    result = learned(there, length)
    assert result.material.horizon == HORIZON * length
    assert result.material.certified_on == (length,)
    assert result.material.mu == pytest.approx(plain.material.mu, rel=1e-5)
    solved = solve(result.material, there, there.b, there.u)
    assert solved == pytest.approx(there.u, rel=0, abs=1e-4 * np.abs(there.u).max())


@pytest.mark.parametrize("units", [("nm", "GPa"), ("sigma", "epsilon/sigma^3")])
def test_a_fit_carries_the_units_of_its_data_and_is_held_to_them(data, plain, units):
    there = at_scale(data, 0.1, 1000.0)
    there = replace(there, points=replace(there.points, units=units))
    result = learned(there, 0.1)
    length, stress = symbols(units)
    assert result.material.units == units
    assert result.material.mu == pytest.approx(1000 * plain.material.mu, rel=1e-5)
    assert f"spacing 0.1 {length}, with" in result.certificate.statement
    assert f" {stress}" in repr(result)
    assert "TPa" not in repr(result)
    assert "Å" not in repr(result)
    assert solve(result.material, there, there.b, there.u).shape == there.u.shape
    for use in (
        lambda: solve(result.material, data, data.b, data.u),
        lambda: evaluate(plain.material, there),
        lambda: plain.material.on(there),
    ):
        with pytest.raises(InputError, match=r"units: the model is in .*in_units\(.* converts"):
            use()
    with pytest.raises(InputError, match="units: expected the same for all sets"):
        learned(data, noise=there)
    if units == ("nm", "GPa"):
        converted = result.material.in_units(("angstrom", "TPa"))
        assert evaluate(converted, data)["E_u"] < 1e-4


def test_zeta_stands_in_the_file(data, plain, tmp_path):
    stiffness = stiffness_of([data], HORIZON)
    plain.material.save(tmp_path / "model.json")
    kept = Model.load(tmp_path / "model.json").provenance["zeta"]
    expected = {"zeta": RELATIVE_ZETA * stiffness, "stiffness of the data": stiffness}
    assert kept == pytest.approx(expected)


def test_noise_does_not_soften_the_stiffness(data):
    random = np.random.default_rng(0)
    many = Samples(data.points, np.tile(data.u, (60, 1, 1)), np.tile(data.b, (60, 1, 1)))
    noisy = replace(many, u=many.u + 0.3 * random.normal(size=many.u.shape))
    assert stiffness_of([noisy], HORIZON) == pytest.approx(stiffness_of([data], HORIZON), rel=0.05)


def test_wave_vectors_are_taken_at_any_length():
    given = at_scale(waves(TRUE, cells=4, highest=2), 1e-10)
    given.arrays["wave_vector"] = given.arrays["wave_vector"] * 1e10
    assert learned(given, 1e-10, loss="output").material.mu == pytest.approx(0.7, rel=1e-4)


def test_forces_of_the_wrong_sign_are_refused(data):
    with pytest.raises(InputError, match="work of opposite sign"):
        learned(at_scale(data, stress=-1.0))
    with pytest.raises(InputError, match="work of opposite sign, or none"):
        learned(replace(data, u=np.zeros_like(data.u)))


def test_a_fit_that_explains_less_than_nothing_is_an_error(data):
    """A ζ far above the material makes every kernel too stiff by far."""
    with pytest.raises(InputError, match=r"the best model leaves [0-9.]+ % of the loads, no less"):
        learned(data, conditions=Conditions(zeta=50.0))


def test_a_modulus_on_its_bound_is_a_warning_with_the_number(data):
    said = r"^μ and λ \+ μ ended on the lower bound, 0\.758 TPa, where the data show .* 0\.553 TPa"
    with pytest.warns(UserWarning, match=said):
        learned(data, conditions=Conditions(zeta=0.75))
