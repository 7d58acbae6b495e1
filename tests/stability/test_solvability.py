"""The smallest eigenvalue of large matrices."""

import numpy as np
import pytest
import scipy.sparse as sp

from warp_peri.stability.certificate import DENSE, smallest_eigenvalue


def test_a_mode_that_changes_sign_across_a_symmetric_body_is_found():
    """Two halves and a bond between them: the lowest mode is antisymmetric."""
    half = DENSE
    chain = sp.diags_array(np.append(0.5, np.linspace(1.0, 2.0, half - 1)))
    body = sp.csc_array(sp.block_array([[chain, sp.eye_array(half)], [sp.eye_array(half), chain]]))
    assert smallest_eigenvalue(body) == pytest.approx(-0.5, rel=1e-5)
