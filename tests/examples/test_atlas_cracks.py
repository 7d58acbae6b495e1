"""Entries of the stability atlas about cracks, on small bodies."""

import matplotlib.pyplot as plt
import pytest

from examples.studies.atlas_cracks import (
    broken_kernels,
    edge_tips,
    in_space,
    long_steps,
    misjudged_stretch,
)
from tests.support.problems import kernel


def test_a_broken_learned_kernel_is_indefinite_and_a_positive_one_is_not():
    entry = broken_kernels(kernel("sign-changing", 3.0), spacing=1.0, cells=20)
    assert max(entry.values["negative"]["K = 1/r"]) == 0
    assert entry.values["negative"]["learned"][0] == 0
    assert entry.values["negative"]["learned"][-1] > 0
    assert "changes sign" in entry.seen[0]
    plt.close(entry.figure)


def test_kernels_that_change_sign_break_in_space_too():
    entry = in_space(cells=10)
    counts = entry.values["negative"]
    assert max(counts["K = 1/r"]) == counts["changes sign"][0] == 0 < counts["changes sign"][-1]
    assert "changes sign" in entry.seen[0]
    for cuts in entry.values["cuts"].values():
        assert cuts[-1] == pytest.approx(1.0, abs=0.02)
    plt.close(entry.figure)


def test_steps_beyond_the_bound_grow():
    entry = long_steps(60)
    assert entry.values["growth"]["1.1"] > 1e3 > 10 > entry.values["growth"]["0.98"]
    plt.close(entry.figure)


@pytest.mark.slow
def test_a_shifted_tip_is_nearer_at_three_spacings():
    entry = edge_tips((6, 13), (2.0, 3.0, 4.0))
    errors = entry.values["errors"]
    for ratio in ("3h", "4h"):
        both = zip(errors[f"{ratio}, as cut"], errors[f"{ratio}, shifted"])
        assert all(0 < shifted < 0.7 * plain for plain, shifted in both)
    assert "three lengths or more" in entry.seen[0]
    plt.close(entry.figure)


@pytest.mark.slow
def test_stretches_are_misjudged():
    entry = misjudged_stretch(cells=8, length=1)
    assert entry.values["ratios"]["1.0"] > 1.1
    assert "at rest" in entry.seen[0]
    plt.close(entry.figure)
