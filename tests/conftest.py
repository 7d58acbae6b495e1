"""Data made once for the whole run, however many processes it is spread over."""

import gc
from hashlib import sha256
from importlib.metadata import version
from os import environ
from pathlib import Path
from re import MULTILINE, findall

import pytest
from filelock import FileLock

if "PYTEST_XDIST_WORKER" in environ:  # workers share the cores; torch and BLAS read this once
    environ.setdefault("OMP_NUM_THREADS", "1")

import joblib  # which loads BLAS

TOOLS = Path(__file__).parent.parent / "tools"
LONGEST = """
test_train_graphene test_mpi test_scripts test_crystal_fit test_public test_stability test_predict
test_rows test_special_values test_commands test_files test_calculator_noise test_pages
"""
"""Files of ten seconds to a minute, begun first, so that no process waits for another."""


def pytest_collection_finish():
    """What is imported stays: the collector of garbage need not go through it again and again."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 50)


def pytest_collection_modifyitems(items):
    place = {name: n for n, name in enumerate(LONGEST.split())}
    items.sort(key=lambda item: place.get(item.path.stem, len(place)))


@pytest.fixture(scope="session", autouse=True)
def work_stays_in_its_process():
    """What spreads over processes runs in turn: the cores are taken, and each process imports."""
    if "PYTEST_XDIST_WORKER" not in environ:
        yield
        return
    with joblib.parallel_config(backend="sequential"):
        yield


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder of its own that a test works in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def threads():
    """Sets numbers of threads, Torch's too, until the test is over."""
    import torch

    from warp_peri import runtime

    before, in_torch = runtime.get_num_threads(), torch.get_num_threads()
    yield runtime.set_num_threads
    runtime.set_num_threads(before)
    torch.set_num_threads(in_torch)


def makers(name):
    """A file of tools/ and all that it imports of them: what the data set depends on."""
    path = TOOLS / f"{name}.py"
    others = findall(r"^from tools\.(\w+)", path.read_text("utf-8"), MULTILINE)
    return {path}.union(*map(makers, others))


@pytest.fixture(scope="session")
def graphene(tmp_path_factory, pytestconfig) -> Path:
    """The full 0 K data set, made by the first process that asks for it.

    What LAMMPS found stays in pytest's cache until it or a tool is another one.
    """
    from tools.make_graphene import make_graphene  # which loads much that a controller needs not

    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in environ:
        folder = folder.parent  # that of all workers
    path, kept = folder / "data" / "graphene_0K.h5", folder
    if hasattr(pytestconfig, "cache"):
        made_by = sha256(version("lammps").encode())
        for file in sorted(makers("make_graphene")):
            made_by.update(file.read_bytes())
        kept = pytestconfig.cache.mkdir(f"graphene-{made_by.hexdigest()[:16]}")
    with FileLock(kept / "graphene.lock"):
        if not path.exists():
            with joblib.parallel_config(backend="loky"):
                make_graphene(path, cache=kept / "samples", progress=False)
    return path
