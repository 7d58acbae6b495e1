"""The oracle allows what rounding leaves of kernels whose terms cancel, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from tests.support.problems import kernel, lattice, manufactured
from warp_peri.learning.full_loss_check import Oracle
from warp_peri.losses.full import FullLoss, sample_weights
from warp_peri.losses.reduced import reduce
from warp_peri.models.influence import bernstein_basis
from warp_peri.regression.parameters import Parameters

HORIZON, DEGREE = 3.0, 12


@pytest.fixture(scope="module")
def losses():
    points = manufactured(kernel("positive", HORIZON), lattice(6, HORIZON), 4)
    (weight,) = sample_weights([points], normalise=False)
    return reduce(points, HORIZON, weight), FullLoss(points, HORIZON, weight)


def cancelling(classes, size):
    """Two kernels of moderate values at the bond lengths, with coefficients of any size."""
    unseen = scipy.linalg.null_space(bernstein_basis(classes.r, HORIZON, DEGREE))
    D, own = (np.linspace(1, end, DEGREE + 1) + size * unseen[:, 0] for end in (0.4, 1.5))
    return Parameters(0.2, 0.9, 1.0, D, D_dilatation=own)


@pytest.mark.parametrize("size", [1e5, 1e7])
def test_rounding_of_a_cancelling_kernel_is_allowed(losses, size):
    reduced, full = losses
    oracle = Oracle([reduced], [full])
    oracle.check(cancelling(reduced.classes, 0.0))
    oracle.check(cancelling(reduced.classes, size))


@pytest.mark.parametrize("size", [0.0, 1e5, 1e7])
def test_a_wrong_feature_is_found_however_the_kernel_cancels(losses, size):
    reduced, full = losses
    wrong = reduced.R.copy()
    wrong[:, 1] *= 1 + 1e-6
    oracle = Oracle([replace(reduced, R=wrong)], [full])
    with pytest.raises(RuntimeError, match="departs from"):
        oracle.check(cancelling(reduced.classes, size))
