"""SIGKILL at random moments: what is finished stays, and the final files have the same bits."""

import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.jobs import JOBS

ROOT = Path(__file__).parent.parent
KILLS = {"data": 2, "sweep": 2, "training": 1}
LATER = 10
"""Kills of each job in the long run: 30 in all."""


def start(name, folder):
    """The job as a process, past its imports."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.jobs", name, str(folder)],
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


def kill_and_resume(name, folder, kills, seed):
    """Kill a job so often, each time at a random moment; returns how many kills it took alive."""
    rng = random.Random(seed)
    whole = folder / "whole"
    whole.mkdir()
    begin = time.perf_counter()
    process = start(name, whole)
    imported = time.perf_counter()
    names = finish(process)
    seconds = time.perf_counter() - imported
    expected = contents(whole, names)
    assert imported - begin < 300
    hit, run = 0, 0
    broken = folder / "broken0"
    broken.mkdir()
    while hit < kills:
        process = start(name, broken)
        time.sleep(rng.uniform(0, 1.1 * seconds))
        process.send_signal(signal.SIGKILL)
        process.communicate()
        if process.returncode == -signal.SIGKILL:
            hit += 1
        if hit == kills or rng.random() < 0.5:  # else it is killed again, further on
            assert sorted(finish(start(name, broken))) == sorted(names)
            assert contents(broken, names) == expected
            left = [path for path in broken.rglob(".*") if path.is_file()]
            assert left == []
            run += 1
            broken = folder / f"broken{run}"
            broken.mkdir()
    return hit


@pytest.mark.parametrize("name", JOBS)
def test_a_killed_job_resumes_to_the_same_bits(name, tmp_path):
    assert kill_and_resume(name, tmp_path, KILLS[name], seed=1) == KILLS[name]


@pytest.mark.slow
@pytest.mark.parametrize("name", JOBS)
def test_ten_kills_of_each_job(name, tmp_path):
    assert kill_and_resume(name, tmp_path, LATER, seed=2) == LATER
