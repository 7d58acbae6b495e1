"""Learning from fields that a known model made."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.support.problems import kernel, lattice, manufactured, noise
from tests.support.symbols import smallest_margins
from warp_peri import Bernstein, InputError, certify, evaluate
from warp_peri.fitting.regression import Regression
from warp_peri.learning import fit as learning
from warp_peri.learning.fit import learn as fit
from warp_peri.learning.two_stage import TorchLaw
from warp_peri.materials import lps_force
from warp_peri.materials.lps import Model, Solid, moduli, stiffnesses
from warp_peri.materials.lps_fit import LPSFound, LPSLaw, Products
from warp_peri.methods import Conditions, Constrained, Optimum, TwoStage
from warp_peri.points.families import bond_classes

LAM, MU = -0.2, 0.7
ZETA = 0.01


QUICK = TwoStage(epochs=250, inner_epochs=40, outer_iterations=4)
"""Few epochs: stage 3 does not depend on how far the others came."""


def data(name, horizon, spacing=1.0, lam=LAM):
    """Ten samples in equilibrium with a known model, and the model."""
    model = kernel(name, horizon, spacing, lam=lam, mu=MU)
    points = lattice(6, horizon, spacing)
    return manufactured(model, points, 10, wave_number=2 / spacing), model


def shares(model, spacing=1.0):
    """μ K W / m of each bond class, and κ."""
    return stiffnesses(model, bond_classes(spacing, model.horizon))


RECOVERED = {
    # name, horizon, degree, precision of λ, μ and the stiffnesses; starts that end elsewhere
    "plain": ("1/r", 2.5, 3, 1e-6, 0),
    "as many coefficients as lengths": ("positive", 2.5, 3, 1e-6, 0),
    "more coefficients than lengths": ("positive", 2.5, 7, 1e-6, 0),
    "sign-changing": ("sign-changing", 3.0, 5, 1e-6, 0),
}


@pytest.mark.parametrize(
    ("name", "horizon", "degree", "precision", "astray"), RECOVERED.values(), ids=RECOVERED
)
def test_the_optimum_is_the_model_that_made_the_data(name, horizon, degree, precision, astray):
    points, true = data(name, horizon)
    learned = fit(points, horizon, Bernstein(degree), method=Constrained())
    model = learned.material
    assert (model.lam, model.mu) == pytest.approx((LAM, MU), abs=precision)
    for found_table, true_table in zip(shares(model), shares(true)):
        size = np.abs(true_table).max()
        np.testing.assert_allclose(found_table, true_table, rtol=0, atol=precision * size)
    reached = sorted(learned.starts.values())
    assert len(reached) == 4
    assert max(reached[: 4 - astray]) < 1e-5
    assert model.certified_on == model.trained_on == (1.0,)
    assert evaluate(model, points)["E_u"] < 1e-4


@pytest.mark.parametrize("kind", ["paper"])
@pytest.mark.parametrize("moduli", [None, (LAM, 1.1 * MU)], ids=["free", "held"])
def test_adam_by_itself_reaches_the_constrained_optimum(kind, moduli):
    points, true = data("sign-changing", 2.5)
    assert certify(true, spacing=1.0).symbol_min < -0.01  # so that conditions bind
    method = Constrained(3, optimum=Optimum(moduli=moduli))
    asked = Conditions(kind, ZETA)
    learned = fit(points, horizon=2.5, kernel=Bernstein(4), method=method, conditions=asked)
    first, second = learned.history
    assert (first.name, second.name) == ("1 Adam", "3 constrained")
    assert len(learned.starts) == 4
    assert min(learned.starts.values()) > 1e-3
    assert first.loss[-1] <= 1.001 * second.loss[-1]
    model = Model(*first.parameters.values(), 2.5)
    margins = smallest_margins(bond_classes(1.0, 2.5), asked, *shares(model))
    assert margins.min() >= -1e-6


def test_adam_follows_the_gradient_of_warps_operator(monkeypatch):
    """Each step takes one of Warp's, which torch carries on to θ, the slope of the exact rows."""
    points, _ = data("sign-changing", 2.5)
    taken, gradient = [], lps_force.gradient
    monkeypatch.setattr(
        lps_force, "gradient", lambda *of, **how: taken.append(1) or gradient(*of, **how)
    )
    method = Constrained(rounds=2, steps=10, optimum=Optimum(moduli=None))
    first = fit(points, 2.5, Bernstein(2), method=method).history[0]
    assert first.steps == len(taken) == 2 * (10 + 1)
    given = learning.training_data([points], 2.5, Conditions("paper", ZETA), [], normalise=False)
    for degree in (2, 4):  # with α free, and where it says what D says
        start = LPSFound(Solid(-0.1, 0.8, 1.3, np.linspace(1, 0.2, degree + 1)))
        law = LPSLaw(given.lattices, start, given.conditions, Optimum(moduli=None, smoothness=0.0))
        in_torch = TorchLaw(law, given.lattices, given.by_operator)
        problem = Regression(given.rows, law, law.zeta, 1.0)
        theta = law.start(start) * (1 + 0.01 * np.arange(len(law.start(start))))
        problem.look(law(theta))
        state, leaf = problem.state(theta), torch.from_numpy(theta).requires_grad_()
        loss, margins = in_torch.loss(leaf), in_torch.margins(leaf, problem.cuts)
        assert loss.item() == pytest.approx(state.loss, rel=1e-10)
        (slope,) = torch.autograd.grad(loss, leaf)
        expected = 2 * state.residual @ state.J
        np.testing.assert_allclose(slope.numpy(), expected, atol=1e-9 * np.abs(expected).max())
        np.testing.assert_allclose(margins.detach().numpy(), state.margins, rtol=1e-9)
        slopes = [torch.autograd.grad(one, leaf, retain_graph=True)[0] for one in margins]
        size = np.abs(state.M).max()
        np.testing.assert_allclose(np.array(slopes), state.M, atol=1e-9 * size)


