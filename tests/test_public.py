"""The public face."""

import subprocess
import sys
from pathlib import Path

import pytest

import warp_peri

ROOT = Path(__file__).parent.parent


def test_every_public_name_is_there_and_documented():
    for name in warp_peri.__all__:
        assert getattr(warp_peri, name).__doc__, name
    assert sorted(warp_peri.__all__) == warp_peri.__all__


def test_input_errors_are_value_errors():
    assert issubclass(warp_peri.InputError, ValueError)


@pytest.mark.parametrize("name", ["kernels", "kernels.lps"])
def test_kernels_refuse_to_be_imported_under_another_name(name):
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, '.'); import {name}"]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert found.returncode == 1
    assert "ImportError: import warp_peri.kernels, not kernels" in found.stderr
