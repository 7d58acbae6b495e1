"""Data sets in memory and in HDF5."""

import dataclasses
from dataclasses import replace

import h5py
import numpy as np
import pytest

from tests.support.problems import lattice, noise
from warp_peri import Dataset, InputError, Points, Samples
from warp_peri.points.dataset import content_hash, load_dataset, save_dataset

GRID = lattice(2, 1.0, spacing=2.5)
N = len(GRID.x)
LOADS = Samples(
    GRID,
    noise(GRID, 3),
    noise(GRID, 3, seed=1),
    arrays={"load_id": np.array(["a", "β", "c d"]), "snr": np.array([1.0, np.inf, np.nan])},
)
SCATTERED = Samples(
    Points(np.random.default_rng(0).normal(size=(5, 2)), np.arange(5) < 2, 0.0),
    np.empty((0, 5, 2)),
    np.empty((0, 5, 2)),
)
DATA = Dataset({"train": LOADS, "bare": SCATTERED}, 3.35, 2267.0, {"seed": 1, "L": [1.5, None]})


@pytest.fixture
def path(tmp_path):
    """A good data set in a file."""
    save_dataset(tmp_path / "data.h5", DATA)
    return tmp_path / "data.h5"


def test_round_trip_keeps_every_bit(path):
    back = load_dataset(path)
    assert set(back) == {"train", "bare"}
    assert (back.thickness, back.density, back.provenance) == (3.35, 2267.0, DATA.provenance)
    for name in back:
        points, expected = back[name], DATA[name]
        assert points.spacing == expected.spacing
        for field in ("x", "u", "b", "interior"):
            value = getattr(points, field)
            assert value.dtype == getattr(expected, field).dtype
            assert np.array_equal(value, getattr(expected, field))
    assert back["train"].arrays["load_id"].tolist() == ["a", "β", "c d"]
    assert np.array_equal(back["train"].arrays["snr"], LOADS.arrays["snr"], equal_nan=True)
    assert len(back["train"]) == 3
    assert len(back["bare"]) == 0


def test_the_file_says_what_it_is(path):
    with h5py.File(path) as file:
        written = {
            key: value.decode() if isinstance(value, bytes) else value
            for key, value in file.attrs.items()
        }
        assert written == {
            "format": "warp_peri.dataset",
            "version": 1,
            "length_unit": "angstrom",
            "stress_unit": "TPa",
            "thickness": 3.35,
            "density": 2267.0,
            "provenance": '{"seed": 1, "L": [1.5, null]}',
            "sha256": content_hash(DATA),
        }
        assert file["train"].attrs["spacing"] == 2.5


def test_single_precision_and_integers_become_float64():
    points = replace(LOADS, u=LOADS.u.astype(np.float32), b=np.ones(LOADS.b.shape, int))
    assert points.u.dtype == points.b.dtype == np.float64


def attribute(key, value, group="/"):
    def change(file):
        if value is None:
            del file[group].attrs[key]
        else:
            file[group].attrs[key] = value

    return change


def array(key, value):
    def change(file):
        if key in file["train"]:
            del file["train"][key]
        if value is not None:
            file["train"][key] = value

    return change


def with_value(field, value):
    wrong = getattr(LOADS, field).copy()
    wrong[(1,) * wrong.ndim] = value
    return array(field, wrong)