def test_a_violating_model_ends_feasible_with_the_condition_active():
    points, true = data("sign-changing", 2.5)
    assert certify(true, spacing=1.0).symbol_min < -0.01
    learned = fit(points, horizon=2.5, kernel=Bernstein(4), conditions=Conditions(zeta=ZETA))
    assert ZETA <= learned.certificate.symbol_min <= 1.02 * ZETA
    assert learned.certificate.holds
    assert learned.material.certified_on == (1.0,)
    losses = np.array(list(learned.starts.values()))
    assert np.ptp(losses) < 1e-6 * losses.max()
    assert losses.min() > 1e-3


def test_the_printed_conditions_hold_densely_and_are_active():
    horizon = 3.0
    points, _ = data("sign-changing", horizon)
    learned = fit(points, horizon, Bernstein(5), conditions=Conditions("paper", ZETA))
    dense = certify(learned.material, spacing=1.0, points=points)
    assert dense.gamma_minus_2phi_min >= -1e-10 * dense.gamma_minus_2phi_max
    assert dense.schwarz
    assert dense.gamma_min > 0
    asked = Conditions("paper", ZETA)
    margins = smallest_margins(bond_classes(1.0, horizon), asked, *shares(learned.material))
    assert (margins >= -1e-8).all()
    # the model that made the data keeps (i) and breaks (iii)
    assert margins[2] == pytest.approx(0, abs=1e-6)
    assert min(learned.starts.values()) > 1e-3
    assert learned.material.certified_on == (1.0,)


@pytest.mark.parametrize("parametrisation", ["projected", "relu"])
def test_stage_one_stays_inside_its_bounds(parametrisation):
    points, _ = data("sign-changing", 3.0)
    method = replace(QUICK, parametrisation=parametrisation)
    for stage in fit(points, 3.0, Bernstein(5), method=method).history:
        parameters = stage.parameters
        assert parameters.mu > 0
        assert parameters.lam + parameters.mu > 0
        assert parameters.alpha < 3


def test_two_lattices_are_learned_together():
    sets, models = zip(*(data("positive", 2.0, spacing) for spacing in (1.0, 0.9)))
    learned = fit(sets, horizon=2.0, kernel=Bernstein(3))
    assert learned.material.trained_on == learned.material.certified_on == (1.0, 0.9)
    assert (learned.material.lam, learned.material.mu) == pytest.approx((LAM, MU), abs=1e-5)
    for model, points in zip(models, sets):
        found_tables, true_tables = (
            shares(learned.material, points.spacing),
            shares(model, points.spacing),
        )
        np.testing.assert_allclose(found_tables[0], true_tables[0], atol=1e-4)
        assert evaluate(learned.material, points)["E_res"] < 1e-4


def test_held_moduli_are_held():
    points, _ = data("positive", 3.0)
    held = fit(
        points, horizon=3.0, kernel=Bernstein(5), method=Optimum(moduli=(0.1, 0.65))
    ).material
    assert (held.lam, held.mu) == pytest.approx((0.1, 0.65), abs=1e-9)
    expected = {"C11": 0.1 + 2 * 0.65, "C12": 0.1, "C44": 0.65}
    assert moduli(held, bond_classes(1.0, 3.0)) == pytest.approx(expected, abs=1e-8)
    loose = fit(
        points, horizon=3.0, kernel=Bernstein(5), method=Optimum(moduli="isotropic")
    ).material
    assert moduli(loose, bond_classes(1.0, 3.0))["C44"] == pytest.approx(loose.mu, abs=1e-8)


