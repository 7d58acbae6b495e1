"""Data sets in memory and in HDF5."""

import resource
import tracemalloc
from dataclasses import replace

import h5py
import numpy as np
import pytest
from numpy import array, inf, nan, ones, zeros
from numpy.testing import assert_array_equal

from tests.support import approx, assert_refused, each_refused, refused, warned
from tests.support.problems import OTHER, lattice, noise
from warp_peri import Dataset, Points, Samples, evaluate, load, save
from warp_peri.files.checkpoint import write_arrays
from warp_peri.points.arguments import USUAL, factors
from warp_peri.points.dataset import in_units, load_dataset, save_dataset
from warp_peri.points.families import families_of

GRID = lattice(2, 1.0, spacing=2.5)
N = len(GRID.x)
ARRAYS = {"load_id": array(["a", "β", "c d"]), "snr": array([1.0, inf, nan])}
LOADS = Samples(GRID, noise(GRID, 3), noise(GRID, 3, seed=1), arrays=ARRAYS)
CUT = replace(GRID, box=(20.0, 30.0), outside=~GRID.interior & (GRID.x[:, 0] < 0))
CUBE = replace(Points.sheet((3.0, 4, 5), 1.0), axis=[[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])
SETS = {
    "train": LOADS,
    "bare": Samples(Points(GRID.x[:5] * 1.1, np.arange(5) < 2, 0.0), np.empty((0, 5, 2))),
    "cut": Samples(CUT, LOADS.u),
    "space": Samples(CUBE, noise(CUBE, 2), noise(CUBE, 2)),
}
DATA = Dataset(SETS, 3.35, 2267.0, {"seed": 1, "L": [1.5, None]})
attribute = lambda key, value, group="/": lambda file: file[group].attrs.__setitem__(key, value)


@pytest.fixture
def path(tmp_path):
    """A good data set in a file."""
    save_dataset(tmp_path / "data.h5", DATA)
    return tmp_path / "data.h5"


def test_a_file_keeps_every_bit_and_says_what_it_is(path):
    back = load_dataset(path)
    assert list(back) == sorted(DATA)
    assert (back.thickness, back.density, back.provenance) == (3.35, 2267.0, DATA.provenance)
    for name in back:
        assert not back[name].points.first_difference(DATA[name].points)
        assert_array_equal(back[name].u, DATA[name].u)
        assert (back[name].b is None) == (DATA[name].b is None)
    assert_array_equal(back["train"].b, LOADS.b)
    assert back["train"].arrays["load_id"].tolist() == ["a", "β", "c d"]
    assert_array_equal(back["train"].arrays["snr"], ARRAYS["snr"])
    with refused("b: expected loads, got samples whose loads are not"):
        _ = back["cut"].loads


def test_a_disk_that_fills_leaves_the_old_file(path):
    old, usual = path.read_bytes(), resource.getrlimit(resource.RLIMIT_FSIZE)
    for most in range(0, len(old), 2000):
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, usual[1]))
        try:
            with pytest.raises(OSError, match="File too large"):
                save_dataset(path, DATA)
            with refused("cannot be written"):
                write_arrays(path, {"u": ones(len(old))}, {})
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, usual)
        assert ([*path.parent.iterdir()], path.read_bytes()) == ([path], old)


def put(key, value=None, **options):
    """Another array, or a link, in the place of one."""

    def change(file):
        file["train"].pop(key, None)
        if options:
            file["train"].create_dataset(key, **options)
        elif value is not None:
            file["train"][key] = value

    return change


def first(field, value):
    wrong = getattr(LOADS, field).copy()
    wrong[(1,) * wrong.ndim] = value
    return put(field, wrong)


