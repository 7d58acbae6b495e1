"""The published HGO fields come back; run with METANO=FOLDER, a clone of the repository."""

import os
from pathlib import Path

import pytest

from warp_peri import InputError

pytest.importorskip("skfem")

from examples.studies.metano_check import check, published


@pytest.mark.slow
@pytest.mark.skipif("METANO" not in os.environ, reason="METANO names no clone of the repository")
def test_linear_triangles_give_the_published_fields_back():
    differences = check(Path(os.environ["METANO"]), [0], [0, 5])["task 0"]
    assert max(differences["linear triangles"]) < 1e-4
    assert min(differences["quadratic elements"]) > 5e-3
    assert min(differences["compressed fibres"]) > 0.1


def test_a_folder_without_the_data_is_refused(tmp_path):
    with pytest.raises(InputError, match="expected the MetaNO repository"):
        published(tmp_path, 0)
