"""What files may not do: run code, name other files, claim memory; and what LAMMPS is told."""

import ast
import io
import json
import tracemalloc
import zipfile
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
import pytest

from tests.support.mutations import good_data, good_model
from tools.lammps_session import LammpsSession
from tools.samples import read_sample
from warp_peri import InputError
from warp_peri.core import record
from warp_peri.files.atomic import ArrayFile, read_arrays
from warp_peri.materials.lps import Model
from warp_peri.points.dataset import load_dataset

ROOT = Path(__file__).parent.parent.parent
CODE = [path for folder in ("warp_peri", "kernels", "tools", "examples")
        for path in sorted((ROOT / folder).glob("*.py"))]  # fmt: skip
UNSAFE = {"eval", "exec", "compile", "__import__", "system", "popen", "loads_pickle"}


@pytest.mark.parametrize("path", CODE, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_no_pickle_no_eval_no_shell(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            names = {alias.name for alias in node.names} | {getattr(node, "module", "") or ""}
            modules = {name.split(".")[0] for name in names}
            assert not modules & {"pickle", "cPickle", "dill", "marshal", "shelve"}, node.lineno
        if isinstance(node, ast.Call):
            called = getattr(node.func, "id", "") or getattr(node.func, "attr", "")
            owner = getattr(getattr(node.func, "value", None), "id", "")
            assert called not in UNSAFE or owner == "re", node.lineno
            assert (owner, called) not in {("torch", "load"), ("np", "load"), ("joblib", "load")}
            for word in node.keywords:
                true = isinstance(word.value, ast.Constant) and word.value.value is True
                assert not (word.arg in ("shell", "allow_pickle") and true), node.lineno


@pytest.fixture
def path(tmp_path):
    good_data(tmp_path / "d.h5")
    return tmp_path / "d.h5"


@contextmanager
def little_memory(most=5e7):
    """What runs inside takes no more memory than this at any moment [bytes]."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()


def change_u(path, **options):
    with h5py.File(path, "a") as file:
        del file["train/u"]
        file["train"].create_dataset("u", **options)


@pytest.mark.parametrize(
    "options",
    [
        {"shape": (10**15,), "dtype": "f8", "chunks": (1000,)},
        {"shape": (4, 10**9, 2), "dtype": "f8", "chunks": (1, 1000, 2)},
        {"shape": (4, 225, 2), "dtype": "f8", "chunks": (4, 10**7, 2), "maxshape": (4, None, 2)},
        {"data": np.zeros((10**7, 2)), "compression": "gzip"},
    ],
    ids=["petabytes", "gigabytes", "a chunk", "a bomb"],
)
def test_a_claim_of_memory_is_refused_before_it_is_met(path, options):
    change_u(path, **options)
    words = "train/u: expected arrays of at most .* bytes"
    with little_memory(), pytest.raises(InputError, match=words):
        load_dataset(path)


def test_compressed_data_of_an_honest_size_are_read(path):
    before = load_dataset(path)
    change_u(path, data=before["train"].u, compression="gzip", chunks=True)
    np.testing.assert_array_equal(load_dataset(path)["train"].u, before["train"].u)


def test_nothing_outside_the_file_is_read(path, tmp_path):
    good_data(tmp_path / "secret.h5")
    with h5py.File(path, "a") as file:
        u = file["train/u"][()]
        del file["train/u"]
        file["train/u"] = h5py.ExternalLink("secret.h5", "/train/u")
    with pytest.raises(
        InputError, match="train/u: expected an array in the file itself, got a link"
    ):
        load_dataset(path)
    with h5py.File(path, "a") as file:
        del file["train/u"]
        raw = tmp_path / "raw"
        raw.write_bytes(u.tobytes())
        file["train"].create_dataset("u", u.shape, "f8", external=[(str(raw), 0, u.nbytes)])
    with pytest.raises(InputError, match="train/u: expected an array in the file itself"):
        load_dataset(path)
    with h5py.File(path, "a") as file:
        del file["train/u"]
        layout = h5py.VirtualLayout(shape=u.shape, dtype="f8")
        layout[:] = h5py.VirtualSource("secret.h5", "train/u", shape=u.shape)
        file["train"].create_virtual_dataset("u", layout)
    with pytest.raises(InputError, match="train/u: expected an array in the file itself"):
        load_dataset(path)
    with h5py.File(path, "a") as file:
        file["other"] = h5py.ExternalLink("secret.h5", "/train")
    with pytest.raises(InputError):
        load_dataset(path)


def test_changed_contents_are_noticed_and_a_file_without_a_hash_is_taken(path):
    with h5py.File(path, "a") as file:
        file["train/u"][0, 0, 0] += 1e-12
    with pytest.raises(InputError, match="sha256: the contents are not what was written"):
        load_dataset(path)
    with h5py.File(path, "a") as file:
        del file.attrs["sha256"]
    assert len(load_dataset(path)["train"]) == 4


def test_a_changed_model_is_noticed_and_one_without_a_hash_is_taken(tmp_path, monkeypatch):
    path = tmp_path / "m.json"
    good_model().save(path)
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"mu": 0.81}))
    with pytest.raises(InputError, match="sha256: the contents are not what was written; remove"):
        Model.load(path)
    content.pop("sha256")
    path.write_text(json.dumps(content | {"mu": 0.81}))
    assert Model.load(path).mu == 0.81
    monkeypatch.setattr(record, "LARGEST_FILE", 100)
    with pytest.raises(InputError, match="expected a file of at most 100 bytes"):
        Model.load(path)


def archive(path, **entries):
    """An .npz with raw entries."""
    with zipfile.ZipFile(path, "w") as file:
        for name, raw in entries.items():
            file.writestr(f"{name}.npy", raw)


def npy(value=None, shape=None):
    raw = io.BytesIO()
    if shape is None:
        np.save(raw, value)
    else:
        header = {"descr": "<f8", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(raw, header)
    return raw.getvalue()


@pytest.mark.parametrize(
    "raw",
    [
        npy(shape=(10**15,)),
        npy(shape=(10**6, 10**6)),
        npy(shape=(-1, 2)),
        npy(np.array([{"an": "object"}], dtype=object)),
        npy(np.ones(3)) + b"more",
        npy(np.ones(300))[:-8],
        b"\x93NUMPY\x09\x00",
        b"cos\nsystem\n(S'touch owned'\ntR.",
    ],
    ids=["petabytes", "terabytes", "negative", "object", "more", "less", "version", "pickle"],
)
def test_hostile_archives_are_refused(tmp_path, raw):
    path = tmp_path / "a.npz"
    archive(path, key=raw)
    with little_memory(), pytest.raises(ValueError, match=r".+"):
        read_arrays(path)
    with pytest.raises(InputError, match="not a readable checkpoint"):
        ArrayFile(path, "key", "another run").read(dict)
    with pytest.warns(UserWarning, match="corrupt"):
        assert read_sample(path) is None


def test_a_packed_archive_is_refused(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", a=np.zeros(10**6))
    with pytest.raises(ValueError, match="not packed"):
        read_arrays(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", a=np.arange(5), b=np.array("text"), c=np.float64(2.0))
    arrays = read_arrays(tmp_path / "b.npz")
    assert arrays["a"].tolist() == [0, 1, 2, 3, 4]
    assert (str(arrays["b"]), float(arrays["c"])) == ("text", 2.0)


def test_errors_are_one_printable_line():
    message = str(InputError("set '\x1b]0;owned\x07\u202e': a\nb\x00" + "x" * 9000))
    assert message.isprintable()
    assert len(message) < 2010
    assert message.startswith("set '\\x1b]0;owned\\x07\\u202e': a b\\x00xxx")


@pytest.mark.parametrize("name", ['a"b', "a$(x)", "a\nshell touch owned\n", "a&", "a#b"])
def test_a_potential_whose_path_could_be_read_as_a_command_is_refused(tmp_path, name):
    file = tmp_path / name
    file.write_text("")
    with pytest.raises(ValueError, match="potential: expected a path"):
        LammpsSession(np.zeros((1, 2)), box=None, potential=file)
