"""Every subcommand of the benchmark runs, on few nodes."""

from importlib.util import find_spec

import pytest
import torch

from tools import benchmark
from warp_peri import launch

NEEDED = {"broken": "numba", "ranks": "mpi4py"}


@pytest.fixture(autouse=True)
def same_threads(monkeypatch):
    """The number of threads of before, which some of them change."""
    before = launch.threads(), torch.get_num_threads()
    monkeypatch.setattr(benchmark, "THREADS", benchmark.THREADS)
    yield
    launch.set_threads(before[0])
    torch.set_num_threads(before[1])


@pytest.mark.parametrize("what", benchmark.KINDS)
def test_quick_runs(what, capsys):
    if find_spec(NEEDED.get(what, "numpy")) is None:
        pytest.skip(f"needs {NEEDED[what]}")
    assert benchmark.main([what, "--quick"]) == 0
    assert capsys.readouterr().out
