"""Data made once for the whole run, however many processes it is spread over."""

import os
from pathlib import Path

import pytest
from filelock import FileLock

if "PYTEST_XDIST_WORKER" in os.environ:  # workers share the cores; torch and BLAS read this once
    os.environ.setdefault("OMP_NUM_THREADS", "1")

from tools.make_graphene import make_graphene


@pytest.fixture(scope="session")
def graphene(tmp_path_factory) -> Path:
    """The full 0 K data set, made by LAMMPS, by the first process that asks for it."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent  # that of all workers
    path = folder / "data" / "graphene_0K.h5"
    with FileLock(folder / "graphene.lock"):
        if not path.exists():
            make_graphene(path, progress=False)
    return path
