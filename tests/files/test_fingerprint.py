"""What a file beside a run says of the run: every field of points, samples, settings, functions."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch
from scipy.interpolate import PchipInterpolator

import warp_peri as wp
from tests.support.problems import kernel, lattice, manufactured
from warp_peri.files.checkpoint import fingerprint


def samples():
    return manufactured(kernel("positive", 2.5), lattice(3, 2.5), 2)


def changed():
    """The samples with one thing changed each, by name."""
    base = samples()
    points = base.points
    x, inside = points.x.copy(), points.interior.copy()
    x[0] += 1e-12
    inside[np.argmax(inside)] = False
    on = {
        "spacing": replace(points, spacing=1.0 + 1e-15),
        "units": replace(points, units=("nm", "GPa")),
        "axis": replace(points, axis=3.0),
        "x": replace(points, x=x),
        "interior": replace(points, interior=inside),
        "outside": replace(points, outside=~np.ones(len(x), bool)),
    }
    found = {name: replace(base, points=other) for name, other in on.items()}
    found |= {"u": replace(base, u=base.u + 1e-15), "b": replace(base, b=None)}
    return found | {"arrays": replace(base, arrays={"snr": np.ones(2)})}


@pytest.mark.parametrize("name", changed())
def test_no_field_of_samples_is_forgotten(name):
    other = changed()[name]
    assert fingerprint(samples()) == fingerprint(samples()) != fingerprint(other)


def test_where_a_value_stands_and_of_what_kind_it_is_counts():
    base, ones = samples(), np.ones(4)
    parts = [
        (base, None), (None, base), (ones, 2), (ones.reshape(2, 2), 2), (ones.astype(int), 2),
        ([1, 2], 3), ([1], 2, 3), ({"a": 1},), ({"a": 2},), ("1",), (1,), (None,),
        (0,), ([],), ("0",), (set(),),
    ]  # fmt: skip
    assert len({fingerprint(*one) for one in parts}) == len(parts)
    assert fingerprint(np.float64(0.1), np.int64(3)) == fingerprint(0.1, 3)
    assert fingerprint(torch.ones(4, dtype=torch.float64)) == fingerprint(ones)
    assert fingerprint(ones[::2]) == fingerprint(ones[:2])


def test_materials_settings_and_functions_count_by_what_they_hold():
    solid = kernel("positive", 2.5)
    assert fingerprint(solid) != fingerprint(replace(solid, mu=solid.mu * (1 + 1e-15)))
    laws = [wp.LPS(2.5, wp.Bernstein(degree)) for degree in (2, 3, 3)]
    marks = [fingerprint(law) for law in laws]
    assert marks[0] != marks[1] == marks[2]

    def above(limit, *also):
        return lambda field: (field > limit).sum() + len(also)

    assert fingerprint(above(0.3)) == fingerprint(above(0.3)) != fingerprint(above(0.4))
    first, second = (lambda field: field.max(), lambda field: field.min())
    assert fingerprint(first) != fingerprint(second)

    class Above:
        def __init__(self, limit):
            self.limit = limit

        def __call__(self, field):
            return (field > self.limit).sum()

    def by(counted):
        return lambda field: counted(field) + 1

    pairs = [
        (by(above(0.3)), by(above(0.4))),
        (Above(0.3), Above(0.4)),
        (Above(0.3).__call__, Above(0.4).__call__),
        (partial(above, 0.3), partial(above, 0.4)),
        (lambda f: sum(x > 1 for x in f), lambda f: sum(x > 2 for x in f)),
    ]
    for one, other in pairs:
        assert fingerprint(one) == fingerprint(one) != fingerprint(other)


def test_a_second_fit_of_the_same_numbers_is_the_same_material():
    solid = kernel("positive", 2.5)
    again = replace(solid, provenance={"seconds": 3.0})
    assert fingerprint(solid) == fingerprint(again)


LIMIT = {"above": 0.3}


def above_a_limit(field):
    return (field > LIMIT["above"]).sum()


class Slotted:
    __slots__ = ("limit",)

    def __init__(self, limit):
        self.limit = limit


def test_what_a_function_reads_and_an_object_holds_counts(monkeypatch):
    first = fingerprint(above_a_limit)
    monkeypatch.setitem(LIMIT, "above", 0.4)
    assert fingerprint(above_a_limit) != first
    x = np.arange(4.0)
    pairs = [
        (Slotted(0.3), Slotted(0.4)),
        (PchipInterpolator(x, x**2), PchipInterpolator(x, x**3)),
        (np.poly1d([1.0, 2.0]), np.poly1d([1.0, 2.0 + 1e-10])),
        (torch.nn.Linear(2, 2), torch.nn.Linear(2, 2)),
        ({1: 0}, {"1": 0}),
        ({1: x, "1": x}, {1: x, "1": 2 * x}),
    ]
    for one, other in pairs:
        assert fingerprint(one) == fingerprint(one) != fingerprint(other)
    assert fingerprint(2100, 20.0, Path("a")) == fingerprint(2100.0, 20, "a")
    assert fingerprint({"most", "largest"}) == fingerprint({"largest", "most"})
    assert fingerprint(torch.ones(2, requires_grad=True)) == fingerprint(torch.ones(2))


def test_the_last_step_is_written_whatever_is_recorded(tmp_path):
    points, path = lattice(6, 2.5), tmp_path / "run.h5"
    how = {"density": 2000.0, "step": 0.003, "checkpoint": path}
    problem = wp.Dirichlet(points, None, np.zeros_like(points.x))
    for steps in (3, 25):
        wp.simulate(kernel("positive", 2.5), problem, steps=steps, **how)
        with h5py.File(path) as file:
            assert json.loads(file["values"][()].tobytes())["steps"] == steps


def test_a_motion_from_rest_is_of_one_material_and_one_crack(tmp_path):
    """A body without displacement or load feels none of its moduli."""
    x = wp.fracture.rectangle_nodes(12.0, 12.0, 1.0)
    points = wp.Points(x, (np.abs(x) < 2).all(axis=1), 1.0)

    def own(mu):
        def energy(E, lam):
            return lam / 2 * E.diagonal(dim1=-2, dim2=-1).sum(-1) ** 2 + mu * (E * E).sum((-1, -2))

        return wp.DensityMaterial.of(energy, points.spacing, {"lam": 0.4})

    linear = wp.LPSMaterial(0.3, 0.4, 1.0, np.ones(1), horizon=2.0, certified_on=(1.0,))
    field = [linear.on(points, mu=0.4 + size * np.sin(x[:, 0]) ** 2) for size in (0.1, 0.2)]
    rest = wp.Dirichlet(points, None, 0 * x)
    cracks = [wp.Cracked(points, cracks=[[(-6.5, 0.0), (tip, 0.0)]]) for tip in (0.0, 3.0)]
    for name, pair in {
        "linear": [(linear, rest), (replace(linear, mu=0.41), rest)],
        "own": [(own(0.7), rest), (own(0.71), rest)],  # the function is in no file
        "field": [(field[0], rest), (field[1], rest)],
        "crack": [(linear, cracks[0]), (linear, cracks[1])],
    }.items():
        how = {"density": 2000.0, "step": 0.001, "checkpoint_every": 1}
        how["checkpoint"] = tmp_path / f"{name}.h5"
        for steps in (2, 3):
            wp.simulate(*pair[0], **how, steps=steps)
        with pytest.raises(wp.InputError, match="expected a checkpoint of this motion"):
            wp.simulate(*pair[1], **how, steps=4)


def test_contents_of_a_checkpoint_are_those_that_were_written(tmp_path):
    path, points = tmp_path / "run.h5", lattice(6, 2.5)
    u = np.where(points.interior[:, None], 0.01 * points.x, 0.0)
    how = {"density": 2000.0, "step": 0.003, "checkpoint": path, "checkpoint_every": 1}
    wp.simulate(kernel("positive", 2.5), wp.Dirichlet(points, None, u), steps=2, **how)
    whole = path.read_bytes()
    with h5py.File(path, "r+") as file:
        file["u"][points.interior] *= 1.5
    with pytest.raises(wp.InputError, match="the contents are not what was written"):
        wp.simulate(kernel("positive", 2.5), wp.Dirichlet(points, None, u), steps=3, **how)
    path.write_bytes(whole)
    with h5py.File(path, "r+") as file:
        del file["u"]
        file.create_dataset("u", (10**11, 2), "f8", chunks=(10, 2))
    with pytest.raises(wp.InputError, match="not a readable checkpoint"):
        wp.simulate(kernel("positive", 2.5), wp.Dirichlet(points, None, u), steps=3, **how)


SCALE, POWERS, SHIFTED = 1.0, np.poly1d([1.0]), partial(np.add, 1.0)


def test_what_a_function_reads_inside_and_through_others_counts(monkeypatch):
    """In a comprehension, of a callable of another module, and of a module's attributes."""

    def scaled(values):
        return sum(SCALE * value for value in values)

    def raised(values):
        return POWERS(values) + SHIFTED(values)

    def of_module(values):
        return cfg.SIZE * values

    cfg = type(np)("cfg")
    cfg.SIZE = 1.0
    for function, where, name, other in (
        (scaled, globals(), "SCALE", 100.0),
        (raised, globals(), "POWERS", np.poly1d([2.0])),
        (raised, globals(), "SHIFTED", partial(np.add, 2.0)),
        (of_module, vars(cfg), "SIZE", 3.0),
    ):
        before = fingerprint(function)
        assert fingerprint(function) == before
        monkeypatch.setitem(where, name, other)
        assert fingerprint(function) != before


def test_an_energy_counts_by_what_it_does_anywhere():
    """Two energies that agree at small strain are not one motion's."""

    def hardening(k):
        def energy(E, mu):
            size = (E * E).sum((-1, -2))
            return mu * size + k * (size - 1e-4).clip(0) ** 2

        return wp.DensityMaterial.of(energy, 2.5, {"mu": 1.0})

    assert fingerprint(hardening(1.0)) == fingerprint(hardening(1.0))
    assert fingerprint(hardening(1.0)) != fingerprint(hardening(2.0))
