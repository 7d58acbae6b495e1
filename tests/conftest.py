"""Data made once for the whole run."""

from pathlib import Path

import pytest

from tools.make_graphene import make_graphene


@pytest.fixture(scope="session")
def graphene(tmp_path_factory) -> Path:
    """The full 0 K data set, made by LAMMPS."""
    return make_graphene(tmp_path_factory.mktemp("data") / "graphene_0K.h5", progress=False)
