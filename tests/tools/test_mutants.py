"""The table of faults fits the library as it is."""

from pathlib import Path

import pytest

from tools.mutants import NET, ROOT, read_faults, with_fault

FAULTS = read_faults()


def test_every_fault_stands_once_in_its_file():
    for number, fault in FAULTS.items():
        text, wrong = with_fault(number, fault, ROOT)
        assert text != wrong
        assert fault["breaks"]


def test_rooms_of_faults_have_tests():
    tests = {test for fault in FAULTS.values() for test in fault["tests"]} | set(NET)
    assert not [test for test in tests if not (ROOT / test).exists()]


def test_ten_faults_or_more_were_chosen_without_the_tests():
    assert len(FAULTS) >= 42
    assert sum(fault.get("blind", False) for fault in FAULTS.values()) >= 10


def test_a_text_that_is_gone_is_told_by_its_number(tmp_path: Path):
    (tmp_path / "file.py").write_text("one, one")
    for old, count in (("one", 2), ("two", 0)):
        fault = {"file": "file.py", "old": old, "new": "three"}
        with pytest.raises(SystemExit, match=f"fault 7: .* got it {count} times"):
            with_fault(7, fault, tmp_path)
