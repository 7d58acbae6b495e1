"""What a file beside a run says of the run: every field of points, samples, settings, functions."""

import json
import os
import random
from collections import defaultdict, deque
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial, update_wrapper
from pathlib import Path
from types import FunctionType, SimpleNamespace
from typing import Protocol

import h5py
import numpy as np
import torch
from scipy.interpolate import PchipInterpolator
from scipy.sparse import eye_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

import warp_peri as wp
from tests.support.problems import OTHER, kernel, lattice, manufactured, on_interior, within
from tests.support.told import refused
from warp_peri.files.checkpoint import AllNodes, ArrayFile, RunFile, fingerprint


def differ(one, other):
    """Each is the same as itself, and not as the other."""
    assert fingerprint(one) == fingerprint(one) != fingerprint(other)


def test_no_field_of_samples_is_forgotten():
    base = manufactured(kernel("positive", 2.5), lattice(3, 2.5), 2)
    points, x, inside = base.points, base.x.copy(), base.interior.copy()
    x[0] += 1e-12
    inside[np.argmax(inside)] = False
    of_points = {"spacing": 1.0 + 1e-15, "units": OTHER, "axis": 3.0, "x": x}
    of_points |= {"interior": inside, "outside": np.zeros(len(x), bool)}
    changed = [{"points": replace(points, **{name: one})} for name, one in of_points.items()]
    for other in (*changed, {"u": base.u + 1e-15}, {"b": None}, {"arrays": {"snr": np.ones(2)}}):
        differ(base, replace(base, **other))
    assert fingerprint(replace(base)) == fingerprint(base)
    parts = [(base, None), (None, base), (base,)]
    assert len({fingerprint(*one) for one in parts}) == len(parts)


def test_where_a_value_stands_and_of_what_kind_it_is_counts():
    ones = np.ones(4)
    parts = [
        (ones, 2), (ones.reshape(2, 2), 2), (ones.astype(int), 2), ([1, 2], 3), ([1], 2, 3),
        (torch.ones(4, dtype=torch.bfloat16),), (torch.eye(4).to_sparse(),),
        (np.complex128(1 + 2j),), (1 + 3j,), (10**400,),
        ({"a": 1},), ({"a": 2},), ("1",), (1,), (None,), (0,), ([],), ("0",), (set(),), (-0.0,),
        *((defaultdict(kind),) for kind in (int, float)), (np.longdouble(1) / 3,), (1 / 3,),
        *((np.timedelta64(1, unit),) for unit in "sm"), (memoryview(b"1"),), (b"1",),
        *((memoryview(ones).cast("B").cast(kind),) for kind in "Bq"),
    ]  # fmt: skip
    assert len({fingerprint(*one) for one in parts}) == len(parts)
    for same in (
        [(np.float64(0.1), np.int64(3)), (0.1, 3)],
        [(2100, 20.0, Path("a")), (2100.0, 20, "a")],
        [{"most", "largest"}, {"largest", "most"}],
        [torch.ones(4, dtype=torch.float64), torch.ones(4, dtype=float, requires_grad=True), ones],
        [ones[::2], ones[:2], ones[:2].astype(">f8")],
    ):
        assert len({*map(fingerprint, same)}) == 1


def above(limit, *also):
    return lambda field: (field > limit).sum() + len(also)


class Above:
    __slots__ = ("limit",)

    def __init__(self, limit):
        self.limit = limit

    def __call__(self, field):
        return (field > self.limit).sum()


class Filled:
    @cached_property
    def made(self):
        return 1


def heir(count):
    """An object whose class inherits its call, which reads a property."""
    above = {"__call__": lambda self, field: self.counted(field), "counted": property(count)}
    return type("Heir", (type("Base", (), above | {"__module__": __name__}),), {})()


class OfC(partial):
    """Of the user's, with an attribute beside what C keeps."""

    label = property(lambda self: 1)


class Bounded(torch.Tensor):
    """With an attribute beside its numbers."""


class Noise(random.Random):
    made = Filled.__dict__["made"]


def wrapped(*given):
    return update_wrapper(partial(above, *given), above)


class Gained(SimpleNamespace):
    content = dict


def of_class(law):
    """An object of a data class that holds a law, which no field does."""
    return dataclass(type("Of", (), {"law": law, "__module__": __name__}))()


def hardening(k, horizon=2.5):
    """An energy; two of them agree at small strain."""

    def energy(E, mu):
        size = (E * E).sum((-1, -2))
        return mu * size + k * (size - 1e-4).clip(0) ** 2

    return wp.DensityMaterial.of(energy, horizon, {"mu": 1.0})


