"""Notebooks run from their first cell to the last, and print what they show."""

import json
import re
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent.parent.parent / "examples" / "notebooks"
NAMES = [
    pytest.param(path, marks=[pytest.mark.slow] * (path.stem == "crystal"), id=path.stem)
    for path in sorted(FOLDER.glob("*.ipynb"))
]


def shape(text):
    """What is printed, its numbers left out: their last digits are the machine's."""
    return re.sub(r"-?\d[\d.e+-]*", "0", text)


def test_there_are_three():
    assert len(NAMES) >= 3


@pytest.mark.parametrize("path", NAMES)
@pytest.mark.filterwarnings("ignore")
def test_a_notebook_runs_and_prints_what_it_shows(path, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    known = {}
    for number, cell in enumerate(json.loads(path.read_text(encoding="utf-8"))["cells"]):
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), f"{path.name}, cell {number}", "exec"), known)
            shown = "".join(line for output in cell["outputs"] for line in output["text"])
            assert shape(capsys.readouterr().out) == shape(shown)
