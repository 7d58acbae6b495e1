"""The same bits and the same answers on one, two and three ranks; what ends them ends all."""

import json
import os
import shutil
import signal
import subprocess
import sys
from functools import partial
from math import fsum
from pathlib import Path

import numpy as np
import pytest

import warp_peri as wp
from tests.mpi.job import SWING, TOLERANCE, corrected, crack, fields, swings, uneven, whole
from tests.support import ROOT, approx, in_plane_and_space, near, parametrize, refused, shared, slow
from warp_peri.mpi import TimeSeriesWriter

pytest.importorskip("mpi4py", reason="mpi4py is not installed: pip install 'warp_peri[mpi]'")
MPIEXEC = Path(sys.executable).with_name("mpiexec")
if not MPIEXEC.exists():
    pytest.skip("no mpiexec beside Python: pip install 'warp_peri[mpi]'", allow_module_level=True)
LIMIT = 300
"""Seconds that a job may take, on however busy a machine."""


def start(count, folder, steps=60, *more, pause=0):
    """A job on so many ranks."""
    words = map(str, (folder, steps, pause, *more))
    alone = {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        [MPIEXEC, "-n", str(count), sys.executable, "-m", "tests.mpi.job", *words],
        cwd=ROOT, env=os.environ | alone, text=True, start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def finished(process, status=0):
    try:
        out, err = process.communicate(timeout=LIMIT)
    finally:
        process.kill()
    assert process.returncode == status, err
    return json.loads(out.splitlines()[-1]) | {"said": err}


@pytest.fixture(scope="module", params=[(1,), pytest.param((1, 3), marks=slow)])
def later(request):
    """Numbers of ranks that go on from where two have come."""
    return request.param


@shared
def folder(tmp_path_factory, later):
    return tmp_path_factory.mktemp("ranks")


@shared
def jobs(folder, later):
    """What each number found. Two stopped early; then the first of them failed."""
    two = finished(start(2, folder, 40, "rest", "fail"), 2)
    for place in later:
        shutil.copytree(folder, folder / str(place), ignore=shutil.ignore_patterns("1", "*.npy"))
    begun = {count: start(count, folder / str(count), 60, "rest") for count in later}
    found = {2: two} | {count: finished(job) for count, job in begun.items()}
    return dict(sorted(found.items()))


def test_sums_do_not_depend_on_who_has_what(jobs):
    values = uneven()
    first, *others = (job["sums"] for job in jobs.values())
    assert others == [first] * len(others)
    assert first == approx([*map(fsum, values.T)], rel=1e-15, abs=0)
    assert (values.sum(axis=0) != values[::-1].sum(axis=0)).any()  # floats alone would


@in_plane_and_space
def test_a_body_at_rest_has_the_same_bits_and_those_of_one_process_nearly(d, jobs, folder):
    found = [job[f"{d}-D"] for job in jobs.values()]
    assert len({one["u"] for one in found}) == len({one["iterations"] for one in found}) == 1
    assert found[0]["iterations"] <= (15 if d == 2 else 10)
    assert found[0]["residual"] <= TOLERANCE[d]
    problem, law = whole(d), swings(d)
    alone = wp.solve(law, problem, solver=wp.CG(tolerance=TOLERANCE[d]) if d == 2 else None)
    near(np.load(folder / f"{d}-D_2.npy"), alone.u, 10 * TOLERANCE[d])


def assert_same_files(folder, count, *names):
    """That so many ranks wrote what one did."""
    for name in names:
        assert (folder / str(count) / name).read_bytes() == (folder / "1" / name).read_bytes()


@in_plane_and_space
def test_waves_go_on_with_another_number_of_ranks_with_the_same_bits(d, jobs, folder):
    one, two = (jobs[count][f"{d}-D"]["waves"] for count in (1, 2))
    assert two["energy"] == one["energy"][: len(two["energy"])]
    assert one["drift"] < 1e-12
    problem, law = whole(d), swings(d)
    for count in sorted(jobs, key=(2).__ne__):
        steps = 15 if count == 2 else 25
        alone = wp.simulate(law, problem, **SWING, v=problem.u[:, ::-1], steps=steps)
        end = np.concatenate([alone.u, alone.v], axis=1)
        place = folder / ("." if count == 2 else str(count)) / f"waves_{d}_{count}.npy"
        near(np.load(place), end, 1e-11)
    for count in set(jobs) - {2}:
        assert jobs[count][f"{d}-D"]["waves"] == one
        assert_same_files(folder, count, f"waves_{d}.h5", f"waves_{d}/motion.pvd")
    assert one["energy"] == approx(alone.energy, rel=1e-12, abs=0)


REFUSED = """points: expected Points, got a piece
points: expected all bonds of every interior node, got 768 of 2704
step: expected at most 0.0025
interior: expected at least one interior node, got none
material: expected a linear solid or a crystal on ranks, got DiffusionMat
solve: expected tensors without a gradient, which only a Dirichlet, a Periodic and a Cracked of
solve: expected options among none, got comm
points: expected a lattice
simulate: expected no pressure on ranks
ranks: expected at most 1 for 8 × 52 nodes, slabs of 8 rows, got 2
no_fail: expected bool values, got int64
load: expected values everywhere, got
interior: expected values everywhere, got
points: expected a piece as it was made
points: expected Points, got a rank's piece
points: expected Points, got a piece
solution: stress, energy, samples and plots are not had on ranks
solution: stress, energy, samples and plots are not had on ranks
operator: energy and stress are not had on ranks
points: expected Points(x, interior, spacing), got None
None
values: expected float values, got masked
points: expected Points for an Injected, which is not had on ranks
None
spacing: the model is certified on 1 Å, not on 0.5 Å
/
step: expected a whole number ≥ 0, got 2.5
time: expected a finite number, got nan
a: expected shape [
a: expected float values, got masked
fields: expected names that XML holds, got 'a<b'"""


def test_what_does_not_fit_is_refused_on_all_ranks(jobs):
    for said, words in zip(jobs[2]["refused"], REFUSED.split("\n"), strict=True):
        assert str(said).startswith(words)
    door = jobs[2]["door"]  # before anything is sent
    assert len(door) == 9
    for name, told in door.items():
        assert told == f"{name}: expected the same on all ranks, rank 1 has another"


def test_fields_of_ones_own_go_to_paraview_by_their_names(jobs, folder, tmp_path):
    pytest.importorskip("meshio", reason="meshio writes the files")
    make = partial(TimeSeriesWriter, tmp_path, whole(2).points, resume=True)
    writer, again = make(), make()
    writer.write(1, 0.5, own := dict(zip("bu", fields(writer.x))))
    for file in tmp_path.iterdir():
        assert file.read_bytes() == (folder / "own" / file.name).read_bytes()
    for other, found in ((again, {}), (make(2 * writer.x), own)):
        with refused("nodes or fields"):
            other.write(2, 1.0, found)
    again.write(1, 0.5, own)  # the same bytes, of another
    with refused("another writer"):
        writer.write(2, 1.0, own)
    again.write(2, 1.0, own)
    assert (tmp_path / "motion.pvd").read_text().count("record_") == 2


def test_ranks_share_the_cells_of_a_proof(jobs):
    assert len({job["proof"] for job in jobs.values()}) == 1
    shares = jobs[2]["shared"]
    assert sum(shares) == jobs[1]["shared"][0]
    assert min(shares) > 0.2 * sum(shares)


def test_a_crack_has_the_bits_of_one_process(jobs, folder, tmp_path):
    meshio = pytest.importorskip("meshio", reason="meshio writes the files of one process")
    alone = crack(tmp_path)
    assert (tmp_path / "series" / "motion.pvd").exists()  # the files of one process
    assert alone["worst"] > 0.3
    one = jobs[1]["crack"]
    for count in set(jobs) - {2}:
        there = jobs[count]["crack"]
        assert [there[name] for name in ("u", "damage")] == [alone["u"], alone["damage"]]
        assert there["records"] == one["records"]
        more = "series/motion.pvd", "series/record_00000060.vtu"
        assert_same_files(folder, count, "state.h5", *more)
    assert one["ledger"] < 1e-2
    *_, last = files = sorted((folder / "1" / "series").glob("*.vtu"))
    read = meshio.read(last)
    assert len(files) == 3
    assert read.points.shape == read.point_data["displacement"].shape == (800, 3)
    assert read.point_data["damage"].max() == alone["worst"]
    assert [job["corrected"] for job in jobs.values()] == [corrected()] * len(jobs)


def test_an_error_on_one_rank_ends_all_with_one_line(jobs):
    said = jobs[2]["said"]
    assert said.count("error: ranks: expected all here, each with") == said.count("error: ") == 1
    assert "Traceback" not in said


LEAVES = (
    (1, "rank 1 has left: no", "c.rank and sys.exit('no')"),
    (1, "rank 1: Traceback (most recent call last):", "c.rank and 1 / 0"),
    (3, "", "sys.exit(3)"),
    (0, "", "try: c.rank and sys.exit('no')\nexcept SystemExit: pass"),
)


@parametrize("status, said, end", LEAVES)
def test_a_rank_that_leaves_ends_all_but_all_may_leave(status, said, end):
    code = f"import sys; from warp_peri.mpi import world; c = world()\n{end}\nc.Barrier()"
    line = [MPIEXEC, "-n", "2", sys.executable, "-c", code]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, timeout=LIMIT)
    assert (done.returncode, done.stderr.partition("\n")[0]) == (status, said)


@slow
@parametrize("later", [1, 3])
def test_a_killed_rank_loses_nothing_but_the_steps_since_its_checkpoint(later, tmp_path):
    truth = finished(start(2, tmp_path / "truth"))["crack"]
    job = start(2, tmp_path, pause=1)
    pids = [int(word) for word in job.stdout.readline().split()[1:]]
    while not (tmp_path / "state.h5").exists():
        assert job.poll() is None
    os.kill(pids[1], signal.SIGKILL)
    job.communicate(timeout=LIMIT)
    assert job.returncode != 0  # the other rank does not wait for ever
    assert finished(start(later, tmp_path))["crack"] == truth
