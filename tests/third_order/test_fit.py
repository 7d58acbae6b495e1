"""Learning nonlinear solids: what made the data is found again, with its guarantee."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from tests.support.learning import fit
from tests.support.nonlinear import CONSTANTS, FORMS, solid
from tests.support.problems import lattice, smooth
from warp_peri import Bernstein, InputError, Samples, evaluate
from warp_peri.learning.nonlinear import Nonlinear
from warp_peri.methods import Optimum, TwoStage
from warp_peri.third_order.material import NonlinearModel
from warp_peri.third_order.operator import PlacedThirdOrder

HORIZON = 2.5


NOISE = 1e-4
"""Of the loads, relative: an exact fit has no optimum to settle at."""


def samples_of(model, size, seed=0, count=6):
    """Smooth fields in equilibrium with a model, nearly."""
    points = lattice(6, HORIZON)
    u = size * smooth(points.x, count, seed, wave_number=0.8)
    b = np.zeros_like(u)
    b[:, points.interior] = PlacedThirdOrder(model, points)(u)
    b *= 1 + NOISE * np.random.default_rng(seed).normal(size=b.shape)
    return Samples(points, u, b)


@pytest.fixture(scope="module", params=FORMS)
def learned(request):
    """A model whose shear modulus is that of long waves, data it made, their fit, its warnings."""
    known = solid(request.param, HORIZON)
    known = replace(known, linear=replace(known.linear, alpha=1.0, D=[1.0], D_dilatation=[1.0]))
    train = samples_of(known, 0.02)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        result = fit(
            train,
            HORIZON,
            Bernstein(3, two_functions=True),
            method=Optimum(moduli="isotropic"),
            normalise=True,
            nonlinear=Nonlinear(known.smoothing),
        )
    return known, train, result, [str(warning.message) for warning in said]


def test_what_made_the_data_is_found_again(learned):
    known, _, result, _ = learned
    model = result.material
    assert result.E_res_train < 1.1 * NOISE
    assert np.allclose([model.t3, model.tq2, model.q3], CONSTANTS, rtol=0.02)
    assert np.allclose(model.numbers[:2], known.numbers[:2], rtol=1e-3)
    assert model.linear.certified_on == (1.0,)
    assert model.proven_strain(1.0) > 0.005
    unseen = evaluate(model, samples_of(known, 0.008, seed=5, count=2))
    assert unseen["E_res"] < 1.2 * NOISE
    assert unseen["E_u"] < NOISE
    assert unseen["unique"]
    assert result.linear.history[-1].E_res_train > 10 * result.E_res_train
    assert isinstance(model, NonlinearModel)


def test_data_beyond_the_proven_strain_name_the_option_that_proves_more(learned):
    known, _, result, said = learned
    beyond = result.largest_gradient > result.material.proven_strain(1.0)
    assert result.largest_gradient > 0.02
    assert beyond == (known.form == "filtered")  # whose gradient is that of fields not smoothed
    options = [message for message in said if "Conditions(zeta=…)" in message]
    assert len(options) == len(said) == int(beyond)
    assert all("ridge" in message for message in options)


def test_what_cannot_be_learned_from_is_refused(learned):
    _, train, *_ = learned
    three = Nonlinear()
    for words, wrong in (
        (r"method: expected Optimum\(…\) .* got TwoStage", {"method": TwoStage()}),
        ("kernel: expected Bernstein", {"kernel": 3}),
        (r"nonlinear: expected Nonlinear\(…\)", {"nonlinear": "energy"}),
        ("loss: a nonlinear solid has 'residual' only", {"loss": "output"}),
        ("noise: expected none", {"noise": train}),
    ):
        with pytest.raises(InputError, match=words):
            fit(train, HORIZON, **({"nonlinear": three} | wrong))
    scattered = replace(train.points, spacing=0.0)
    with pytest.raises(InputError, match=r"lattices of one spacing, got \[0.0\]"):
        fit(Samples(scattered, train.u, train.b), HORIZON, nonlinear=three)
    with pytest.raises(InputError, match="loads are not known"):
        fit(replace(train, b=None), HORIZON, nonlinear=three)
    with pytest.raises(InputError, match="expected Smoothing"):
        Nonlinear(smoothing=10.0)
