"""The check allows what rounding leaves of kernels whose terms cancel, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import warp as wp

from tests.support.problems import kernel, lattice, manufactured
from warp_peri import Bernstein
from warp_peri.learning.fit import learn
from warp_peri.learning.training_data import ConsistencyCheck
from warp_peri.materials.lps import bernstein_basis
from warp_peri.methods import Constrained, Optimum
from warp_peri.regression.coordinates import Parameters
from warp_peri.regression.losses import FullLoss, reduce, sample_weights

HORIZON, DEGREE = 3.0, 12


@pytest.fixture(scope="module")
def losses():
    points = manufactured(kernel("positive", HORIZON), lattice(6, HORIZON), 4)
    (weight,) = sample_weights([points], normalise=False)
    return reduce(points, HORIZON, weight), FullLoss(points, HORIZON, weight)


def cancelling(classes, size):
    """A kernel of moderate values at the bond lengths, with coefficients of any size."""
    unseen = scipy.linalg.null_space(bernstein_basis(classes.r, HORIZON, DEGREE))
    D = np.linspace(1, 0.4, DEGREE + 1) + size * unseen[:, 0]
    return Parameters(0.2, 0.9, 1.0, D)


@pytest.mark.parametrize("size", [1e5, 1e7])
def test_rounding_of_a_cancelling_kernel_is_allowed(losses, size):
    reduced, full = losses
    oracle = ConsistencyCheck([reduced], [full])
    oracle.check(cancelling(reduced.classes, 0.0))
    oracle.check(cancelling(reduced.classes, size))


@pytest.mark.parametrize("size", [0.0, 1e5, 1e7])
def test_a_wrong_feature_is_found_however_the_kernel_cancels(losses, size):
    reduced, full = losses
    wrong = reduced.R.copy()
    wrong[:, 1] *= 1 + 1e-4
    check = ConsistencyCheck([replace(reduced, R=wrong)], [full])
    with pytest.raises(RuntimeError, match="departs from"):
        check.check(cancelling(reduced.classes, size))


def test_a_departure_that_no_answer_shows_ends_no_fit(losses):
    """Processors differ in the last digits of a sum: a fit is told of it, not ended by it."""
    reduced, full = losses
    rounded = reduced.R * (1 + 3e-10 * np.sin(np.arange(reduced.R.size)).reshape(reduced.R.shape))
    check = ConsistencyCheck([replace(reduced, R=rounded)], [full])
    with pytest.warns(UserWarning, match=r"the reduced \w+ departs from the full one by"):
        check.check(cancelling(reduced.classes, 0.0))
    rounded = reduced.R * (1 + 1e-15 * np.sin(np.arange(reduced.R.size)).reshape(reduced.R.shape))
    ConsistencyCheck([replace(reduced, R=rounded)], [full]).check(cancelling(reduced.classes, 0.0))


@pytest.mark.slow
def test_every_fit_holds_its_gradient_to_warps_tape(losses, monkeypatch):
    counted = []
    backward = wp.Tape.backward
    monkeypatch.setattr(
        wp.Tape, "backward", lambda tape, **how: counted.append(1) or backward(tape, **how)
    )
    points = manufactured(kernel("positive", HORIZON), lattice(6, HORIZON), 4)
    for method in (Optimum(), Constrained()):
        counted.clear()
        learn(points, HORIZON, Bernstein(2), method=method, progress=False)
        assert len(counted) == 2  # at the start and at the end
