"""Whatever is saved comes back whole: units, certificates and records, in any units."""

import dataclasses
import json

import numpy as np
import pytest

from tests.support.nonlinear import solid
from tests.support.sheets import everything
from warp_peri import InputError, Model, Points, load
from warp_peri.diffusion.conductor import Conductor
from warp_peri.fracture.dynamics import BrittleSolid
from warp_peri.materials.hyperelastic.energies import HyperelasticSolid
from warp_peri.points.dataset import Dataset, load_dataset, save_dataset
from warp_peri.points.samples import Samples
from warp_peri.points.unit_names import check_units, factors
from warp_peri.shapes import InfluenceFunction

UNITS = [("angstrom", "TPa"), ("m", "Pa"), ("mm", "GPa")]


def certified(units):
    """A linear model with every field filled in."""
    return Model(
        lam=-0.2,
        mu=0.7,
        alpha=1.5,
        D=np.array([1.0, -0.3, 0.4]),
        horizon=20.0,
        trained_on=(5.0,),
        certified_on=(5.0, 2.5),
        trained_strain=0.01,
        largest_wave_number=0.3,
        certificate={"5": {"smallest": 0.01, "proven": True}},
        errors={"test": {"E_u": 0.0103}},
        provenance={"data": "graphene.h5", "sha256": "ab"},
        versions={"warp_peri": "0.1.0"},
    ).in_units(units)


def third_order(units):
    law = dataclasses.replace(solid("filtered"), proven={"strain": 0.03})
    return law.in_units(units)


def brittle(units, **criterion):
    return BrittleSolid(certified(units), 2.2, **criterion, tension_only=False)


def hyperelastic(units):
    dictionary, provenance = everything(), {"data": "sheet.h5"}
    c = np.arange(1.0 * len(dictionary))
    return HyperelasticSolid(dictionary, c, 0.1, 1.4, provenance, units)


def dataset(units):
    x = np.argwhere(np.ones((4, 3))).astype(float)
    points = Points(x, np.ones(12, bool), 1.0, units=units)
    return Dataset({"train": Samples(points, np.ones((2, 12, 2)), np.ones((2, 12, 2)))}, 3.35, 2e3)


def put(thing, path):
    thing.save(path)


KINDS = {
    "model": (certified, put, Model.load),
    "model of either kind": (certified, put, load),
    "third order": (third_order, put, load),
    "brittle, toughness": (lambda units: brittle(units, toughness=3.0), put, BrittleSolid.load),
    "brittle, energy": (lambda units: brittle(units, critical_energy=1.0), put, BrittleSolid.load),
    "hyperelastic": (hyperelastic, put, HyperelasticSolid.load),
    "conductor": (
        lambda units: Conductor(3.0, 2.0, 1.3, np.array([1.0, 0.4]), units),
        put,
        Conductor.load,
    ),
    "data set": (dataset, lambda data, path: save_dataset(path, data), load_dataset),
}


def same(one, other, where=""):
    """Every field, however deep; the file a model was read from is not part of it."""
    if dataclasses.is_dataclass(one):
        assert type(one) is type(other), where
        for field in dataclasses.fields(one):
            if field.name != "file":
                name = f"{where}.{field.name}"
                same(getattr(one, field.name), getattr(other, field.name), name)
    elif isinstance(one, dict):
        assert list(one) == list(other), where
        for key in one:
            same(one[key], other[key], f"{where}[{key}]")
    elif isinstance(one, np.ndarray):
        np.testing.assert_array_equal(one, other, err_msg=where)
    else:
        assert one == other, where


@pytest.mark.parametrize("units", UNITS, ids=" ".join)
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_saved_comes_back_whole(kind, units, tmp_path):
    make, save, load = KINDS[kind]
    path, thing = tmp_path / ("kept.h5" if kind == "data set" else "kept.json"), make(units)
    save(thing, path)
    same(thing, load(path), kind)


NAMED = ("hyperelastic", "conductor")


@pytest.mark.parametrize("kind", NAMED)
def test_files_without_units_say_that_they_are_taken_for_granted(kind, tmp_path):
    make, save, load = KINDS[kind]
    path = tmp_path / "kept.json"
    save(make(("mm", "GPa")), path)
    content = json.loads(path.read_text())
    bare = {key: value for key, value in content.items() if not key.endswith(("_unit", "sha256"))}
    path.write_text(json.dumps(bare))
    with pytest.warns(UserWarning, match=r"kept.json: it names no units: taken as Å and TPa"):
        assert load(path).units == ("angstrom", "TPa")
    path.write_text(json.dumps({**bare, "length_unit": "mm"}))
    with pytest.raises(InputError, match=r"kept.json: missing keys: stress_unit"):
        load(path)
    path.write_text(json.dumps({**content, "length_unit": "inch"}))
    with pytest.raises(InputError, match="length_unit: expected one of"):
        load(path)


def test_the_model_of_an_influence_function_is_in_the_units_that_are_said():
    shape = InfluenceFunction(lambda r: 1 / r)
    numbers = {"lam": 1e9, "mu": 1e9, "horizon": 2e-3, "spacings": [1e-3]}
    assert shape.model(**numbers, units=("m", "Pa")).units == ("m", "Pa")


def test_a_brittle_solid_of_a_wrong_file_is_refused(tmp_path):
    path = tmp_path / "solid.json"
    brittle(("m", "Pa"), toughness=1.0).save(path)
    new = json.loads(path.read_text())
    for version in (2, 4):
        path.write_text(json.dumps({**new, "version": version}))
        with pytest.raises(InputError, match=f"version: expected 3, got {version}"):
            BrittleSolid.load(path)
    path.write_text(json.dumps({**new, "tension_only": "no"}))
    with pytest.raises(InputError, match="tension_only: expected true or false, got 'no'"):
        BrittleSolid.load(path)
    new["model"]["mu"] *= 2
    path.write_text(json.dumps(new))
    with pytest.raises(InputError, match=r"solid.json: model: sha256: the contents are not"):
        BrittleSolid.load(path)


def test_units_by_one_name_and_moduli_in_gpa():
    model = Model(0.1, 0.7, 1.0, [1.0], horizon=2.5)
    assert check_units("ase") == ("angstrom", "eV/angstrom^3")
    assert factors("si", "metal") == pytest.approx((1e10, 1e-5))
    assert "700 GPa" in repr(model)
    assert "GPa" in repr(model.in_units("ase"))
    assert "7e+05 MPa" in repr(model.in_units(("mm", "MPa")))
    with pytest.raises(InputError, match="or ase, metal, si, reduced, got 'cgs'"):
        check_units("cgs")
