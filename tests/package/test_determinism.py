"""Same seed, same machine, same bits: fits, solves and sweeps, in fresh processes and threads."""

import hashlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.support.jobs import problem
from tests.support.problems import kernel, lattice, noise
from tests.support.solving import solve
from warp_peri.launch import set_threads, threads
from warp_peri.transfer.operator import LPSOperator

ROOT = Path(__file__).parent.parent.parent
LEARN = """
import hashlib, sys
import numpy as np
from tests.support.jobs import problem
from warp_peri import Bernstein
from warp_peri.methods import Constrained
from warp_peri.learning.fit import learn as fit
from tests.support.solving import solve
points = problem()
digest = lambda *parts: hashlib.sha256(b"".join(np.asarray(p).tobytes() for p in parts)).hexdigest()
for seed in map(int, sys.argv[1:]):
    model = fit(points, 2.5, Bernstein(4), method=Constrained(seed, rounds=9)).material
    u = solve(model, points, points.b, points.u, allow_uncertified=True)
    print(digest(model.lam, model.mu, model.alpha, model.D), digest(u))
"""


def learn(seeds, threads):
    """Hashes of models and of solves with them, made in a process of its own."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    environment = os.environ | dict.fromkeys(names, str(threads))
    process = subprocess.run(
        [sys.executable, "-c", LEARN, *map(str, seeds)],
        cwd=ROOT, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
    return process.stdout.split()


def test_a_seed_decides_every_bit_of_a_fit_and_a_solve():
    first, again = learn((3, 4), threads=2), learn((3,), threads=2)
    assert first[:2] == again
    assert first[0] != first[2]


@pytest.fixture
def _threads():
    before = threads()
    yield
    set_threads(before)


@pytest.mark.usefixtures("_threads")
def test_sweeps_and_solves_have_the_same_bits_on_any_number_of_threads():
    points, model = lattice(70, 2.5), kernel("positive", 2.5)
    u = noise(points)
    hashes = set()
    for count in (1, 2, 3, 5):
        set_threads(count)
        Lu = LPSOperator(model, points)(u)
        hashes.add(hashlib.sha256(Lu.tobytes()).hexdigest())
    assert len(hashes) == 1
    small = problem()
    solutions = set()
    for count in (1, 2, 3):
        set_threads(count)
        model = kernel("positive", 2.5, lam=-0.2)
        solutions.add(solve(model, small, small.b, small.u).tobytes())
    assert len(solutions) == 1
    assert np.isfinite(np.frombuffer(solutions.pop())).all()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes do not fork here")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
@pytest.mark.usefixtures("_threads")
def test_a_process_that_forks_after_threads_have_run_has_threads_of_its_own(monkeypatch):
    monkeypatch.setattr("warp_peri.launch.SLICE", 10)
    set_threads(2)
    points = lattice(10, 2.5)
    operator, u = LPSOperator(kernel("positive", 2.5), points), noise(points)
    expected = operator(u)
    child = os.fork()
    if child == 0:  # an alarm ends it where it waits for threads that are not there
        signal.alarm(20)
        status = 1
        try:
            status = int(not np.array_equal(operator(u), expected))
        finally:
            os._exit(status)
    assert os.waitpid(child, 0)[1] == 0
