"""What holds the library to its numbers: the record, the table of faults, the benchmark."""

import json
import sys
from importlib.util import find_spec

import numpy as np
import pytest

from tests.support import parametrize
from tests.support.problems import normal
from tools import benchmark, entered, frozen
from tools.mutants import NET, ROOT, read_faults, with_fault
from tools.options import Options

FIELD = normal((40, 2))


def stands(kind, before, after, limit=None, **how):
    old, new = (frozen.kept(kind, value, limit) for value in (before, after))
    return frozen.verdict(json.loads(json.dumps(old)), new, **how)[0]


def test_an_entry_of_the_record_is_held_to_its_class():
    near, one = FIELD * (1 + 3e-16), FIELD.copy()
    one[17, 0] += 1e-8  # at a node that was not kept
    for given, expected in (
        (("moved", FIELD, FIELD.copy()), "equal"),
        (("moved", FIELD, near), "BEYOND"),
        (("resummed", FIELD, near), "within 1e-12"),
        (("resummed", FIELD, FIELD[::-1]), "BEYOND"),
        (("resummed", FIELD, FIELD.T), "BEYOND"),
        (("resummed", FIELD, one), "BEYOND"),
        (("resolved", FIELD, FIELD + 1e-8 * FIELD[::-1]), "within class"),
        (("resolved", FIELD, FIELD + 1e-6 * FIELD[::-1]), "BEYOND"),
        (("refitted", 0.0271479, 0.0271482), "within class"),
        (("refitted", 0.0271479, 0.0272479), "BEYOND"),
        (("proven", 0.00999724, 0.0102), "within class"),
        (("proven", 0.00999724, 0.00999704), "BEYOND"),
        (("residual", 1e-16, 2e-8, 1e-8), "BEYOND"),
        (("moved", "One solution.", "Two solutions."), "BEYOND"),
    ):
        assert stands(*given) == expected, given[0]
    assert stands("moved", FIELD, near, same_machine=False) == "within 1e-12"
    assert stands("resolved", FIELD, FIELD * (1 + 1e-9), tightest="resummed") == "BEYOND"


def test_values_of_an_option_typed_twice_add_up():
    options = Options("", options={"sizes": ([1, 2], "of steps")})
    assert options.parse_args([]).sizes == [1, 2]
    assert options.parse_args(["--sizes", "3", "--sizes", "4", "5"]).sizes == [3, 4, 5]


def test_what_fails_is_beyond_and_what_is_absent_is_skipped(monkeypatch):
    def fails():
        yield "force", "resummed", FIELD
        raise ValueError("no stress")

    def absent():
        raise frozen.Absent("no data")
        yield

    entries = {f"{case}: {what}" for case in ("one", "two") for what in ("force", "stress")}
    monkeypatch.setattr(frozen, "CASES", {"one": fails, "two": absent})
    found = frozen.computed(frozen.re.compile(""), entries)
    assert found["one: stress"] == "ValueError: no stress"
    assert found["two: force"] == "skipped: no data"


def test_every_fault_stands_once_in_its_file_and_has_tests():
    faults = read_faults()
    for number, fault in faults.items():
        assert len(set(with_fault(number, fault, ROOT))) == 2
    tests = {test for fault in faults.values() for test in fault["tests"]} | set(NET)
    assert not [test for test in tests if not (ROOT / test).exists()]
    assert len(faults) >= 42
    assert sum(fault.get("blind", False) for fault in faults.values()) >= 10


@parametrize("what", [name for name in benchmark.KINDS if name != "front"])
def test_subcommands_of_the_benchmark_run_at_quick_size(what, capsys, threads):
    if what == "breaking" and find_spec("numba") is None:
        pytest.skip("needs Numba: pip install 'warp_peri[bench]'")
    assert benchmark.main([what, "--quick"]) == 0
    assert capsys.readouterr().out


def test_a_wrong_rival_is_found_and_the_front_is_drawn(tmp_path):
    with pytest.raises(RuntimeError, match="two is wrong by"):
        benchmark.report("x", {"one": lambda: np.ones(3), "two": lambda: np.zeros(3)}, 1, 1, 1e-9)
    benchmark.draw(tmp_path / "front.png")
    assert (tmp_path / "front.png").stat().st_size > 10_000


def test_files_that_a_fit_and_a_solve_enter_are_told(graphene, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["entered", "--data", str(graphene)])
    assert entered.main() == 0
    fit, solve = capsys.readouterr().out.splitlines()
    assert ("fitting/regression.py" in fit, "regression" in solve) == (True, False)
    assert "materials/lps" in solve
