"""Bonds that soften and fail: linear limit, energy's derivative, a peak, another horizon."""

import json

import numpy as np
import pytest
from scipy.integrate import quad

from examples.published_plate import main, plate, pulled
from tests.support.bodies import plate as lattice
from tests.support.bodies import solid
from warp_peri import InputError, Model
from warp_peri.damage.cut_solid import CutSolid
from warp_peri.damage.softening import BondLaw, SoftBody

LAWS = {
    "linear": BondLaw(0.0, 0.06),
    "softening": BondLaw(5.0, 0.06),
    "with a tail": BondLaw(5.0, 0.05, 0.03),
}


def test_without_softness_it_is_the_linear_body():
    soft, unit = plate(20, 5.0, 10.05, BondLaw(0.0), True)
    times = np.array([10.0, 20.0])
    run = pulled(20, times, BondLaw(0.0), horizon=10.05)
    assert run.force[1] == pytest.approx(2 * run.force[0])
    crack = [[(-10, 0), (10, 0)]]
    linear = CutSolid(Model(1.0, 1.0, 1.0, [1.0], 10.05), soft.body, soft.held, cracks=crack)
    np.testing.assert_allclose(
        soft.rest(unit.ravel().astype(float), np.ones(len(soft._k))).reshape(-1, 2),
        linear.solve(unit),
        atol=1e-7,
    )


def test_softer_bonds_pull_less_failing_ones_make_a_peak_and_a_tail_raises_it():
    times = np.arange(84.0, 112.0, 4.0)
    stiff, soft, broken, tail = (
        pulled(20, times, law, horizon=10.05)
        for law in (BondLaw(0.0), BondLaw(4.0), BondLaw(4.0, 0.05), BondLaw(4.0, 0.05, 0.05))
    )
    assert (soft.force < stiff.force).all()
    assert broken.peak[1] < tail.peak[1] < soft.force.max()
    assert broken.broken[-1] > 0
    assert broken.force[-1] < broken.peak[1]


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_the_energy_spent_is_the_work_of_pulling_a_bond_apart(law):
    def pull(s):
        worst = np.array([s])
        return float((law.pull(worst) * law.share(worst))[0])

    ends = law.stretch, law.stretch + law.tail
    work = quad(pull, 0, ends[0])[0] + quad(pull, *ends)[0]
    assert law.spent() == pytest.approx(work, rel=1e-8)
    assert pull(ends[1] + 1e-6) == 0
    assert law.share(np.array([0.0, 0.02])).min() == 1


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
@pytest.mark.parametrize("times", [0.5, 1.0, 2.0, 4.0])
def test_another_horizon_keeps_the_toughness_and_if_it_can_the_strength(law, times):
    other = law.at_horizon(times)
    assert other.spent() * times == pytest.approx(law.spent(), rel=1e-9)
    if other.tail:
        assert other.stretch == law.stretch
    else:
        assert other.stretch <= law.stretch * (1 + 1e-9)
    if times < 1:
        assert other.tail > law.tail


def test_dilatation_and_laws_that_are_none_are_refused():
    body = lattice(8, 8)
    with pytest.raises(InputError, match="expected λ = μ"):
        SoftBody(solid(0.5).model, body, BondLaw(1.0), np.abs(body.x) > 3)
    for law in ((-1.0,), (np.inf,), ("soft",), (1.0, 0.0), (1.0, 0.1, -0.1), (1.0, 0.1, np.inf)):
        with pytest.raises(InputError, match="expected a"):
            BondLaw(*law)
    assert (BondLaw(2.0).spent(), BondLaw(0.0).spent()) == (0.25, np.inf)
    assert BondLaw(2.0, 50.0).spent() == pytest.approx(0.25)
    for law, times in ((BondLaw(1.0), 2.0), (BondLaw(1.0, 0.1), "2"), (BondLaw(1.0, 0.1), 0.0)):
        with pytest.raises(InputError, match="at_horizon: expected"):
            law.at_horizon(times)


@pytest.mark.slow
def test_the_large_plate_follows_from_the_small_ones_at_two_horizons(tmp_path, capsys):
    assert main(["--json", "--out", str(tmp_path)]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert numbers["whole plate, mean error"] < 0.038
    assert abs(numbers["peaks"]["L = 100"]["force error"]) < 0.04
    assert abs(numbers["peaks"]["L = 100, horizon × 2"]["force error"]) < 0.05
    assert (tmp_path / "force.png").stat().st_size > 5000


def test_what_cannot_be_pulled_is_refused():
    body, model, law = lattice(12, 16), solid(1.0).model, BondLaw(2.0, 0.05, 0.02)
    ends = np.repeat(np.abs(body.x[:, 1:]) > 5, 2, axis=1)
    for options, words in (
        ({"held": ends[:, 0]}, "held: expected shape"),
        ({"held": ends & False}, "against 0 of its 3 rigid motions"),
        ({"held": ends, "no_fail": np.ones(3, bool)}, "no_fail: expected shape"),
        ({"held": ends, "no_fail": np.ones(len(ends), int)}, r"of bool, got \[192\] of int"),
    ):
        with pytest.raises(InputError, match=words):
            SoftBody(model, body, law, **options)
    with pytest.raises(InputError, match="expected the horizon 4"):
        SoftBody(Model(1.0, 1.0, 1.0, np.ones(1), 4.0), body, law, ends)
    soft, u, line = SoftBody(model, body, law, ends), body.x * (0, 1), [(-7, 0.1), (7, 0.1)]
    for given, loads, across, words in (
        (u, [], line, "one finite factor"),
        (u, [0.2, 0.1], line, "factors that rise"),
        (u[:, 0], [0.1], line, "u: expected shape"),
        (u * np.nan, [0.1], line, "u: expected finite"),
        (u, [0.1], [(-7, 40), (7, 40)], "no bond of the body crosses it"),
    ):
        with pytest.raises(InputError, match=words):
            soft.pull(given, loads, across)
