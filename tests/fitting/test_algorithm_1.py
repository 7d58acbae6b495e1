"""Adam: to the optimum on Warp's operator, and Algorithm 1 with its margins and checkpoint."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.autograd import grad

from tests.support import approx, filterwarnings, near, parametrize, refused
from tests.support.problems import difference, ell, kernel, lattice, manufactured
from tests.support.solving import fit
from tests.support.symbols import smallest_margins
from warp_peri import LPS, Bernstein, LPSMaterial, certify
from warp_peri.files.checkpoint import ArrayFile, fingerprint
from warp_peri.fitting import augmented_lagrangian
from warp_peri.fitting.augmented_lagrangian import as_printed, margins_of, printed_state
from warp_peri.fitting.regression import Regression
from warp_peri.materials import lps_force
from warp_peri.materials.lps import LPSParameters, stiffnesses
from warp_peri.materials.lps_fit import Learner
from warp_peri.materials.lps_law import LPSFound, LPSLaw
from warp_peri.materials.lps_stages import DENSE_ZETA, PRINTED_HORIZON, DenseMargins, in_torch
from warp_peri.methods import AugmentedLagrangian, GaussNewton, StabilityConditions, TwoStage
from warp_peri.points.families import bond_classes

HORIZON, ZETA = 3.0, 0.02

pytestmark = filterwarnings("ignore:spacing")


def violating():
    """Samples of a model that breaks the conditions, so that they bind."""
    model = kernel("sign-changing", 2.5, lam=-0.2, mu=0.7)
    assert certify(model, spacing=1.0).symbol_min < -0.01
    return manufactured(model, lattice(6, 2.5), 10, wave_number=2.0, allow_uncertified=True)


def test_adam_by_itself_reaches_the_constrained_optimum():
    method = AugmentedLagrangian(1, optimum=GaussNewton(moduli=(-0.2, 0.77)))
    asked = StabilityConditions("paper", 0.01)
    learned = fit(violating(), 2.5, Bernstein(4), method=method, conditions=asked)
    first, second = learned.history
    assert (first.name, second.name) == ("1 Adam", "3 constrained")
    assert min(learned.starts.values()) > 1e-3
    assert first.loss[-1] <= 1.001 * second.loss[-1]
    model, classes = LPSMaterial(*first.parameters.values(), 2.5), bond_classes(1.0, 2.5)
    assert smallest_margins(classes, asked, *stiffnesses(model, classes)).min() >= -1e-6


def test_adam_follows_the_gradient_of_warps_operator(monkeypatch):
    """Each step takes one of Warp's, which torch carries on to θ, the slope of the exact rows."""
    points = violating()
    taken, gradient = [], lps_force.Law.gradient
    monkeypatch.setattr(
        lps_force.Law, "gradient", lambda *of, **how: taken.append(1) or gradient(*of, **how)
    )
    free = GaussNewton(moduli=None, smoothness=0.0)
    method = AugmentedLagrangian(rounds=2, steps=10, optimum=free)
    first = fit(points, 2.5, Bernstein(2), method=method).history[0]
    assert first.steps == len(taken) == 2 * (10 + 1)
    law = LPS(2.5, Bernstein(2), conditions=StabilityConditions("paper", ZETA))
    given = Learner(law, [points, points[:3]], [], None)
    for degree in (2, 4):  # with α free, and where it says what D says
        start = LPSFound(LPSParameters(-0.1, 0.8, 1.3, np.linspace(1, 0.2, degree + 1)))
        law = LPSLaw(given.lattices, start, given.conditions, free)
        problem = Regression(given.blocks, law, law.zeta, 1.0)
        theta = law.start(start) * (1 + 0.01 * np.arange(len(law.start(start))))
        problem.look(law(theta))
        state, leaf = problem.state(theta), torch.from_numpy(theta).requires_grad_()
        loss = in_torch(given.products, given.weights, law)(leaf)
        near(loss.item(), state.loss, 1e-10)
        (slope,) = grad(loss, leaf)
        near(slope.numpy(), 2 * state.residual @ state.J, 1e-9)
        slopes = [grad(m, leaf, retain_graph=True)[0].numpy() for m in margins_of(problem, leaf)]
        near(slopes, state.M, 0)