def test_a_wrong_file_is_refused_by_name_before_memory_is_taken(path):
    save_dataset(path.with_name("secret.h5"), DATA)
    in_file = "train/u: expected an array in the file itself"
    for change, words in (
        (attribute("format", "other"), "format: expected 'warp_peri.dataset', got 'other'"),
        (attribute("length_unit", "nm"), "sha256: the contents are not what was written"),
        (first("u", 1.0), "sha256: the contents are not what was written"),
        (lambda file: file.attrs.pop("thickness"), "'thickness' is missing"),
        (attribute("provenance", "{"), "provenance: expected JSON"),
        (attribute("colour", "red"), "attributes: expected none but .*, got 'colour'"),
        (attribute("box_nodes", 5.0, "train"), "set 'train': attributes: .* got 'box_nodes'"),
        (attribute("spacing", -5.0, "train"), "set 'train': spacing: .* got -5.0"),
        (put("x"), "set 'train': arrays missing: x"),
        (put("x", ones((N, 4))), rf"set 'train': x: .*\[N, 3\].* got \[{N}, 4\]"),
        (first("x", nan), r"set 'train': x: expected finite .* nan at index \[1, 1\]"),
        (put("u", ones((3, N - 1, 2))), rf"u: .* got \[3, {N - 1}, 2\]"),
        (put("snr", ones(2)), "snr: expected one entry for each of 3 samples"),
        (lambda file: [file.pop(name) for name in DATA], "at least one point set"),
        (lambda file: file.create_dataset("more", data=[1.0]), "set 'more': arrays missing: x, u"),
        (lambda file: file.create_group("train/more"), "set 'train': more: expected an array"),
        (put("u", h5py.ExternalLink("secret.h5", "/train/u")), in_file + ", got a link"),
        (put("u", shape=(9, 2), dtype="f8", external=[("raw", 0, 144)]), in_file),
        (put("u", shape=(4, 10**9, 2), dtype="f8", chunks=(1, 1000, 2)), "of at most .* bytes"),
    ):
        save_dataset(path, DATA)
        with h5py.File(path, "a") as file:
            change(file)
        tracemalloc.start()
        with refused(words) as caught:
            load_dataset(path)
        assert tracemalloc.get_traced_memory()[1] < 5e7
        tracemalloc.stop()
        assert str(caught.value).startswith(f"{path}: ")


def test_what_is_no_data_set_is_refused_and_one_without_hash_or_units_is_taken(path, tmp_path):
    with refused("nowhere.h5: no such data set"):
        load_dataset(tmp_path / "nowhere.h5")
    for content in (b"x, y\n", path.read_bytes()[:5000]):
        (tmp_path / "other.h5").write_bytes(content)
        with refused("not a readable HDF5 data set"):
            load_dataset(tmp_path / "other.h5")
    with h5py.File(path, "r+") as file:
        for key in ("length_unit", "stress_unit", "sha256"):
            del file.attrs[key]
        put("u", data=LOADS.u, compression="gzip")(file)
    with warned("names no units: taken as Å and TPa"):
        back = load_dataset(path)
    assert back.units == USUAL
    assert_array_equal(back["train"].u, LOADS.u)


def test_what_is_wrong_in_memory_is_refused_by_name():
    nm = replace(LOADS, points=replace(GRID, units=OTHER))
    each_refused(lambda good, change: replace(good, **change), {
        r"x: .*N > 0, got \[0, 2\]": (GRID, {"x": ones((0, 2))}),
        "interior: expected at least one": (GRID, {"interior": zeros(N, bool)}),
        "true for no interior node": (GRID, {"outside": ones(N, bool)}),
        r"axis: expected an angle \[degrees\], got nan": (GRID, {"axis": nan}),
        "axis: expected an angle .* 1e.300": (GRID, {"axis": 1e300}),
        "axis: expected a rotation": (CUBE, {"axis": ones((3, 3))}),
        "arrays: 'u' cannot be the name of an array": (LOADS, {"arrays": {"u": ones(3)}}),
        "k: expected numbers or text, got object": (LOADS, {"arrays": {"k": [None] * len(LOADS)}}),
        r"numbers or text, got \|S1": (LOADS, {"arrays": {"n": [b"\xff"] * len(LOADS)}}),
        "same for all sets, got a in angstrom and TPa, b in":
            (DATA, {"sets": {"a": LOADS, "b": nm}}),
        "sets: 'a/b' cannot be the name of a set": (DATA, {"sets": {"a/b": LOADS}}),
        "a: expected Samples, got Points": (DATA, {"sets": {"a": GRID}}),
    })  # fmt: skip


