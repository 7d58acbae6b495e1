"""A disk that fills up mid-write: a clear error, the old file intact, and nothing half-written."""

import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
WRITE = """
import sys, resource, signal
from pathlib import Path
import numpy as np
from tests.support.mutations import good_data, good_model
from warp_peri import Samples, Dataset
from warp_peri.points.dataset import save_dataset
from warp_peri.points.dataset import content_hash, load_dataset
from warp_peri.files.atomic import ArrayFile, write_json

folder, limit = Path(sys.argv[1]), int(sys.argv[2])
small = good_data(folder / "g.h5")
good_model().save(folder / "m.json")
write_json(folder / "r.json", {"a": 1})
ArrayFile(folder / "c.npz", "key", "another run").write({"a": np.ones(3)})
before = {path.name: path.read_bytes() for path in sorted(folder.iterdir())}
if limit:
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # a write beyond the limit is then an error
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
points = small["train"]
many = Samples(points.points, np.ones((9000, len(points.x), 2)), np.zeros((9000, len(points.x), 2)))
big = Dataset({"train": many}, 3.35, 2267.0)
jobs = {
    "g.h5": lambda: save_dataset(folder / "g.h5", big),
    "r.json": lambda: write_json(folder / "r.json", {"a": list(range(300_000))}),
    "c.npz": lambda: ArrayFile(folder / "c.npz", "key", "").write({"a": np.ones(300_000)}),
}
for name, job in jobs.items():
    try:
        job()
        print("WRITTEN", name)
    except OSError as error:
        print("refused", name, error.errno, flush=True)
after = {path.name: path.read_bytes() for path in sorted(folder.iterdir())}
assert after == before, sorted(after)
assert content_hash(load_dataset(folder / "g.h5")) == content_hash(small)
print("intact")
"""


def run(command):
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def check(process):
    lines = process.stdout.splitlines()
    assert process.returncode == 0, process.stderr
    assert [line.split()[:2] for line in lines] == [
        ["refused", "g.h5"], ["refused", "r.json"], ["refused", "c.npz"], ["intact"],
    ]  # fmt: skip


def test_files_that_outgrow_their_limit(tmp_path):
    assert hasattr(signal, "SIGXFSZ")
    assert hasattr(resource, "RLIMIT_FSIZE")
    check(run([sys.executable, "-c", WRITE, str(tmp_path), str(2**20)]))


@pytest.mark.slow  # the limit above has the same refusals
def test_a_small_disk_fills_up(tmp_path):
    """A disk of 1 MB of its own, in a name space of its own; needs no rights where those exist."""
    private = ["unshare", "--user", "--map-root-user", "--mount"]
    mount = f"mount -t tmpfs -o size=1m none {tmp_path}"
    if run([*private, "sh", "-c", mount]).returncode:
        private = ["unshare", "--mount"]
        if run([*private, "sh", "-c", mount]).returncode:
            pytest.skip("no private mounts here")
    script = f'{mount} && exec "$@"'
    job = [sys.executable, "-c", WRITE, str(tmp_path), "0"]
    process = run([*private, "sh", "-c", script, "sh", *job])
    check(process)
    assert all(line.split()[2] == "28" for line in process.stdout.splitlines()[:3])  # ENOSPC