@parametrize(("interior", "blocks"), [(ell(), 1), (np.ones((6, 5), bool), 4), (6, 5)])
def test_dense_margins_are_those_of_the_certificate_with_their_slopes(interior, blocks):
    model, points = kernel("sign-changing", HORIZON), lattice(interior, HORIZON)
    margins = DenseMargins([points], HORIZON)
    assert len(margins.parts[0][1]) == blocks
    values = lambda x: margins(x[0], x[1:])
    given = torch.from_numpy(np.append(model.alpha, model.D))
    found, certificate = values(given).numpy(), certify(model, spacing=1.0, points=points)
    unit = (HORIZON / PRINTED_HORIZON) ** 2
    assert certificate.inf_sup_rank == points.interior.sum()
    expected = [unit * certificate.gamma_min, certificate.inf_sup_min]
    assert found[:2] + DENSE_ZETA == approx(expected, rel=1e-6, abs=0)
    near(found[2], unit * certificate.gamma_minus_2phi_min, 1e-9)
    slope = difference(lambda x: values(torch.from_numpy(x)).numpy(), given.numpy(), 1e-5).T
    found = torch.autograd.functional.jacobian(values, given).numpy()
    near(found, slope, 1e-7)


@pytest.fixture
def points():
    return manufactured(kernel("positive", 2.5, lam=-0.2), lattice(5, 2.5), 6)


QUICK = TwoStage(epochs=60, inner_epochs=10, outer_iterations=4)


def run(points, checkpoint=None, degree=3, **how):
    method = replace(QUICK, checkpoint=checkpoint)
    return fit(points, 2.5, Bernstein(degree), method=method, **how).history[-1]


def test_resumed_is_unbroken_and_what_is_finished_is_not_run_again(points, tmp_path, monkeypatch):
    unbroken, path = run(points), tmp_path / "state.h5"
    solid = unbroken.parameters
    assert min(solid.mu, solid.lam + solid.mu, 3 - solid.alpha) > 0
    save, saved = ArrayFile.write, []

    def killed(self, arrays):
        save(self, arrays)
        saved.append((self, arrays))
        if len(saved) == 3:
            raise KeyboardInterrupt

    def same(again):
        assert again.loss == unbroken.loss
        assert fingerprint(again.parameters) == fingerprint(solid)

    with monkeypatch.context() as patch:
        patch.setattr(ArrayFile, "write", killed)
        with pytest.raises(KeyboardInterrupt):
            run(points, path)
    same(run(points, path))
    monkeypatch.setattr(augmented_lagrangian, "adam", None)  # which is not called again
    same(run(points, path))
    for other in ({"degree": 4}, {"normalise": True}):
        with refused("other data or settings"):
            run(points, path, **other)
    file, arrays = saved[-1]
    for wrong in ({"tensor0": np.ones(5)}, {"losses": [np.nan]}, {"losses": np.eye(2)}):
        file.write(arrays | wrong)
        with refused("not a readable checkpoint"):
            run(points, path)


def test_the_multiplier_climbs_with_the_violation():
    """One condition with a margin that nothing changes."""
    zero, state = torch.zeros(1, dtype=torch.float64), printed_state(1)
    once = TwoStage(inner_epochs=0, outer_iterations=1)
    as_printed(state, [], lambda: zero.sum(), lambda: zero + 0.5, once, lambda loss: None)
    slack, multiplier, previous, *_ = state
    assert slack == 1.0
    assert multiplier == 1.0 * (0.5 - slack**2)  # φ ← φ + ψ H, H = margin − ϖ²
    assert previous == 0.5
