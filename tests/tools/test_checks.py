"""What holds the library to its numbers: the record, the table of faults, the benchmark."""

import json
import re
import runpy
import sys

import numpy as np
import pytest

from tests.support import parametrize, refused
from tests.support.problems import normal
from tools import benchmark, frozen, mutants
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
        (("moved", FIELD, FIELD), "equal"), (("moved", FIELD, near), "BEYOND"),
        (("resummed", FIELD, near), "within 1e-12"), (("resummed", FIELD, FIELD[::-1]), "BEYOND"),
        (("resummed", FIELD, FIELD.T), "BEYOND"), (("resummed", FIELD, one), "BEYOND"),
        (("resolved", FIELD, FIELD + 1e-8 * FIELD[::-1]), "within class"),
        (("resolved", FIELD, FIELD + 1e-6 * FIELD[::-1]), "BEYOND"),
        (("refitted", 0.0271479, 0.0271482), "within class"),
        (("refitted", 0.0271479, 0.0272479), "BEYOND"),
        (("proven", 0.00999724, 0.0102), "within class"),
        (("proven", 0.00999724, 0.00999704), "BEYOND"),
        (("residual", 1e-16, 2e-8, 1e-8), "BEYOND"),
        (("moved", "One solution.", "Two solutions."), "BEYOND"),
    ):  # fmt: skip
        assert stands(*given) == expected, given[0]
    assert stands("moved", FIELD, near, same_machine=False) == "within 1e-12"
    assert stands("resolved", FIELD, FIELD * (1 + 1e-9), tightest="resummed") == "BEYOND"


def test_values_of_an_option_typed_twice_add_up():
    options = {"n": ([1, 2], "of steps")}
    assert Options("", options=options).parse_args(["--n", "3", "--n", "4", "5"]).n == [3, 4, 5]


SENSELESS = """
tools/make_hgo.py --jobs 0 | --jobs: expected a number of processes ≥ 1, or -1, got 0
tools/make_hgo.py --out / | --out: expected a folder or a new name, got /
tools/make_hgo.py --nu 1.5 | --nu: expected a number between −1 and ½, got 1.5
tools/make_leaflet.py --uneven 1e308 | --uneven: expected a number from −10 to 10
tools/make_thermal.py --reduction all | --reduction: expected of shared, plain, iota, got all
tools/benchmark.py solve --draw | --draw: expected with front, got solve
tools/make_hgo.py --out a | a.h5: expected a file or a new name, got a folder
examples/own_material.py --out a.h5 | constants.json: is there already; name another folder
examples/branching.py --out a.h5 | damage.png: is there already, and no picture of this job
examples/pressurised_crack.py --growth 3 | --growth: expected 0, or a whole number ≥ 4, got 3
tools/make_frames.py b --noise nan | --noise: expected a number ≥ 0, got nan
tools/make_frames.py a.h5 | has frames already; name another, or --overwrite
tools/mutants.py --only 99999 | --only: expected the number of a fault, got 99999
tools/mutants.py --only 1 --json a.csv | a.csv: expected tests by number of a fault, got [1]
tools/frozen.py check --list --only zzzz | a pattern of some entry, got zzzz; there are bodies
tools/frozen.py check --only ( | --only: expected a pattern
examples/branching.py --spacing 4e-3 --share 2 | step: expected at most
examples/branching.py --out a.csv/b | a.csv/b: cannot be written
examples/waves_to_map.py --side 4 | --side: expected a whole number ≥ 8, got 4
examples/plate_with_hole.py --model {frozen}/crystal.json | model: expected an LPSMaterial
examples/polymer/tables.py nope | table: expected of law, plates
"""
SENSELESS += "\n".join(
    f"{path.relative_to(ROOT)} --nope | error: "
    for path in [*ROOT.glob("examples/**/*.py"), *ROOT.glob("tools/*.py")]
    if path.parent.name == "laws" or "__main__" in path.read_text("utf-8")
)


@parametrize("line", SENSELESS.strip().split("\n"))
def test_what_makes_no_sense_is_refused_at_once(line, here, monkeypatch, capsys):
    words, said = line.format(frozen=ROOT / "tests/frozen").split(" | ")
    (here / "a.h5").mkdir()
    for name in ("frame00.csv", "constants.json", "damage.png"):
        (here / "a.h5" / name).touch()
    (here / "a.csv").write_text("[1]")
    monkeypatch.setattr(sys, "argv", words.split())
    with pytest.raises(SystemExit, match="2"):
        runpy.run_path(str(ROOT / sys.argv[0]), run_name="__main__")
    assert said in capsys.readouterr().err


def test_a_tree_that_fails_catches_no_fault(here, monkeypatch):
    (here / "found.json").write_text('{"1": ""}')
    monkeypatch.setattr(mutants, "caught_by", lambda tests, root: "a test")
    monkeypatch.setattr(sys, "argv", ["", "--json", "found.json", "--only", "1"])
    with pytest.raises(SystemExit, match="without a fault: a test"):
        mutants.main()


def test_a_part_of_the_record_is_written_where_all_was(here, monkeypatch):
    monkeypatch.setattr(frozen, "RECORD", here / "record.json")
    monkeypatch.setattr(frozen, "CASES", {"one": lambda: iter([("force", "moved", FIELD)])})
    every, part, none = map(re.compile, ("", "force", "zzzz"))
    assert frozen.record(every) == frozen.record(part) == 0
    with refused("only: expected a pattern of some entry, got zzzz"):
        frozen.record(none)
    monkeypatch.setattr(frozen, "machine", lambda: {"processor": "another"})
    with refused("only: expected the record's machine"):
        frozen.record(part)


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
def test_subcommands_of_the_benchmark_run_and_a_wrong_rival_is_found(what, capsys, threads):
    if what == "breaking":
        pytest.importorskip("numba", reason="pip install 'warp_peri[bench]'")
    assert benchmark.main([what, "--quick"]) == 0
    assert capsys.readouterr().out
    with pytest.raises(RuntimeError, match="two is wrong by"):
        benchmark.report("x", {"one": lambda: np.ones(3), "two": lambda: np.zeros(3)}, 1, 1, 1e-9)
