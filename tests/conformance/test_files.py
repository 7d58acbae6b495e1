"""What the file of every material must do: be whole, be believed only where it is proven."""

import contextlib
import shutil
import warnings
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cache
from json import dumps
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import pytest
from numpy.random import default_rng

import warp_peri as wp
from tests.support import approx, of_json, parametrize
from tests.support.clouds import plain
from tests.support.problems import OTHER, lattice
from warp_peri.core.record import HOMES, FieldUnits, content_hash
from warp_peri.core.stencil import Stencil
from warp_peri.materials.crystal import CrystalMaterial
from warp_peri.prediction.answer import contraction

FOLDER = Path(__file__).parent.parent / "frozen"
FILES = sorted(path.stem for path in FOLDER.glob("*.json") if path.stem != "record")
"""Files of every material that an earlier version wrote, most of them without a hash."""
WITH_PROOFS = ("lps", "crystal", "crystal_third_order_energy")
HOSTILE = ([], {}, "x", None, True, -1, 0.5, 10**400, 1e308, -(10**30), np.nan, np.inf, {"x": 1},
           [[1.0], [1.0, 2.0]], [None], ["x"], [[[1.0]]], [10**400])  # fmt: skip
PROVEN = ("proven", "symbol_bound", "strain", "long_waves")
"""Keys of what is said to be proven, in a certificate."""
RECORDS = ("provenance", "errors", "versions", "certificate", "proven")
"""Entries that may hold anything, or are not looked into where nothing is proven."""


@cache
def written(name):
    """A material of an earlier file, and what it is written as anew; without proven strains, which
    take a while to prove."""
    with TemporaryDirectory() as folder:
        for path in FOLDER.glob(f"{name}.*"):
            shutil.copy(path, folder)
        path = Path(folder, f"{name}.json")
        found = read(path, hashed(bare(of_json(path))))
        wp.save(Path(folder, "m.json"), found)
        return found, {one.name: one.read_bytes() for one in Path(folder).glob("m.*")}


@pytest.fixture(params=FILES)
def material(request, tmp_path):
    """A material, and where it is written anew."""
    found, files = written(request.param)
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    return found, tmp_path / "m.json"


def test_every_format_is_among_them():
    formats = {of_json(FOLDER / f"{name}.json")["format"] for name in FILES}
    assert formats == {*HOMES} - {"warp_peri.density"}  # whose function is in no file


def places(content, path=()):
    """Every entry of a content, however deep: its path and what it holds."""
    for key, value in content.items() if isinstance(content, dict) else enumerate(content):
        yield (*path, key), value
        if isinstance(value, (dict, list)):
            yield from places(value, (*path, key))


def changed(content, path, value):
    """A copy with another value at a place."""
    other = part = deepcopy(content)
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = value
    return other


def deep(content, change):
    """With what is changed of each of its dictionaries, the innermost first."""
    if isinstance(content, list):
        return [deep(each, change) for each in content]
    if not isinstance(content, dict):
        return content
    content = {key: deep(value, change) for key, value in content.items()}
    return content | change(content)


hashed = lambda content: deep(
    content, lambda one: {"sha256": content_hash(one)} if "sha256" in one else {}
)
"""With hashes of what it holds now, as one who forges a file writes them."""
bare = lambda content: deep(
    content, lambda one: {"proven": {}} if isinstance(one.get("proven"), dict) else {}
)
"""Without proven strains."""


def read(path, content):
    path.write_text(dumps(content))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return wp.load(path)


def refused(path, content, words=None):
    with pytest.raises(wp.InputError, match=words) as caught:
        read(path, content)
    assert str(caught.value).startswith(f"{path}: ")


