"""Damaged and hostile data sets and models, made from good ones; see read_files.py."""

import json
import random
import shutil

import h5py
import numpy as np

from tests.support.problems import kernel, lattice, noise
from warp_peri import Dataset, Points, Samples
from warp_peri.points.dataset import content_hash, save_dataset

HOSTILE = (
    "", " ", "\x00", "../../../etc/passwd", "/etc/passwd", "file:///etc/passwd", "NaN", "1e999",
    "\x1b]0;owned\x07", "$(touch owned)", "`touch owned`", "; rm -rf /", "%s%s%s%n", "nil",
    "{0.__class__}", "__import__('os')", "a\nb\r\nc", "\u202eabc", "\ud7ff", "x" * 100_000,
    "<script>", "'; DROP TABLE",
)  # fmt: skip
"""Strings that name files, commands, formats or code."""


def good_data(path):
    """A small data set in a file; returns it."""
    points = lattice(3, 1.0, spacing=2.5)
    u, b = noise(points, 4), noise(points, 4, seed=1)
    ids = {"load_id": np.array(["a", "b", "c", "δ"]), "snr": np.arange(4.0)}
    loads = Samples(points, u, b, ids)
    cloud = Samples(
        Points(np.random.default_rng(0).normal(size=(30, 2)), np.arange(30) < 9, 0.0),
        np.empty((0, 30, 2)),
    )
    data = Dataset({"train": loads, "bare": cloud}, 3.35, 2267.0, {"seed": 1, "L": [1.5, None]})
    save_dataset(path, data)
    return data


def good_model():
    """A model with records."""
    return kernel("sign-changing", 20.0, spacing=5.0)


def truncated(raw, rng):
    return raw[: rng.randrange(len(raw))]


def flipped(raw, rng):
    content = bytearray(raw)
    for _ in range(rng.choice((1, 1, 1, 3, 20))):
        content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    return bytes(content)


def flipped_at_the_front(raw, rng):
    """Flips where HDF5 keeps its structure."""
    content = bytearray(raw)
    for _ in range(rng.choice((1, 2, 5))):
        content[rng.randrange(min(len(content), 4000))] ^= 1 << rng.randrange(8)
    return bytes(content)


def overwritten(raw, rng):
    """A stretch of zeros, ones or noise."""
    content = bytearray(raw)
    first = rng.randrange(len(content))
    length = rng.choice((1, 8, 100, 2000))
    fill = rng.choice((b"\x00", b"\xff", bytes([rng.randrange(256)])))
    content[first : first + length] = fill * len(content[first : first + length])
    return bytes(content)


def appended(raw, rng):
    return raw + rng.randbytes(rng.choice((1, 100, 10_000)))


BYTES = (truncated, flipped, flipped, flipped_at_the_front, flipped_at_the_front, overwritten,
         appended)  # fmt: skip


