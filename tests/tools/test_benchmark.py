"""Every subcommand of the benchmark runs on few nodes, and its rivals compute what we compute."""

import functools
from importlib.util import find_spec

import numpy as np
import pytest
import torch

import warp_peri as wp
from tools import benchmark
from warp_peri import launch


@pytest.fixture(autouse=True)
def same_threads():
    """The number of threads of before, which some of them change."""
    before = launch.threads(), torch.get_num_threads()
    yield
    launch.set_threads(before[0])
    torch.set_num_threads(before[1])


@pytest.mark.parametrize("what", [name for name in benchmark.KINDS if name != "front"])
def test_subcommands_run_at_quick_size(what, capsys):
    if what == "breaking" and find_spec("numba") is None:
        pytest.skip("needs Numba: pip install 'warp_peri[bench]'")
    assert benchmark.main([what, "--quick"]) == 0
    assert capsys.readouterr().out


@pytest.mark.filterwarnings("ignore")
def test_the_front_is_measured_at_quick_size_and_drawn(graphene, monkeypatch, tmp_path):
    pytest.importorskip("skfem")
    data = wp.load(graphene)
    seen, short = benchmark.split(data["train"])
    assert (len(seen), 0 < len(short) < 35) == (34, True)
    model = wp.fit(seen, wp.Micromodulus(12.5), progress=False).material
    elements = functools.partial(benchmark.elastic_solver, order=1, C=np.diag([1.0, 1.0, 0.4]))
    for prepare in (benchmark.by_rest(model), elements):
        setup, one, error = benchmark.timed(prepare, data["test"], [0])
        assert min(setup, one, error) > 0
    benchmark.draw(tmp_path / "front.png")
    assert (tmp_path / "front.png").stat().st_size > 10_000


def test_a_wrong_rival_is_found():
    right = {"one": lambda: np.ones(3)}
    with pytest.raises(RuntimeError, match="two is wrong by"):
        benchmark.report("x", right | {"two": lambda: 2 * np.ones(3)}, 1, 1, 1e-9)
