"""Sweeps on Dask workers that are processes of their own, one of which is killed."""

import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from tests.support.problems import kernel, lattice, manufactured
from warp_peri import InputError
from warp_peri.cluster import scheduler
from warp_peri.methods import sweep

pytest.importorskip("distributed")
ROOT = Path(__file__).parent.parent.parent


def start(*words):
    command = [sys.executable, "-m", "dask", *words]
    path = {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen(command, env=os.environ | path, cwd=ROOT, **quiet)


@pytest.fixture
def cluster(tmp_path):
    """Address of a scheduler, and its two workers."""
    file = tmp_path / "scheduler.json"
    words = ("--scheduler-file", str(file))
    started = [start("scheduler", "--port", "0", "--dashboard-address", ":0", *words)]
    try:
        end = time.monotonic() + 60
        while not file.exists() and time.monotonic() < end:
            time.sleep(0.1)
        options = ("--nthreads", "1", "--no-nanny", "--no-dashboard")
        started += [start("worker", *words, *options) for _ in range(2)]
        yield json.loads(file.read_text())["address"], started[1:]
    finally:
        for process in reversed(started):
            process.kill()
            process.wait()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_sweep_survives_the_death_of_a_worker(cluster, tmp_path):
    address, workers = cluster
    model = kernel("positive", 2.5, lam=-0.2)
    sets = [manufactured(model, lattice(6, 3.0), 4, seed=seed) for seed in (0, 1)]
    cases = {"horizons": (2.0, 2.5, 3.0), "degrees": (1, 2)}
    folder = tmp_path / "sweep"
    folder.mkdir()
    killed_after = []

    def kill_one():
        while not (done := list(folder.glob("d*_M?_????????????.json"))):
            time.sleep(0.01)
        workers[0].kill()
        killed_after.append(len(done))

    killer = threading.Thread(target=kill_one, daemon=True)
    killer.start()
    with scheduler(address):
        survived = sweep(*sets, folder, **cases)
    killer.join(timeout=1)
    assert workers[0].wait(timeout=10) != 0
    assert workers[1].poll() is None
    assert 1 <= killed_after[0] < 6  # in the middle of the work
    here = sweep(*sets, tmp_path / "here", **cases, jobs=1)
    for trial, other in zip(survived.trials, here.trials, strict=True):
        assert (trial.horizon, trial.degree) == (other.horizon, other.degree)
        # fits to exact data end at rounding, where nothing is left to compare
        np.testing.assert_allclose(trial.E_res_val, other.E_res_val, rtol=1e-4, atol=1e-7)
    assert max(trial.E_res_val for trial in here.trials) > 1e-3


def test_no_scheduler_is_one_clear_error(monkeypatch):
    monkeypatch.setattr("warp_peri.cluster.WAIT", 0.5)
    with (
        pytest.raises(InputError, match="scheduler: no workers at tcp://127.0.0.1:9"),
        scheduler("tcp://127.0.0.1:9"),
    ):
        pass


def test_without_an_address_work_stays_here():
    with scheduler(None):
        pass