BAD_FILES = {
    "format": (attribute("format", "other"), "format: expected 'warp_peri.dataset', got 'other'"),
    "no format": (attribute("format", None), "format: expected 'warp_peri.dataset', got None"),
    "version": (attribute("version", 2), "version: expected 1, got .*2"),
    "versions": (attribute("version", [1, 1]), "version: expected 1, got"),
    "length unit": (attribute("length_unit", "nm"), "sha256: the contents are not"),
    "stress unit": (attribute("stress_unit", "psi"), "stress_unit: expected one of TPa"),
    "no unit": (attribute("stress_unit", None), "stress_unit: expected one of TPa, .*got None"),
    "no thickness": (attribute("thickness", None), "'thickness' is missing"),
    "thickness": (attribute("thickness", 0.0), "thickness: expected a number > 0, got 0.0"),
    "thickness NaN": (attribute("thickness", np.nan), "thickness: expected a number > 0, got nan"),
    "density": (attribute("density", -1.0), "density: expected a number > 0, got -1.0"),
    "density text": (attribute("density", "heavy"), "density: expected a number, got 'heavy'"),
    "provenance": (attribute("provenance", "{"), "provenance: expected JSON"),
    "provenance list": (attribute("provenance", "[]"), "provenance: expected a JSON object"),
    "provenance number": (attribute("provenance", 3), "provenance: expected JSON"),
    "no spacing": (attribute("spacing", None, "train"), "set 'train': .*'spacing' is missing"),
    "spacing": (attribute("spacing", -5.0, "train"), "set 'train': spacing: .* got -5.0"),
    "spacing NaN": (attribute("spacing", np.nan, "train"), "set 'train': spacing: .* got nan"),
    "spacing text": (attribute("spacing", "5", "train"), "set 'train': spacing: .* got '5'"),
    "two spacings": (attribute("spacing", [5, 5], "train"), "set 'train': spacing: .* got array"),
    "no x": (array("x", None), "set 'train': arrays missing: x"),
    "x in four": (array("x", np.ones((N, 4))), rf"set 'train': x: .*\[N, 3\].* got \[{N}, 4\]"),
    "x in space": (
        array("x", np.arange(3.0 * N).reshape(N, 3)),
        rf"set 'train': u: .*{N}, 3\], got .*{N}, 2\]",
    ),
    "no nodes": (array("x", np.ones((0, 2))), r"set 'train': x: .*N > 0, got \[0, 2\]"),
    "x text": (array("x", ["a"]), "set 'train': x: expected float values"),
    "x nothing": (array("x", h5py.Empty("f8")), "set 'train': x: expected"),
    "x NaN": (with_value("x", np.nan), r"set 'train': x: expected finite .* nan at index \[1, 1\]"),
    "u NaN": (with_value("u", np.nan), r"set 'train': u: .* got nan at index \[1, 1, 1\]"),
    "b infinite": (with_value("b", -np.inf), r"set 'train': b: .* got -inf at index \[1, 1, 1\]"),
    "u flat": (array("u", np.ones((3, N))), rf"u: expected shape \[S, {N}, 2\], got \[3, {N}\]"),
    "u short": (array("u", np.ones((3, N - 1, 2))), rf"u: .* got \[3, {N - 1}, 2\]"),
    "b of two samples": (array("b", np.ones((2, N, 2))), rf"b: .* got \[2, {N}, 2\]"),
    "u complex": (array("u", LOADS.u * 1j), "u: expected float values, got complex128"),
    "interior as numbers": (array("interior", np.ones(N)), "interior: expected bool values"),
    "interior short": (array("interior", np.ones(3, bool)), rf"interior: .*\[{N}\], got \[3\]"),
    "no interior": (array("interior", np.zeros(N, bool)), "interior: expected at least one"),
    "two entries": (array("snr", np.ones(2)), "snr: expected one entry for each of 3 samples"),
    "one number": (array("snr", 1.0), "snr: expected one entry for each of 3 samples"),
    "a group inside": (lambda file: file["train"].create_group("g"), "g: expected an array"),
    "a dead link": (array("g", h5py.SoftLink("/nowhere")), "g: expected an array"),
    "x a group": (lambda file: (array("x", None)(file), file["train"].create_group("x")), "ing: x"),
    "an array outside": (lambda file: file.create_dataset("y", data=1), "y: expected a group"),
    "no sets": (lambda file: [file.pop(name) for name in DATA], "at least one point set"),
}  # fmt: skip