def test_a_normalised_loss_does_not_see_the_size_of_a_sample():
    points, _ = data("positive", 3.0)
    points = replace(points, b=points.b + 0.1 * noise(points, 10))
    size = np.logspace(-1, 1, 10)[:, None, None]
    scaled = replace(points, u=size * points.u, b=size * points.b)
    first, second = (
        fit(samples, horizon=3.0, kernel=Bernstein(5), normalise=True).material
        for samples in (points, scaled)
    )
    assert (second.lam, second.mu) == pytest.approx((first.lam, first.mu), abs=1e-6)
    absolute = fit(scaled, horizon=3.0, kernel=Bernstein(5)).material
    assert abs(absolute.mu - first.mu) > 1e-4


def test_rows_that_depart_from_the_operator_are_caught(monkeypatch):
    points, _ = data("positive", 2.5)
    points = replace(points, b=points.b + 0.05 * noise(points, 10))
    rows = Products.rows

    def wrong(self, weight):
        right = rows(self, weight)
        return replace(right, y=right.y * (1 + 1e-4))

    monkeypatch.setattr(Products, "rows", wrong)
    with pytest.raises(RuntimeError, match="the residual by rows departs from the operator's by"):
        fit(points, horizon=2.5, kernel=Bernstein(3))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"horizon": 0.5}, r"horizon: expected at least one spacing \(1.0\), got 0.5"),
        ({"horizon": np.nan}, "horizon: expected at least one spacing"),
        ({"horizon": 1.5}, "no weights are exact for a family of 8 bonds"),
        ({"horizon": 3.0}, "twice the horizon: .* Å fits"),
        ({"method": "best"}, r"method: expected Optimum\(…\), TwoStage\(…\) or .* got 'best'"),
        ({"conditions": "paper"}, r"conditions: expected Conditions\(…\), got 'paper'"),
        ({"kernel": 10}, "expected an InfluenceFunction or a list of them"),
    ],
)
def test_bad_choices_are_refused(change, words):
    points, _ = data("positive", 2.0)
    with pytest.raises(InputError, match=words):
        fit(points, **{"horizon": 2.0, "kernel": Bernstein(2), **change})


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Bernstein(-1), "degree: expected a whole number ≥ 0, got -1"),
        (lambda: Bernstein(1.5), "degree: expected a whole number ≥ 0, got 1.5"),
        (lambda: Conditions("none"), "conditions: expected one of direct, paper, got 'none'"),
        (lambda: Conditions(zeta=-0.01), "zeta: expected a stiffness > 0, got -0.01"),
        (lambda: TwoStage(seed=-1), "seed: expected a whole number ≥ 0, got -1"),
        (lambda: TwoStage("best"), "parametrisation: expected one of projected, relu"),
        (lambda: TwoStage(constraints="none"), "constraints: expected one of symbol, dense"),
        (lambda: Optimum((0.3, -0.8)), "moduli: expected .* with μ > 0"),
        (lambda: Optimum(0.7), r"moduli: expected \(λ, μ\)"),
        (lambda: Optimum((0.7,)), r"moduli: expected \(λ, μ\)"),
        (lambda: Optimum((0.1, 0.7, 0.2)), r"moduli: expected \(λ, μ\)"),
        (lambda: Optimum("held"), "moduli: expected .* got 'held'"),
    ],
)
def test_settings_that_mean_nothing_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_sets_that_cannot_be_learned_from_are_refused():
    points, _ = data("positive", 2.0)
    none = np.empty((0, len(points.x), 2))
    for change, words in (
        ({"u": none, "b": none}, "no samples"),
        ({"b": 0 * points.b}, "no loads"),
        ({"points": replace(points.points, spacing=0.0)}, "got scattered points"),
    ):
        with pytest.raises(InputError, match=words):
            fit(replace(points, **change), 2.0, Bernstein(2))
    with pytest.raises(InputError, match="at least one training set"):
        fit([], 2.0, Bernstein(2))


def test_conditions_that_were_not_kept_in_the_end_are_an_error():
    points, _ = data("sign-changing", 3.0)
    method = Optimum(rounds=1)
    with pytest.raises(RuntimeError, match="no start ended with the conditions kept"):
        fit(points, 3.0, Bernstein(5), method=method, conditions=Conditions("paper"))