def edited_data(path, rng):
    """Change a good file through HDF5 itself; its hash goes, lest it be all that is looked at."""
    with h5py.File(path, "a") as file:
        del file.attrs["sha256"]
        group = file["train"]
        name = rng.choice(("x", "u", "b", "interior"))
        kind = rng.randrange(14)
        if kind == 0:  # wrong shapes
            value = group[name][()]
            del group[name]
            shapes = (value[..., :1], value[:1], value.reshape(-1), value[None], value.T)
            group[name] = rng.choice(shapes)
        elif kind == 1:  # what is no number
            value = group[rng.choice("xub")]
            value[(rng.randrange(value.shape[0]),)] = rng.choice((np.nan, np.inf, -np.inf))
        elif kind == 2:  # other units, formats, versions
            key = rng.choice(("length_unit", "stress_unit", "format", "version"))
            file.attrs[key] = rng.choice(("nm", "GPa", "bohr", 2, -1, np.nan, *HOSTILE[1:2]))
        elif kind == 3:
            file.attrs[rng.choice(("thickness", "density"))] = rng.choice(
                (0.0, -1.0, np.nan, np.inf, "thick", [1.0, 2.0])
            )
        elif kind == 4:
            group.attrs["spacing"] = rng.choice((-5.0, np.nan, np.inf, "5", [5.0, 5.0]))
        elif kind == 5:  # petabytes
            del group[name]
            shape = rng.choice(((10**15,), (10**8, 10**8, 2), (10**7, 2), (2**31, 2)))
            group.create_dataset(name, shape, "f8", chunks=tuple(min(n, 1000) for n in shape))
        elif kind == 6:  # a bomb: zeros pack well
            del group[name]
            group.create_dataset(name, data=np.zeros((4_000_000, 2)), compression="gzip")
        elif kind == 7:  # another file's contents
            del group[name]
            group[name] = h5py.ExternalLink("/etc/passwd", "/x")
        elif kind == 8:
            del group[name]
            group.create_dataset(name, (10, 2), "f8", external=[("/etc/passwd", 0, 160)])
        elif kind == 9:
            del group[name]
            layout = h5py.VirtualLayout(shape=(10, 2), dtype="f8")
            layout[:] = h5py.VirtualSource("/etc/passwd", "x", shape=(10, 2))
            group.create_virtual_dataset(name, layout)
        elif kind == 10:  # loops
            group["again"] = rng.choice((h5py.SoftLink("/train"), h5py.SoftLink("/"), group))
        elif kind == 11:
            file.attrs["provenance"] = rng.choice(
                (
                    "[" * 100_0 + "]" * 100_0,
                    "[" * 30_000,
                    '{"a": 1e999999}',
                    "{" * 99,
                    '"',
                    "9" * 9999,
                )
            )
        elif kind == 12:  # other types
            del group[name]
            kinds = (np.array([b"x"] * 9), np.ones(9, "c16"), np.ones((9, 2), "S4"),
                     np.zeros(9, [("a", "f8")]))  # fmt: skip
            group[name] = rng.choice(kinds)
        else:
            del group[name]
            group[name] = rng.choice((h5py.Empty("f8"), 1.0, "text"))


def hostile_data(path, rng):
    """A good data set whose strings are hostile; returns its hash."""
    data = good_data(path)
    words = [text.replace("\x00", "") for text in rng.choices(HOSTILE, k=4)]
    points = data["train"]
    points.arrays["load_id"] = np.array(words)
    record = {rng.choice(HOSTILE): rng.choice(HOSTILE) for _ in range(3)}
    name = rng.choice(
        [text for text in HOSTILE if text.strip(" ") and not set(text) & set("/\x00")]
    )
    sets = {name[:60000]: points, "bare": data["bare"]}
    hostile = Dataset(sets, data.thickness, data.density, record)
    save_dataset(path, hostile)
    return content_hash(hostile)


def mutate(folder, number, seed=0):
    """Mutated files: (path, what was done, contents that count as a correct read)."""
    data_file, model_file = folder / "good.h5", folder / "good.json"
    expected = content_hash(good_data(data_file))
    good_model().save(model_file)
    right_model = json.dumps(json.loads(model_file.read_text()), sort_keys=True)
    for index in range(number):
        rng = random.Random(seed * 1_000_003 + index)
        is_data = index % 3 != 2
        path = folder / f"{index}{'.h5' if is_data else '.json'}"
        shutil.copy(data_file if is_data else model_file, path)
        right = expected if is_data else right_model
        kind = rng.randrange(10)
        if kind < 6 or not is_data:  # values that are none: tests/conformance, of every material
            change = rng.choice(BYTES)
            path.write_bytes(change(path.read_bytes(), rng))
            what = change.__name__
        elif kind == 6:
            right, what = hostile_data(path, rng), "hostile strings"
        else:
            edited_data(path, rng)
            what, right = "edited", None
        yield path, what, right
