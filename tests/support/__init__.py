"""What the tests share."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
parametrize = pytest.mark.parametrize
in_plane_and_space = parametrize("d", [2, 3])
"""Runs a test in both dimensions."""
shared = pytest.fixture(scope="module")
"""Makes a fixture once for all tests of a file."""