@pytest.mark.parametrize(("change", "words"), BAD_FILES.values(), ids=BAD_FILES)
def test_a_wrong_file_is_refused_by_name(path, change, words):
    with h5py.File(path, "a") as file:
        change(file)
    with pytest.raises(InputError, match=words) as caught:
        load_dataset(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "not a readable" not in str(caught.value)


def test_what_is_no_data_set_is_refused(path, tmp_path):
    with pytest.raises(InputError, match="nowhere.h5: no such data set"):
        load_dataset(tmp_path / "nowhere.h5")
    with pytest.raises(InputError, match="not a readable HDF5 data set"):
        load_dataset(tmp_path)
    (tmp_path / "text.h5").write_text("x, y\n")
    with pytest.raises(InputError, match="not a readable HDF5 data set"):
        load_dataset(tmp_path / "text.h5")
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(InputError, match="not a readable HDF5 data set"):
        load_dataset(path)


def test_a_set_that_is_not_there_is_named():
    with pytest.raises(InputError, match="no set 'test' in the data; it has train, bare"):
        DATA["test"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"spacing": -1.0}, "spacing: expected a number ≥ 0, got -1.0"),
        ({"spacing": "1"}, "spacing: expected a number ≥ 0, got '1'"),
        ({"spacing": None}, "spacing: expected a number ≥ 0, got None"),
        ({"x": [[1.0, 2.0], [3.0]]}, "x: expected an array"),
        ({"x": GRID.x[:-1]}, "interior: expected shape"),
        ({"interior": np.ones(N)}, "interior: expected bool values"),
        ({"outside": np.ones(N)}, "outside: expected bool values"),
        ({"outside": np.ones(N - 1, bool)}, "outside: expected shape"),
        ({"outside": np.ones(N, bool)}, "true for no interior node"),
    ],
)
def test_wrong_points_are_refused_in_memory(change, words):
    with pytest.raises(InputError, match=words):
        replace(GRID, **change)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"points": LOADS}, "points: expected Points, got Samples"),
        ({"u": LOADS.u[:, 1:]}, rf"u: expected shape \[S, {N}, 2\]"),
        ({"b": LOADS.b[1:]}, rf"b: expected shape \[3, {N}, 2\]"),
        ({"arrays": {"u": np.ones(3)}}, "arrays: 'u' cannot be the name of an array"),
        ({"arrays": {"a/b": np.ones(3)}}, "arrays: 'a/b' cannot be the name of an array"),
        ({"arrays": {"snr": None}}, "snr: expected one entry"),
    ],
)
def test_wrong_samples_are_refused_in_memory(change, words):
    with pytest.raises(InputError, match=words):
        replace(LOADS, **change)


def test_what_is_masked_or_complex_is_no_field():
    """An array that hides values says that they are no data; one that hides none is an array."""
    hides = np.ma.masked_array(LOADS.u, mask=np.zeros(LOADS.u.shape, bool))
    shown = replace(LOADS, u=hides)
    assert type(shown.u) is np.ndarray
    hides = hides.copy()
    hides[0, 3] = np.ma.masked
    for wrong in (hides, list(hides)):
        with pytest.raises(InputError, match=r"u: .* got 2 of .* masked, .* index \[0, 3, 0\]"):
            replace(LOADS, u=wrong)
    for name, value in {
        "x": np.ma.masked_equal(GRID.x, GRID.x[2, 0]),
        "outside": hides[0, :, 0],
    }.items():
        with pytest.raises(InputError, match=f"{name}: expected"):
            replace(GRID, **{name: value})
    with pytest.raises(InputError, match="k: expected values everywhere"):
        replace(LOADS, arrays={"k": hides[:, :, 0]})
    with pytest.raises(InputError, match="u: expected float values, got complex128"):
        replace(LOADS, u=LOADS.u + 0j)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"thickness": 0.0}, "thickness: expected a number > 0, got 0.0"),
        ({"density": np.nan}, "density: expected a number > 0, got nan"),
        ({"sets": {}}, "at least one point set"),
        ({"sets": {"a/b": LOADS}}, "sets: 'a/b' cannot be the name of a set"),
    ],
)
def test_wrong_data_is_refused_in_memory(change, words):
    with pytest.raises(InputError, match=words):
        replace(DATA, **change)


