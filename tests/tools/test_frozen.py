"""The record of the library's numbers: what it notices, and that the numbers are still the same."""

import json

import numpy as np
import pytest

from tools import frozen

FIELD = np.random.default_rng(0).normal(size=(40, 2))


def stands(kind, before, after, limit=None, **how):
    old, new = (frozen.kept(kind, value, limit) for value in (before, after))
    return frozen.verdict(json.loads(json.dumps(old)), new, **how)[0]


@pytest.mark.parametrize(
    ("kind", "before", "after", "expected"),
    [
        ("moved", FIELD, FIELD.copy(), "equal"),
        ("moved", FIELD, FIELD * (1 + 3e-16), "BEYOND"),
        ("resummed", FIELD, FIELD * (1 + 3e-16), "within 1e-12"),
        ("resummed", FIELD, FIELD * (1 + 1e-11), "BEYOND"),
        ("resummed", FIELD, FIELD[::-1], "BEYOND"),
        ("resummed", FIELD, FIELD.T, "BEYOND"),
        ("resolved", FIELD, FIELD + 1e-8 * FIELD[::-1], "within class"),
        ("resolved", FIELD, FIELD + 1e-6 * FIELD[::-1], "BEYOND"),
        ("refitted", 0.0271479, 0.0271482, "within class"),
        ("refitted", 0.0271479, 0.0272479, "BEYOND"),
        ("proven", 0.00999724, 0.0102, "within class"),
        ("proven", 0.00999724, 0.00999704, "BEYOND"),
        ("residual", 1e-16, 9e-9, "within class"),
        ("residual", 1e-16, 2e-8, "BEYOND"),
        ("moved", "One solution.", "One solution.", "equal"),
        ("moved", "One solution.", "Two solutions.", "BEYOND"),
        ("resummed", 0.0, 1e-30, "BEYOND"),
    ],
)
def test_an_entry_is_held_to_its_class(kind, before, after, expected):
    assert stands(kind, before, after, 1e-8 if kind == "residual" else None) == expected


def test_a_change_at_one_node_that_was_not_kept_is_seen():
    for node in range(len(FIELD)):
        one = FIELD.copy()
        one[node, 0] += 1e-8
        assert stands("resummed", FIELD, one) == "BEYOND"


def test_bits_are_asked_for_on_the_machine_of_the_record_and_classes_can_be_tightened():
    near = FIELD * (1 + 3e-16)
    assert stands("moved", FIELD, near, same_machine=False) == "within 1e-12"
    assert stands("resolved", FIELD, near, tightest="moved") == "BEYOND"
    assert stands("resolved", FIELD, near, tightest="resummed") == "within 1e-12"
    assert stands("resolved", FIELD, FIELD * (1 + 1e-9), tightest="resummed") == "BEYOND"


def test_what_is_missing_or_fails_is_beyond_and_what_is_absent_is_skipped(monkeypatch):
    def fails():
        yield "force", "resummed", FIELD
        raise ValueError("no stress")

    def absent():
        raise frozen.Absent("no data")
        yield

    entries = {f"{case}: {what}" for case in ("one", "two") for what in ("force", "stress")}
    monkeypatch.setattr(frozen, "CASES", {"one": fails, "two": absent})
    found = frozen.computed(frozen.re.compile(""), entries)
    assert found["one: force"]["shape"] == [40, 2]
    assert found["one: stress"] == "ValueError: no stress"
    assert found["two: force"] == "skipped: no data"
