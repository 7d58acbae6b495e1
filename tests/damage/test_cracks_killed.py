"""A crack run that is killed by SIGKILL while it grows: the resumed one has the same bits."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests.support.bodies import pulled
from warp_peri.files.checkpoint import AllNodes, RunFile
from warp_peri.fracture.run import KIND, LEDGER, CrackRun

ROOT = Path(__file__).parent.parent.parent
CRACK = [[(-20, 0), (-4, 0)]]
STEPS, KILLS = 200, (70, 100, 130)


def crack_run(folder):
    """A body that breaks, and its run with a checkpoint at every record."""
    body = pulled(lam=0.4, critical_stretch=0.012)
    path = folder / "run.h5"
    return body, CrackRun(
        body, step=0.4 * body.longest_step, every=2, checkpoint=path, checkpoint_every=1
    )


def kept(checkpoint):
    """Steps behind a checkpoint, and the bonds left in it."""
    arrays, values = RunFile(checkpoint, KIND, AllNodes(len(pulled().body.x))).read("left")
    return values["steps"], int(arrays["left"].sum())


def main(folder):
    """March to the end, from the checkpoint if there is one; slowly, so that it can be killed."""
    body, run = crack_run(folder)
    state = body.start(cracks=CRACK)
    print("begun", flush=True)
    done = kept(folder / "run.h5")[0] if (folder / "run.h5").exists() else 0
    for steps in range(done + 2, STEPS + 1, 2):
        state = run.march(state, steps=steps)
        time.sleep(0.005)
    np.savez(
        folder / "end.npz",
        ledger=np.array([run.history[name] for name in LEDGER]),
        dissipated=state.dissipated,
        left=body.operator.kept(state.links),
        **{name: getattr(state, name).numpy() for name in ("u", "v", "links", "work")},
    )


def wait_for(checkpoint, least):
    """Until the checkpoint has come so far, however busy the machine is."""
    end = time.monotonic() + 60
    while time.monotonic() < end:
        if checkpoint.exists() and kept(checkpoint)[0] >= least:
            return
        time.sleep(0.005)
    raise TimeoutError(f"no checkpoint of {least} steps in a minute")


@pytest.mark.slow
def test_a_killed_crack_goes_on_with_the_same_bits(tmp_path):
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    for folder in (whole, broken):
        folder.mkdir()
    command = [sys.executable, "-m", "tests.damage.test_cracks_killed"]
    subprocess.run([*command, str(whole)], cwd=ROOT, check=True, capture_output=True)
    damaged = []
    for least in KILLS:
        with subprocess.Popen(
            [*command, str(broken)], cwd=ROOT, stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout.readline() == "begun\n"
            wait_for(broken / "run.h5", least)
            process.send_signal(signal.SIGKILL)
        assert process.returncode == -signal.SIGKILL
        damaged.append(crack_run(broken)[0].body.neighbour.size - kept(broken / "run.h5")[1])
    subprocess.run([*command, str(broken)], cwd=ROOT, check=True, capture_output=True)
    with np.load(whole / "end.npz") as want, np.load(broken / "end.npz") as got:
        final = int((~want["left"]).sum())
        assert damaged[0] < damaged[-1] < final  # killed while it grew
        for name in want:
            assert want[name].tobytes() == got[name].tobytes(), name


if __name__ == "__main__":
    main(Path(sys.argv[1]))
