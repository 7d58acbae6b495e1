"""A coarse problem by PETSc gives the same answers; where it is not there, it is refused."""

import shutil
import sys
from importlib.util import find_spec
from types import SimpleNamespace

import numpy as np
import pytest

import warp_peri as wp
from tests.ranks.job import H, carried, fields, scattered, solid
from tests.ranks.petsc_job import LATTICES, thick
from tests.ranks.test_ranks import finished, start
from warp_peri.ranks import lattice, petsc

COUNTS = (1, 2, 3)
built = pytest.mark.skipif(
    find_spec("petsc4py") is None,
    reason="petsc4py is not built here: docs/archive/ranks.md says how",
)


def asked(preconditioner):
    """Of a small plate in rows, as one rank."""
    points = lattice((52, 52), H, lambda x: (np.abs(x - 12.75) < 8).all(axis=1))
    zero = np.zeros_like(points.x)
    return wp.solve(solid(2), wp.Dirichlet(points, zero, zero), solver=wp.Krylov(preconditioner))


def test_without_petsc4py_one_line_says_where_its_build_stands(monkeypatch):
    pytest.importorskip("mpi4py", reason="mpi4py is not installed: pip install 'warp_peri[mpi]'")
    monkeypatch.setitem(sys.modules, "petsc4py", None)
    with pytest.raises(wp.InputError, match=r"needs petsc4py, .* docs/archive/ranks\.md"):
        asked("petsc")
    assert asked(None).method == "multigrid"
    with pytest.raises(wp.InputError, match="expected multigrid or petsc on ranks, got 'sine'"):
        asked("sine")


def test_petsc_without_mpi_is_refused(monkeypatch):
    pytest.importorskip("mpi4py", reason="mpi4py is not installed: pip install 'warp_peri[mpi]'")
    of_one = SimpleNamespace(COMM_WORLD=SimpleNamespace(size=1))
    alone = SimpleNamespace(init=lambda words: None, PETSc=of_one)
    monkeypatch.setitem(sys.modules, "petsc4py", alone)
    assert petsc.petsc() is of_one
    monkeypatch.setattr(petsc, "world", lambda: SimpleNamespace(size=2))
    with pytest.raises(wp.InputError, match="sees 1 of 2 ranks"):
        petsc.petsc()


def test_one_process_has_no_coarse_problem_of_petsc():
    x = H * np.argwhere(np.ones((24, 24)))
    points = wp.Points(x, (np.abs(x - 5.75) < 3).all(axis=1), H)
    zero = np.zeros_like(x)
    for law in (solid(2), wp.micromodulus.tensors_of(solid(2), H)):
        with pytest.raises(wp.InputError, match="got 'petsc'"):
            wp.solve(law, wp.Dirichlet(points, zero + 1e-3, zero), solver=wp.Krylov("petsc"))


@pytest.fixture(scope="module")
def jobs(tmp_path_factory):
    """What two ranks found, and one and three that went on from its checkpoint."""
    folder, found = tmp_path_factory.mktemp("petsc"), {}
    for count in (2, 1, 3):
        place = folder / str(count)
        place.mkdir()
        if count != 2:
            shutil.copy(folder / "2" / "kept.h5", place)
        found[count] = finished(start(count, place, job="petsc_job"))
        with np.load(place / f"answers_{count}.npz") as answers:
            found[count]["answers"] = dict(answers)
    return found


@built
@pytest.mark.parametrize("name", [*LATTICES, "cloud"])
def test_the_answer_is_that_of_one_process_on_any_number_of_ranks(name, jobs):
    found = [jobs[count][name] for count in COUNTS]
    assert {one["method"] for one in found} == {"multigrid, PETSc"}
    assert max(one["residual"] for one in found) <= 1e-10
    iterations = [one["iterations"] for one in found]
    assert max(iterations) - min(iterations) <= 1
    assert max(iterations) <= (80 if name == "cloud" else 32)
    if name == "cloud":
        points, law = scattered(), carried()
    else:
        x = H * np.argwhere(np.ones(LATTICES[name]))
        points, law = wp.Points(x, thick(x), H), solid(x.shape[1])
    law = wp.micromodulus.tensors_of(law, H) if name == "ball" else law
    solver = wp.Krylov(tolerance=1e-12) if name != "cloud" else None
    truth = wp.solve(law, wp.Dirichlet(points, *fields(points.x)), solver=solver).u
    for count in COUNTS:
        wrong = np.abs(jobs[count]["answers"][name] - truth).max()
        assert wrong <= 1e-9 * np.abs(truth).max()


@built
@pytest.mark.parametrize("name", LATTICES)
def test_the_cycle_is_one_symmetric_positive_operator(name, jobs):
    for count in COUNTS:
        one, other, own = jobs[count][name]["work"]
        assert one == pytest.approx(other, rel=1e-9, abs=1e-12 * own)
        assert own > 0


@built
def test_a_solve_goes_on_with_another_number_of_ranks(jobs):
    assert jobs[2]["kept"]["far"] > 1e-9
    for count in (1, 3):
        kept = jobs[count]["kept"]
        assert kept["far"] < 1e-9
        assert kept["took"] < 0.8 * kept["fresh"]
