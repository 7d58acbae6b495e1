"""What the tests share."""

from json import loads
from pathlib import Path

import numpy as np
import pytest
from numpy.linalg import norm

from tests.support.told import assert_refused as assert_refused
from tests.support.told import each_refused as each_refused
from tests.support.told import refused as refused
from tests.support.told import warned as warned
from warp_peri.testing import assert_near as near  # noqa: F401

ROOT = Path(__file__).parent.parent.parent
parametrize = pytest.mark.parametrize
filterwarnings = pytest.mark.filterwarnings
approx = pytest.approx
slow = pytest.mark.slow
in_plane_and_space = parametrize("d", [2, 3])
"""Runs a test in both dimensions."""
shared = pytest.fixture(scope="module")
"""Makes a fixture once for all tests of a file."""
sup = lambda values: np.abs(values).max()
"""The largest size of an entry."""
norms = lambda *fields: [norm(one, axis=(1, 2)) for one in fields]
"""The sizes of the samples of each."""
of_json = lambda path: loads(path.read_text("utf-8"))
"""What a file of JSON holds."""


def masked(values, place=0):
    """An array of which one entry is masked."""
    return np.ma.array(values, mask=np.arange(np.size(values)).reshape(np.shape(values)) == place)
