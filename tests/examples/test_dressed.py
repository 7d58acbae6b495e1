"""Dressed solids of graphene, as the example learns them."""

import json

import pytest

import warp_peri as wp
from examples import dressed, uneven_sheet
from tools.graphene_phonons import force_constants
from warp_peri.dressed import FiniteStrain, from_phonons
from warp_peri.methods import Smoothing


@pytest.mark.slow
def test_six_numbers_from_fields_and_from_phonons(graphene):
    data = wp.load(graphene)
    known = from_phonons(force_constants(), 5.0, "bonds", 12, symmetry="isotropic", split=False)
    law = wp.fit(data["train"], wp.Dressed("bonds", 12, moduli=known.elastic)).material
    assert law.provenance["fit"]["numbers"] == 6
    found = wp.fit(data["train"], wp.Dressed("bonds", 12, moduli=Smoothing(10.0, 0.2))).material
    assert found.moduli()["C44"] == pytest.approx(known.moduli()["C44"], rel=1e-3)
    for solid, val, disks in ((law, 0.45, 0.9), (found, 0.45, 0.9), (known, 0.5, 0.95)):
        found = dressed.errors(solid, data)["E_u"]
        assert found["val"] <= val
        assert found["disks"] <= disks
    assert law.certificate.proven > 0.9 * law.moduli()["C44"]


@pytest.mark.slow
def test_a_crystal_from_phonons_without_its_ball():
    found = dressed.crystal("Cu", with_ball=False)
    assert found["E_u"]["waves"] <= 0.7 < found["elements"]["waves"]
    assert found["E_u"]["ball_at_rest"] is None


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:strain")
def test_an_energy_that_turns_with_the_sheet(graphene):
    data = wp.load(graphene)
    law = wp.fit(data["train"], FiniteStrain(Smoothing(10.0, 0.2))).material
    assert 100 * wp.evaluate(law, data["val"])["E_u"] <= 0.22
    assert 100 * wp.evaluate(law, data["test"])["E_u"] <= 0.14
    assert law.strain > 0.03


@pytest.mark.slow
def test_boron_nitride_is_found_in_graphene(capsys, tmp_path):
    assert uneven_sheet.main(["--json", "--out", str(tmp_path)]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert numbers["maps"]["val"] <= 4.8 < numbers["one factor"]["val"]
    assert numbers["maps"]["correlation"]["shear"] > 0.983
    for part in numbers["moduli"].values():
        assert part["found"] == pytest.approx(part["true"], rel=0.0093)
    assert (tmp_path / "maps.png").stat().st_size > 10_000
