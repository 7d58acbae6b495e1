"""Same seed, same machine, same bits: fits, solves and sweeps, in fresh processes and threads."""

import hashlib
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from tests.support.jobs import problem
from tests.support.problems import kernel, lattice, noise
from tests.support.solving import solve
from warp_peri import Bernstein
from warp_peri.launch import at_once, set_threads, threads
from warp_peri.learning.fit import learn as fit
from warp_peri.methods import TwoStage

ROOT = Path(__file__).parent.parent.parent
LEARN = """
import sys
from tests.package.test_determinism import learned
print(*learned(int(sys.argv[1])))
"""


def learned(seed):
    """Hashes of a model and of a solve with it."""
    points = problem()
    stages = TwoStage(seed=seed, epochs=20, inner_epochs=10, outer_iterations=2)
    model = fit(points, 2.5, Bernstein(4), method=stages).material
    u = solve(model, points, points.b, points.u, allow_uncertified=True)
    parts = (model.lam, model.mu, model.alpha, model.D), (u,)
    return [
        hashlib.sha256(b"".join(np.asarray(each).tobytes() for each in part)).hexdigest()
        for part in parts
    ]


@pytest.mark.filterwarnings("ignore")
def test_a_seed_decides_every_bit_of_a_fit_and_a_solve():
    """In this process, after whatever ran in it, and in one of its own."""
    again = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", LEARN, "3"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert again.returncode == 0, again.stderr
    assert learned(3) == again.stdout.split()
    assert learned(4)[0] != again.stdout.split()[0]


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
        Lu = model.on(points)(u)
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
    operator, u = kernel("positive", 2.5).on(points), noise(points)
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


@pytest.mark.usefixtures("_threads")
def test_sweeps_of_several_threads_at_once_share_helpers_and_none_takes_another_field(monkeypatch):
    monkeypatch.setattr("warp_peri.launch.SLICE", 10)
    set_threads(3)
    points = lattice(20, 2.5)
    operator = kernel("positive", 2.5).on(points)
    fields = [noise(points, seed=n) for n in range(3)]
    expected, wrong = [operator(u) for u in fields], []

    def sweeps(n):
        for _ in range(100):
            if not np.array_equal(operator(fields[n]), expected[n]):
                wrong.append(n)
            at_once([list, list])  # helpers leave and come again

    users = [threading.Thread(target=sweeps, args=(n,)) for n in range(3)]
    for user in users:
        user.start()
    for user in users:
        user.join()
    assert not wrong


def test_every_job_is_done_once_and_a_failure_of_a_helper_is_told():
    before = threads()
    set_threads(3)
    try:
        done = []
        at_once([lambda n=n: (time.sleep(0.002), done.append(n)) for n in range(20)])
        assert sorted(done) == list(range(20))
        inner = [lambda: at_once([lambda: done.append(0)] * 4)] * 4  # a helper may ask others
        at_once(inner)
        assert len(done) == 36
        main = threading.get_ident()

        def fails_elsewhere():
            time.sleep(0.01)
            if threading.get_ident() != main:
                raise KeyError("of a helper")

        with pytest.raises(KeyError, match="of a helper"):
            at_once([fails_elsewhere] * 30)
    finally:
        set_threads(before)