def test_what_is_written_ends_with_its_hash_and_no_number_changes_unseen(material):
    found, path = material
    content = of_json(path)
    assert [*content][-1] == "sha256"
    values = dict(places(content))
    numbers = [at for at, value in values.items() if type(value) in (int, float)]
    for n in default_rng(0).permutation(len(numbers))[:25]:
        value = values[numbers[n]]
        refused(path, changed(content, numbers[n], value * 1.1 + (value == 0)))
    del content["sha256"]  # an old file is read without
    again = read(path, content)
    assert type(again) is type(found)
    wp.save(path, again)
    assert of_json(path)["sha256"]


@parametrize("name", FILES)
def test_what_is_not_proven_is_not_believed(name, tmp_path):
    """Higher bounds, and bounds of another solid, under hashes that are right."""
    content, path = of_json(FOLDER / f"{name}.json"), tmp_path / "m.json"
    others = "second", "halves"  # of a family: like the first
    values = {at: value for at, value in places(content) if at[0] not in others}
    owners = set()
    for at, value in values.items():
        record = next((key for key in ("certificate", "proven") if key in at[:-1]), None)
        if record and at[-1] in PROVEN and isinstance(value, float) and value:
            refused(path, hashed(changed(content, at, 1.5 * value)), "is not proven")
            refused(path, hashed(changed(content, at, "1")))
            owners.add(at[: at.index(record)])
    if owners and name != "family":
        read(path, content)
    for owner in owners:
        softer = {"tensors": 0.5, "elastic": 0.5, "mu": 0.5, "t3": 5.0}
        for at in {(*owner, key) for key in softer} & {*values}:
            other = (softer[at[-1]] * np.array(values[at])).tolist()
            refused(path, hashed(changed(content, at, other)), "is not proven")


def test_what_is_replaced_in_memory_is_not_proven_either():
    lps, crystal, third = (wp.load(FOLDER / f"{name}.json") for name in WITH_PROOFS)
    points = lattice(4, lps.horizon)
    softer = replace(lps, lam=lps.lam / 100, mu=lps.mu / 100)
    assert lps.on(points).proven
    assert lps.on(replace(points, outside=~points.interior)).proven is None  # bonds break
    assert not softer.is_certified_on(1.0)
    anew = replace(softer, certified_on=(), certificate={}).on(points).proven
    assert anew.replace("0.0018536", "0.18536") == lps.on(points).proven
    points, strains = wp.Points.block((4, 4), crystal.spacing, 4 * crystal.spacing), third.spacing
    problem = wp.Dirichlet(points, None, 0 * points.x)
    assert wp.solve(crystal, problem).proven
    weak = replace(crystal, tensors=crystal.tensors / 100)
    assert wp.solve(weak, problem).proven is None
    assert "no lattice" in repr(softer)
    assert "nothing" in repr(weak)
    stronger = replace(third, t3=50 * third.t3)
    assert (stronger.proven_strain(strains), contraction(stronger, 0.0, 0.0)) == (0, None)
    assert third.proven_strain(strains) > 0
    for name in ("curvature", "spacing"):
        assert not replace(third, proven=third.proven | {name: 0.99 * third.proven[name]}).stands
    assert not softer.with_parameters({}).errors
    assert contraction(third, 0.0, 0.0) is not None


@dataclass(frozen=True, eq=False, repr=False)
class Scaled(CrystalMaterial):
    """A crystal whose tensors are scaled by what is in no file."""

    by: Annotated[float, FieldUnits(kept=False)] = 1.0

    @property
    def stencil(self):
        return Stencil(self.spacing, self.steps, self.by * self.tensors)


def test_what_is_proven_is_so_of_what_no_file_has_too():
    own = Scaled(**vars(wp.load(FOLDER / "crystal.json")))
    assert own.stands
    assert not replace(own, by=0.1).stands


def test_a_model_is_certified_only_where_that_is_proven(tmp_path):
    path = tmp_path / "m.json"
    for on, said in (((1.0,), {}), ((1.0,), {"1": {"symbol_bound": 0.0}}), ((1.5, 1.0), {})):
        false = plain(3.0, D=[1.0, -0.9, 0.3], certified_on=on, certificate=said)
        refused(path, false.content(), "certified_on: nothing is proven on 1")
    assert read(path, plain(3.0, certified_on=(1.0,)).content()).certified_on == (1.0,)


