"""SIGKILL at random moments: what is finished stays, and the final files have the same bits."""

import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.support.jobs import JOBS
from warp_peri.files.atomic import PART

ROOT = Path(__file__).parent.parent.parent
LATER = 10
"""Kills of each job in the long run: 40 in all."""


def start(name, folder):
    """The job as a process, past its imports."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.support.jobs", name, str(folder)],
        cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout.readline() == "imported\n"
    return process


def finish(process):
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    return out.split()


def contents(folder, names):
    return {name: (folder / name).read_bytes() for name in names}


def wait_for_a_write(process, folder, count):
    """Return at the moment when the process begins its `count`-th file, or when it ends."""
    seen = set()
    while process.poll() is None and len(seen) < count:
        seen |= {path.name for path in folder.rglob(f".*{PART}*")}
        time.sleep(2e-4)


def kill_and_resume(name, folder, kills, seed):
    """Kill a job so often, at random moments, half of them while it writes a file."""
    rng = random.Random(seed)
    whole = folder / "whole"
    whole.mkdir()
    process = start(name, whole)
    begin = time.perf_counter()
    names = finish(process)
    seconds = time.perf_counter() - begin
    expected = contents(whole, names)
    hit = 0
    for attempt in range(20 * kills):
        broken = folder / f"broken{attempt}"
        broken.mkdir()
        again = True
        while again and hit < kills:  # some are killed once more, further on
            process = start(name, broken)
            begin = time.perf_counter()
            if rng.random() < 0.5:
                wait_for_a_write(process, broken, rng.randint(1, 6))
            else:
                time.sleep(rng.uniform(0, seconds))
            process.send_signal(signal.SIGKILL)
            process.communicate()
            if process.returncode == -signal.SIGKILL:
                hit += 1
            else:  # it had ended: the machine is faster now than it was
                seconds = min(seconds, time.perf_counter() - begin)
            again = rng.random() < 0.4
        assert sorted(finish(start(name, broken))) == sorted(names)
        assert contents(broken, names) == expected
        assert [path for path in broken.rglob(".*") if path.is_file()] == []
        if hit == kills:
            return hit
    return hit


@pytest.mark.slow
@pytest.mark.parametrize("name", JOBS)
def test_ten_kills_of_each_job(name, tmp_path):
    assert kill_and_resume(name, tmp_path, LATER, seed=2) == LATER
