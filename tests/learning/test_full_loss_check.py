"""Rows of the residual are held to Warp's operator, whatever rounding leaves of a kernel."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from tests.support.problems import kernel, lattice, manufactured
from warp_peri.learning.fit import training_data
from warp_peri.materials.lps import Solid, bernstein_basis
from warp_peri.methods import Conditions

HORIZON, DEGREE = 3.0, 12


@pytest.fixture
def data():
    points = manufactured(kernel("positive", HORIZON), lattice(6, HORIZON), 4)
    return training_data([points], HORIZON, Conditions(), [], normalise=False)


def cancelling(data, size):
    """A kernel of moderate values at the bond lengths, with coefficients of any size."""
    unseen = scipy.linalg.null_space(bernstein_basis(data.lattices[0].r, HORIZON, DEGREE))
    D = np.linspace(1, 0.4, DEGREE + 1) + size * unseen[:, 0]
    return Solid(0.2, 0.9, 1.0, D)


@pytest.mark.parametrize("size", [0.0, 1e5, 1e7])
def test_rounding_is_allowed_and_a_wrong_row_is_found(data, size):
    data.check(cancelling(data, size))
    (rows,) = data.rows
    R = rows.R.copy()
    R[:, 1] *= 1 + 1e-4
    data.rows[0] = replace(rows, R=R)
    with pytest.raises(RuntimeError, match="departs from"):
        data.check(cancelling(data, size))
