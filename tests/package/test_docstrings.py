"""Docstrings of the public names: arguments and errors are named, and an example runs."""

import doctest
import inspect
import re
from pathlib import Path

import pytest

import warp_peri as wp

PAGE = Path(__file__).parent.parent.parent / "docs" / "reference" / "api" / "index.md"


@pytest.fixture(scope="module")
def names():
    """What the page of the API says that examples begin with."""
    found: dict = {}
    exec(re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[0], found)
    return found


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", wp.__all__)
def test_the_example_of_a_public_name_runs(name, names, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    example = doctest.DocTestParser().get_doctest(
        getattr(wp, name).__doc__, dict(names), name, None, 0
    )
    assert 1 <= len(example.examples) <= 3
    runner = doctest.DocTestRunner(verbose=False, optionflags=doctest.IGNORE_EXCEPTION_DETAIL)
    said: list[str] = []
    runner.run(example, out=said.append)
    assert not runner.failures, "".join(said)


@pytest.mark.parametrize("name", wp.__all__)
def test_every_argument_of_a_public_name_is_described(name):
    said = inspect.getdoc(getattr(wp, name))
    described = {
        one
        for line in re.findall(r"^    ([\w, ]+): ", said, re.MULTILINE)
        for one in line.split(", ")
    }
    asked = inspect.signature(getattr(wp, name)).parameters
    assert {*asked} <= described


@pytest.mark.parametrize("name", sorted({*wp.__all__} - {"InputError", "Motion"}))
def test_every_public_name_says_what_it_raises(name):
    """But the error itself, and a result that only has fields."""
    assert re.search(r"[Rr]aises? InputError", " ".join(getattr(wp, name).__doc__.split()))
