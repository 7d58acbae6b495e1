"""The rivals of the benchmark compute what the library computes."""

import importlib.util
import re

import numpy as np
import pytest
import torch

from tools import benchmark, rivals
from warp_peri.launch import set_threads, threads
from warp_peri.materials.lps_bonds import Bonds


@pytest.fixture(autouse=True)
def _threads():
    before = threads()
    yield
    set_threads(before)


@pytest.mark.parametrize("kind", ["lattice", "scattered"])
def test_rivals_agree(kind):
    points, box = benchmark.problem(kind, 12)
    bonds = Bonds(points, benchmark.HORIZON)
    fields = np.random.default_rng(0).normal(size=(2, len(points.x), 2))
    t = rivals.tables(bonds, points.x, np.array(box), *fields, **benchmark.MODEL)
    forward, both = (
        dict(zip(("first", "torch"), pair))
        for pair in zip(
            benchmark.ours(bonds, fields, torch.float64), rivals.torch_scatter(t, torch.float64)
        )
    )
    forward["csr"] = rivals.scipy_csr(t)
    forward["kept"] = benchmark.ours_kept(bonds, fields[0], torch.float64)
    for candidates in (forward, both):
        seconds = benchmark.interleaved(candidates, rounds=1, tolerance=1e-9)
        assert seconds.keys() == candidates.keys()
        candidates["wrong"] = lambda: [2 * np.ones(1)] * 3
        with pytest.raises((RuntimeError, ValueError)):
            benchmark.interleaved(candidates, rounds=1, tolerance=1e-9)


@pytest.mark.slow
@pytest.mark.skipif(not importlib.util.find_spec("numba"), reason="needs the extra bench")
@pytest.mark.filterwarnings("ignore")
def test_the_whole_benchmark_runs(capsys):
    assert benchmark.main(["operator", "--quick"]) == 0
    said = capsys.readouterr().out
    assert "Numba parallel" in said
    assert "of copy bandwidth" in said
    assert "LAMMPS peri/lps" in said


@pytest.mark.slow
def test_no_sweep_is_faster_than_the_arithmetic_it_does(capsys):
    assert benchmark.main(["roofline", "--quick"]) == 0
    shares = [int(share) for share in re.findall(r"(\d+) % of the arith", capsys.readouterr().out)]
    assert len(shares) == 4
    assert all(20 < share < 100 for share in shares)