@pytest.mark.parametrize("bad", [np.nan, object()], ids=["NaN", "an object"])
def test_a_provenance_that_is_not_json_leaves_the_old_file(path, bad):
    before = path.read_bytes()
    with pytest.raises(InputError, match="provenance: expected plain JSON values"):
        save_dataset(path, replace(DATA, provenance={"bad": bad}))
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(path, monkeypatch, error):
    before = path.read_bytes()

    def fails(*_):
        raise error

    monkeypatch.setattr(h5py.File, "create_group", fails)
    for target in (path, path.with_name("new.h5")):
        with pytest.raises(type(error)):
            save_dataset(target, DATA)
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def test_loads_that_are_not_known_stay_unknown(tmp_path):
    unknown = Samples(GRID, LOADS.u)
    with pytest.raises(InputError, match="b: expected loads, got samples whose loads are not"):
        _ = unknown.loads
    save_dataset(tmp_path / "data.h5", Dataset({"frames": unknown}, 3.35, 2267.0))
    back = load_dataset(tmp_path / "data.h5")["frames"]
    assert back.b is None
    assert np.array_equal(back.u, LOADS.u)


def test_periods_and_nodes_outside_come_back(tmp_path):
    outside = ~GRID.interior & (GRID.x[:, 0] < 0)
    points = replace(GRID, box=(20.0, 30.0), outside=outside)
    save_dataset(tmp_path / "data.h5", Dataset({"a": Samples(points, LOADS.u)}, 3.35, 2267.0))
    back = load_dataset(tmp_path / "data.h5")["a"]
    assert back.box == (20.0, 30.0)
    assert np.array_equal(back.outside, outside)


@pytest.mark.parametrize("units", [("nm", "GPa"), ("m", "Pa"), ("angstrom", "eV/angstrom^3")])
def test_files_carry_their_units_and_an_argument_converts(tmp_path, units):
    path = tmp_path / "data.h5"
    before = DATA
    length = {"nm": 10.0, "m": 1e10, "angstrom": 1.0}[units[0]]
    stress = {"GPa": 1e-3, "Pa": 1e-12, "eV/angstrom^3": 0.1602176634}[units[1]]
    save_dataset(path, before, units=units)
    own = load_dataset(path)
    assert own.units == units
    np.testing.assert_array_equal(own["train"].x, before["train"].x)
    converted = load_dataset(path, units=("angstrom", "TPa"))
    assert converted.units == ("angstrom", "TPa")
    assert converted.thickness == pytest.approx(before.thickness * length)
    assert converted.density == before.density
    for name in before:
        samples, other = converted[name], before[name]
        assert samples.x == pytest.approx(other.x * length)
        assert samples.spacing == pytest.approx(other.spacing * length)
        assert samples.u == pytest.approx(other.u * length)
        if other.b is not None:
            assert samples.b == pytest.approx(other.b * stress / length)
    same = load_dataset(path, units=units)
    assert same[name].x == pytest.approx(before[name].x, rel=0, abs=0)
    with pytest.raises(InputError, match="length_unit: expected one of angstrom, nm, .* 'mile'"):
        load_dataset(path, units=("mile", "TPa"))
    with pytest.raises(InputError, match=r"expected \(length, stress\), or ase, .* got 'nm!'"):
        save_dataset(path, before, units="nm!")


def test_reduced_units_are_carried_and_lead_nowhere(tmp_path):
    path = tmp_path / "data.h5"
    save_dataset(path, DATA, units=("sigma", "epsilon/sigma^3"))
    assert load_dataset(path).units == ("sigma", "epsilon/sigma^3")
    with pytest.raises(InputError, match="no factor leads from sigma and epsilon/sigma"):
        load_dataset(path, units=("angstrom", "TPa"))


def test_a_file_that_names_no_units_is_in_angstrom_and_terapascal(tmp_path):
    path = tmp_path / "data.h5"
    save_dataset(path, DATA)
    with h5py.File(path, "r+") as file:
        del file.attrs["length_unit"], file.attrs["stress_unit"]
    with pytest.warns(UserWarning, match="names no units: taken as Å and TPa"):
        assert load_dataset(path).units == ("angstrom", "TPa")


def test_sets_of_one_file_are_in_the_same_units():
    points = dataclasses.replace(LOADS.points, units=("nm", "GPa"))
    other = dataclasses.replace(LOADS, points=points)
    with pytest.raises(InputError, match="same for all sets, got a in angstrom and TPa, b in nm"):
        Dataset({"a": LOADS, "b": other}, 3.35, 2200.0)
