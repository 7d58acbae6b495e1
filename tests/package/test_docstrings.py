"""Examples in the docstrings of the public names: each has one, and it runs."""

import doctest
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