def test_positions_in_single_precision_are_those_of_their_lattice():
    turned = lattice(9, 6.15, spacing=2.46, angle=0.3, origin=(70.0, -9.0))
    for exact in (turned, Points.sheet((30, 20), 2.46)):
        x, box = np.float32(exact.x), exact.box and np.float32(exact.box)
        points = in_units(Samples(replace(exact, x=x, box=box), 0 * x[None]), OTHER).points
        assert_array_equal(points.lattice.steps, exact.lattice.steps)
        assert_array_equal(*(families_of(p, 2.5 * p.spacing).neighbour for p in (points, exact)))
        with refused("off it"):
            x[7] += 3e-5 if exact.box else 1e-3
            _ = replace(exact, x=x).lattice


def test_the_one_set_or_that_of_the_usual_name_is_meant_where_none_is_named():
    assert DATA.obvious("train") is LOADS
    assert Dataset({"only": LOADS}, 3.35, 2200.0).obvious("train") is LOADS
    assert_refused({
        r"with train, .*; name one, as data\['train'\]": lambda: evaluate(None, DATA),
        "no set 'test' in the data; it has train, bare": lambda: DATA["test"],
    })  # fmt: skip


def test_files_carry_their_units_and_an_argument_converts(tmp_path):
    path = tmp_path / "data.h5"
    arrays = {"wave_vector": 3 * [[1, 1]], "pull": 3 * [[nan, 1]]}
    for units, length, stress in ((OTHER, 10.0, 1e-3), ("ase", 1.0, 0.1602176634)):
        points = replace(GRID, units=units)
        data = Dataset({"a": replace(LOADS, points=points, arrays=arrays)}, 3.35, 2267.0)
        assert data.of_sheet(thickness=6.7)["a"].arrays["pull"][0, 1] == 0.5
        save(path, data)
        assert_array_equal(load(path)["a"].x, LOADS.x)
        found = load(path, units=USUAL)
        samples = found["a"]
        assert (found.units, found.density) == (USUAL, 2267.0)
        assert found.thickness == approx(3.35 * length)
        for field, factor in (("x", length), ("u", length), ("b", stress / length)):
            assert getattr(samples, field) == approx(getattr(LOADS, field) * factor)
        assert samples.spacing == approx(2.5 * length)
        assert samples.arrays["wave_vector"] == approx(1 / length)
        assert samples.arrays["pull"][0, 1] == approx(stress)
    assert factors("si", "metal") == approx((1e10, 1e-5))
    assert_refused({
        "length_unit: .* one of angstrom, nm, .* 'mile'": lambda: load(path, units=("mile", "TPa")),
        "length_unit: .*, got '": lambda: load(path, units=ones((2, 2))),
        "or ase, metal, si, reduced, got 'cgs'": lambda: load(path, units="cgs"),
    })  # fmt: skip
    save(path, replace(DATA, sets={"a": replace(LOADS, points=replace(GRID, units="reduced"))}))
    assert load(path).units == ("sigma", "epsilon/sigma^3")
    with refused("no factor leads from sigma and epsilon/sigma"):
        load(path, units=USUAL)


def test_a_block_has_a_collar_of_two_horizons():
    block = Points.block((6.0, 4.0), 1.0, 2.5)
    assert (block.interior.sum(), block.x.max(0).tolist()) == (7 * 5, [8.0, 7.0])


def test_samples_and_sets_are_taken_apart_as_sequences_and_mappings():
    points = Points.disk(1.0, 1.0, 1.0)
    u = np.arange(3.0)[:, None, None] + zeros((3, *points.x.shape))
    samples = Samples(points, u, -u, {"seed": np.arange(3)})
    assert [one.u[0, 0, 0] for one in samples] == [0, 1, 2]
    some = samples[[2, 0]]
    assert some.arrays["seed"].tolist() == [2, 0]
    assert_array_equal(some.b, -some.u)
    assert_array_equal(samples[u[:, 0, 0] > 0].u, samples[1:].u)
    with refused("samples: expected some of 3"):
        samples["train"]
    data = Dataset({"train": samples}, 1.0, 1.0)
    assert (dict(data), len(data)) == ({"train": samples}, 1)