def test_materials_settings_functions_and_objects_count_by_what_they_hold():
    solid, x = kernel("positive", 2.5), np.arange(4.0)

    filled = Filled()
    assert filled.made == 1
    for last, two in enumerate(rings := [([1], [2]), ([1], [2])]):
        two[0].append(two[1])
        two[1].append(two[last])

    for pair in (
        (solid, replace(solid, mu=solid.mu * (1 + 1e-15))),
        (hardening(1.0), hardening(2.0)),
        (lambda field: field.max(), lambda field: field.min()),
        (lambda *, low, high: high - low, lambda *, high, low: low - high),
        *((np.ma.array(x, mask=x > of) for of in (0, 1)),),
        [vars(one := Bounded(x)).update(limit=of) or one for of in (1, 2)],
        (heir(lambda self: np.min), heir(lambda self: np.max)),
        *((type("Of", (), {"limit": of, "__module__": __name__})() for of in (x, 2 * x)),),
        (Above(0.3).__call__, Above(0.4).__call__),
        (lambda f: sum(x > 1 for x in f), lambda f: sum(x > 2 for x in f)),
        (PchipInterpolator(x, x**2), PchipInterpolator(x, x**3)),
        (np.poly1d([1.0, 2.0]), np.poly1d([1.0, 2.0 + 1e-10])),
        (torch.nn.Linear(2, 2), torch.nn.Linear(2, 2)),
        ({1: 0}, {"1": 0}),
        ({1: x, "1": x}, {1: x, "1": 2 * x}),
        (of_class(Above(1)), of_class(Above(2))),
        (x.dot, (2 * x).dot),
        (wrapped(0.3), wrapped(0.4)),
        (OfC(above, 0.3), OfC(above, 0.4)),
        (Noise(1), Noise(2)),
        (type("B", (bytearray,), {})(b"1"), type("B", (bytearray,), {})(b"2")),
        (lambda *t: t, lambda t: t),
        (lambda t: np.sum(t, axis=0), lambda t: np.sum(t, keepdims=0)),
        (deque([1], 2), deque([1], 3)),
        (lambda **t: t, lambda t: t),
        (Gained(gain=1.0), Gained(gain=2.0)),
        [first for first, _ in rings],
        [FunctionType(above.__code__, {"__name__": of}) for of in ("pytest", "pluggy")],
    ):
        differ(*pair)
    for hidden in (splu(eye_array(2).tocsc()).solve, np.frompyfunc(abs, 1, 1), (n for n in x)):
        assert fingerprint(hidden) != fingerprint(hidden)
    for one, again in (
        (hardening(1.0), hardening(1.0)),
        (Filled(), filled),
        ({1: even, 2: odd}, {2: odd, 1: even}),
        (Sized, Sized),
        (of_class(np), of_class(np)),
        (wrapped(0.3), wrapped(0.3)),
        (Noise(1), Noise(1)),
        (connected_components, connected_components),
        [type("Of", (), {"limit": 1, "__module__": of})() for of in ("__main__", __name__)],
        (solid, replace(solid, provenance={"s": 3.0}, versions={"numpy": "0"}, errors={"E_u": {}})),
    ):
        assert fingerprint(one) == fingerprint(again)


Sized = type("Sized", (Protocol,), {})  # which keeps a cache of its own
even, odd = lambda n: n == 0 or odd(n - 1), lambda n: n > 0 and even(n - 1)
LIMIT, SCALE, POWERS = {"above": 0.3}, 1.0, np.poly1d([1.0])


def test_what_a_function_reads_inside_and_through_others_counts(monkeypatch):
    """In a comprehension, of a callable of another module, and of a module's attributes."""

    def limited(field):
        return (field > LIMIT["above"]).sum()

    def scaled(values):
        return sum(SCALE * value for value in values)

    def raised(values):
        return POWERS(values)

    def of_module(values):
        return cfg.SIZE * cfg.below.larger(values) * np.ones(3)

    cfg, below = type(np)("cfg"), type(np)("cfg.below")
    cfg.SIZE, cfg.below, below.larger = 1.0, below, above(0.3)
    for function, where, name, other in (
        (limited, LIMIT, "above", 0.4),
        (scaled, globals(), "SCALE", 100.0),
        (raised, globals(), "POWERS", np.poly1d([2.0])),
        (of_module, vars(cfg), "SIZE", 3.0),
        (of_module, vars(below), "larger", above(0.4)),
        (limited, vars(limited), "level", 1),
        (lambda _: globals()["SCALE"], globals(), "SCALE", 3.0),
    ):
        before = fingerprint(function)
        assert fingerprint(function) == before
        monkeypatch.setitem(where, name, other)
        assert fingerprint(function) != before
    for not_read in (lambda field: field.mean(), lambda fields: fields["mean"]):
        before = fingerprint(not_read)
        monkeypatch.setitem(globals(), "mean", before)
        assert fingerprint(not_read) == before


