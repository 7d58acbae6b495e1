"""Units are those of the file, by pairs or by one name."""

import json

import pytest

from warp_peri import InputError, LPSMaterial, load
from warp_peri.diffusion.conductor import DiffusionMaterial
from warp_peri.points.unit_names import check_units, factors


def test_files_without_units_say_that_they_are_taken_for_granted(tmp_path):
    path = tmp_path / "kept.json"
    DiffusionMaterial(3.0, 2.0, 1.3, [1.0, 0.4], ("mm", "GPa")).save(path)
    content = json.loads(path.read_text())
    bare = {key: value for key, value in content.items() if not key.endswith(("_unit", "sha256"))}
    path.write_text(json.dumps(bare))
    with pytest.warns(UserWarning, match=r"kept.json: it names no units: taken as Å and TPa"):
        assert load(path).units == ("angstrom", "TPa")
    for change, words in (
        ({"length_unit": "mm"}, "missing keys: stress_unit"),
        ({"length_unit": "inch", "stress_unit": "GPa"}, "length_unit: expected one of"),
    ):
        path.write_text(json.dumps({**bare, **change}))
        with pytest.raises(InputError, match=words):
            load(path)


def test_units_by_one_name_and_moduli_in_gpa():
    model = LPSMaterial(0.1, 0.7, 1.0, [1.0], horizon=2.5)
    assert check_units("ase") == ("angstrom", "eV/angstrom^3")
    assert factors("si", "metal") == pytest.approx((1e10, 1e-5))
    assert "700 GPa" in repr(model)
    assert "GPa" in repr(model.in_units("ase"))
    assert "7e+05 MPa" in repr(model.in_units(("mm", "MPa")))
    with pytest.raises(InputError, match="or ase, metal, si, reduced, got 'cgs'"):
        check_units("cgs")
