"""What a file beside a run says of the run: every field of points, samples, settings, functions."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import warp_peri as wp
from tests.support.problems import kernel, lattice, manufactured
from warp_peri.files.checkpoint import fingerprint
from warp_peri.tissue.sheet_choice import KeptFits


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
    keys = [KeptFits(None, one, "settings").key for one in (samples(), other)]
    assert keys[0] != keys[1]


def test_where_a_value_stands_and_of_what_kind_it_is_counts():
    base, ones = samples(), np.ones(4)
    parts = [
        (base, None), (None, base), (ones, 2), (ones.reshape(2, 2), 2), (ones.astype(int), 2),
        ([1, 2], 3), ([1], 2, 3), ({"a": 1},), ({"a": 2},), ("1",), (1,), (None,),
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