def test_arrays_of_another_run_are_told_under_this_key_too(tmp_path):
    one, other = (ArrayFile(tmp_path / "state.h5", key, "") for key in "ab")
    one.write({})
    with h5py.File(one.path, "r+") as file:
        file.attrs["key"] = "b"
    with refused("not what was written"):
        other.read({})


def test_a_motion_from_rest_is_of_one_material_and_one_crack(tmp_path):
    """A body without displacement or load feels none of its moduli."""
    x = wp.fracture.rectangle_nodes(12.0, 12.0, 1.0)
    points = within(x, 2)
    linear = kernel("1/r", 2.0, mu=0.4)
    field = [linear.on(points, mu=0.4 + size * np.sin(x[:, 0]) ** 2) for size in (0.1, 0.2)]
    rest = wp.Dirichlet(points, None, 0 * x)
    cracks = [wp.Cracked(points, cracks=[[(-6.5, 0.0), (tip, 0.0)]]) for tip in (0.0, 3.0)]
    for name, pair in {
        "linear": [(linear, rest), (replace(linear, mu=0.41), rest)],
        "load": [(linear, wp.Dirichlet(points, f * x, 0 * x)) for f in (1e-26, 2e-26)],
        "own": [(hardening(k, 1.0), rest) for k in (0.7, 0.71)],  # the function is in no file
        "field": [(field[0], rest), (field[1], rest)],
        "crack": [(linear, cracks[0]), (linear, cracks[1])],
    }.items():
        how = {"density": 2000.0, "step": 0.001, "checkpoint_every": 1}
        how["checkpoint"] = tmp_path / f"{name}.h5"
        for steps in (2, 3):
            wp.simulate(*pair[0], **how, steps=steps)
        with refused("expected a checkpoint of this motion"):
            wp.simulate(*pair[1], **how, steps=4)


def test_a_checkpoint_has_the_last_step_and_what_was_written(tmp_path):
    path, points = tmp_path / "run.h5", lattice(6, 2.5)
    u = on_interior(points, 0.01 * points.x)

    def run(steps, start=u):
        how = {"density": np.float32(2000.0), "step": 0.003, "steps": steps, "checkpoint": path}
        wp.simulate(kernel("positive", 2.5), wp.Dirichlet(points, None, start), **how)

    for steps, start in ((3, u), (25, np.where(u, u, -0.0))):  # whatever is recorded
        run(steps, start)
        with h5py.File(path) as file:
            values, kind = json.loads(file["values"][()].tobytes()), file.attrs["format"]
        assert values["steps"] == steps
    whole, both = path.read_bytes(), {"u": u, "v": u}
    for wrong, words in (
        ({"data": 1.5 * u, "compression": "gzip"}, "the contents are not what was written"),
        # whose bytes as they lie are addresses
        ({"data": np.full(u.shape, b"text", dtype=h5py.string_dtype())}, "u holds no numbers"),
        ({"shape": (10**11, 2), "dtype": "f8", "chunks": (10, 2)}, "not a readable checkpoint"),
    ):
        path.write_bytes(whole)
        with h5py.File(path, "r+") as file:
            del file["u"]
            file.create_dataset("u", **wrong)
        with refused(words):
            run(26)
    for nodal, changed, words in (  # whose hash fits
        ({"u": u[:, :1], "v": u}, values, "not a readable checkpoint"),
        (both, values | {"steps": "3"}, "steps: expected a whole number"),
        ({"u": u + np.nan, "v": u}, values, "u is no number somewhere"),
        (both, values | {"bent": "x"}, "bent: expected float values"),
        (both, values | {"history": {"time": 1}}, "histories of as many"),
        (both, values | {"history": {"time": ["a"]}}, "time: expected float"),
        (both, values | {"history": {"time": [], "work": [1]}}, "histories of as"),
    ):
        RunFile(path, kind, AllNodes(len(u))).write(nodal, changed)
        with refused(words):
            run(26)
    h5py.File(path, "w").close()
    with refused("got another HDF5 file"):
        run(26)
    path.unlink()
    os.mkfifo(path)
    with refused("expected a file"):
        run(26)
    path.unlink()
    for place in range(8, 400, 7):
        torn = bytearray(whole)
        torn[place] ^= 255
        path.write_bytes(torn)
        with suppress(wp.InputError):  # another error ends the test
            run(26)
