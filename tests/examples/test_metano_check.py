"""The published HGO fields come back, on the two loads kept in `metano/`."""

from pathlib import Path

import pytest

from warp_peri import InputError

pytest.importorskip("skfem")

from examples.studies.metano_check import check, published

KEPT = Path(__file__).parent / "metano"
"""Loads 0 and 5 of task 0 of the MetaNO repository, under the MIT licence that lies beside them."""


@pytest.mark.slow
def test_linear_triangles_give_the_published_fields_back():
    differences = check(KEPT, [0], [0, 1])["task 0"]
    assert max(differences["linear triangles"]) < 1e-4
    assert min(differences["quadratic elements"]) > 5e-3
    assert min(differences["compressed fibres"]) > 0.1


def test_a_folder_without_the_data_is_refused(tmp_path):
    with pytest.raises(InputError, match="expected the MetaNO repository"):
        published(tmp_path, 0)