def test_figures_of_a_proof_are_of_its_lattice_and_words_follow_from_them(tmp_path):
    *files, law = (of_json(FOLDER / f"{name}.json") for name in WITH_PROOFS)
    said, path = files[0]["certificate"]["1"], tmp_path / "m.json"
    forged = changed(law, ("proven", "statement"), "All.")
    assert read(path, hashed(forged)).proven == read(path, law).proven
    figures = {"more": 5.0, "kappa_in": 0.1, "kappa_out": "a", "largest_parts": [0.0] * 4}
    for key, value in figures.items():
        words = "unknown keys: more" if key == "more" else f"proven: {key}"
        refused(path, hashed(changed(law, ("proven", key), value)), words)
    model = read(path, hashed(changed(files[0], ("certificate", "1", "statement"), "All.")))
    assert model.certificate == {"1": said}
    assert "spacing 0.1 nm" in model.in_units(OTHER).certificate["0.1"]["statement"]
    for n, at, value, words in (
        (0, ("1", "spacing"), 7.5, "expected spacings, got '1'"),
        (0, ("2.5",), said, "expected spacings, got '2.5'"),
        (0, ("1", "strength"), 5.0, "unknown keys: strength"),
        (0, ("1", "gamma_min"), "large", "gamma_min: expected a finite number"),
        (1, ("cells",), -1, "is not proven"),
        (1, ("seconds",), -1.0, "is not proven"),
    ):
        refused(path, hashed(changed(files[n], ("certificate", *at), value)), words)


def test_what_is_no_value_or_not_known_is_one_error(material):
    _, path = material
    content = of_json(path)
    for n, key in enumerate(content):
        for value in HOSTILE[n % 3 :: 3]:  # each of them for some key of every material
            with contextlib.suppress(wp.InputError):  # another error ends the test
                read(path, hashed(content | {key: value}))
        if key not in (*RECORDS, "sha256"):
            refused(path, hashed(content | {key: {"x": 10**400}}))
    refused(path, content | {"sha256": {}}, "sha256")
    if units := {"length_unit", "stress_unit"} & {*content}:
        refused(path, hashed(content | dict.fromkeys(units)), "unit")
    else:  # those of a part
        more = dict.fromkeys(("length_unit", "stress_unit"), "m")
        refused(path, hashed(content | more), "unknown keys: length_unit, stress_unit")
    inner = [at for at, value in places(content) if isinstance(value, dict) and "format" in value]
    for at in [(), *inner]:
        refused(path, hashed(changed(content, (*at, "colour"), "red")), "unknown keys: colour")
        refused(path, hashed(changed(content, (*at, "version"), 9)), "version: expected ., got 9")


def test_other_units_there_and_back_are_the_same(material):
    found, path = material
    there, back, theirs = found.in_units(OTHER), path.with_name("back.json"), path.with_name("m2")
    assert there.units == OTHER
    if "units_before" in (record := getattr(there.in_units(("mm", "MPa")), "provenance", {})):
        assert record["units_before"] == [*found.units]  # which its records stay in
    wp.save(back, there.in_units(found.units))
    one, two = (dict(places(of_json(each))) for each in (path, back))
    own = {*RECORDS, "sha256", "weights", "hash"}
    assert {at for at in {*one} ^ {*two} if not own & {*at}} == set()
    for at, value in one.items():
        if isinstance(value, float) and not own & {*at}:
            assert two[at] == approx(value, rel=1e-12, abs=0), at
    theirs.mkdir()
    wp.save(theirs / "m.json", there)
    wp.save(back := theirs / "back" / "m.json", wp.load(path, units=OTHER))
    assert back.read_bytes() == (theirs / "m.json").read_bytes()
    assert repr(found).startswith(type(found).__name__)
    assert found._repr_html_().startswith("<table>")
