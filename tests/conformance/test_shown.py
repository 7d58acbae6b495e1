"""What a person sees of a material or of data: constants with units, errors, what is proven."""

from dataclasses import replace

import numpy as np
import pytest

import warp_peri as wp
from tests.conformance.test_laws import LAWS, solved_samples

SEEN = {
    "LPS": ("λ, μ 300, 800 GPa", "3 Å", "0.15 TPa", "certified on 1 Å"),
    "third order, energy": ("t3, tq2, q3", "-500, -6800, 1040 GPa", "|H| = 3.00%", "C11, C12, C44"),
    "density": ("1 Å", "saint_venant", "1000 GPa", "lam 0.4", "mu 0.9"),
    "hyperelastic": ("0.1 Å", "bond (", "GPa", "stretch of the data not known"),
}


@pytest.mark.parametrize("name", SEEN)
def test_a_material_shows_what_it_is(name):
    material = LAWS[name].material()
    text, table = repr(material), material._repr_html_()
    assert text.splitlines()[0] == type(material).__name__
    for part in SEEN[name]:
        assert part in " ".join(text.split())
    assert table.startswith("<table>")
    assert table.count("<tr>") == len(text.splitlines()) - 1
    other = repr(material.in_units(("nm", "GPa")))
    assert "GPa" in other
    assert "TPa" not in other


def test_errors_are_shown_where_there_are_any():
    model = replace(LAWS["LPS"].material(), errors={"test": {"E_res": 0.021, "E_u": 0.0042}})
    assert "errors on test E_res 2.10%, E_u 0.42%" in " ".join(repr(model).split())


def samples():
    law = LAWS["LPS"]
    points = law.points(4)
    made = solved_samples(law, law.material().on(points), points)
    return replace(made, arrays={"wave_vector": np.ones((2, 2))})


def test_data_show_their_size():
    shown = repr(samples())
    assert "256, 16 of them interior, a lattice of 1 Å" in shown
    assert "256, 16 of them interior, a lattice of 1 Å" in repr(samples().points)
    assert samples().points._repr_html_().startswith("<table>")
    assert "TPa/Å" in shown
    assert "b" in repr(replace(samples(), b=None)).split("not known")[0]
    data = wp.Dataset({"train": samples(), "test": samples()}, 3.35, 2200.0)
    assert "train      2 samples on nodes: 256" in repr(data)
    assert "3.35 Å" in data._repr_html_()
