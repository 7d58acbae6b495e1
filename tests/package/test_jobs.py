"""Jobs beside one another: locks, kills, threads and forks."""

import os
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from tests.support import ROOT, filterwarnings, parametrize, refused
from tests.support.problems import kernel, lattice, noise
from warp_peri.cluster import scheduler
from warp_peri.files.atomic import locked, write_text
from warp_peri.runtime import at_once

HOLD = """
import sys
from warp_peri.cluster import scheduler
from warp_peri.files.atomic import locked, whole_file
with locked(sys.argv[1]), whole_file(sys.argv[2]) as part:
    part.write_text("half")
    print(part, flush=True)
    sys.stdin.readline()
"""


@parametrize("name", ["m.json", "a[b]*.h5"])
def test_a_second_job_is_refused_and_a_killed_one_holds_nothing(name, tmp_path):
    """And no file is removed but those of the process itself."""
    target, out = tmp_path / name, tmp_path / "out"
    how = {"cwd": ROOT, "text": True, "stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    calls = ([sys.executable, "-c", HOLD, tmp_path / f"out{n}", target] for n in range(2))
    jobs = [subprocess.Popen(call, **how) for call in calls]
    parts = [Path(job.stdout.readline().strip()) for job in jobs]
    jobs[0].kill()
    jobs[0].communicate()
    (tmp_path / "link").symlink_to(tmp_path / "out1")
    for held in ("out1", "link"):
        with refused("another job is writing here"):
            locked(tmp_path / held).__enter__()
    with locked(tmp_path / "out0"), locked(out):
        write_text(target, "mine")
    assert all(part.exists() for part in parts)
    jobs[1].communicate("\n")
    assert target.read_text() == "half"
    assert sorted(tmp_path.iterdir()) == sorted([parts[0], target, tmp_path / "link"])
    (tmp_path / ".out.lock").write_text("mine")
    with refused(r"\.out\.lock: expected no file, or an empty one"):
        locked(out).__enter__()


def test_no_scheduler_is_one_clear_error(monkeypatch):
    monkeypatch.setattr("warp_peri.cluster.WAIT", 0.5)
    words = r"no workers at tcp://127.0.0.1:9|pip install 'warp_peri\[cluster\]'"
    with scheduler(None), refused(words):  # none: work stays here
        scheduler("tcp://127.0.0.1:9").__enter__()


@pytest.fixture
def operator(monkeypatch, threads):
    """On more threads than one, however few nodes there are."""
    monkeypatch.setattr("warp_peri.runtime.SLICE", 10)
    threads(3)
    return kernel("positive", 2.5).on(lattice(20, 2.5))


@filterwarnings("ignore:.*fork:DeprecationWarning")
def test_threads_share_helpers_and_a_fork_has_its_own(operator):
    fields = [noise(operator.points, seed=n) for n in range(3)]
    expected, wrong = [operator(u) for u in fields], []

    def sweeps(n):
        for _ in range(100):
            wrong.extend([n] * (not np.array_equal(operator(fields[n]), expected[n])))
            at_once([list, list])  # helpers leave and come again

    with ThreadPoolExecutor(3) as users:
        list(users.map(sweeps, range(3)))
    assert not wrong
    if (child := os.fork()) == 0:  # an alarm ends it where it waits for threads that are not there
        signal.alarm(20)
        os._exit(int(not np.array_equal(operator(fields[0]), expected[0])))
    assert os.waitpid(child, 0)[1] == 0


def test_every_job_is_done_once_and_a_failure_of_a_helper_is_told(operator):
    done, main = [], threading.get_ident()
    at_once([lambda: at_once([lambda: done.append(0)] * 4)] * 4)  # a helper may ask others
    assert len(done) == 16
    gate = threading.Event()

    def fails_elsewhere():
        if threading.get_ident() == main:
            gate.wait(20)
        else:
            gate.set()
            raise KeyError("of a helper")

    with pytest.raises(KeyError, match="of a helper"):
        at_once([fails_elsewhere] * 30)
