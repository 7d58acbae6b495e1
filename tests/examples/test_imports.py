"""Scripts import what there is, and nobody imports from where a wheel or a reader has nothing."""

import re
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
STUDIES = ("papers", "speed_accuracy", *(p.stem for p in ROOT.glob("examples/studies/paper_*.py")))
SCRIPTS = (
    *(f"examples.studies.{name}" for name in sorted(STUDIES)),
    *("examples.train_graphene", "examples.predict", "examples.solve_disk", "tools.benchmark"),
    *("examples.polymer.learn", "examples.polymer.channel"),
)
OF_APPLICATIONS = ("flow.md",)
"""Pages of what is run from a clone."""


@pytest.mark.parametrize("name", SCRIPTS)
def test_script_imports(name):
    import_module(name)


def importers(folders, suffix, module):
    """Files below these folders with a line that imports from a module."""
    line = re.compile(rf"^\s*(from|import) {module}\b", re.MULTILINE)
    files = (path for folder in folders for path in (ROOT / folder).rglob(f"*{suffix}"))
    return [path.name for path in files if line.search(path.read_text(encoding="utf-8"))]


def test_nobody_imports_from_tests_and_no_page_from_examples():
    assert not importers(("warp_peri", "examples", "tools", "docs"), ".py", "tests")
    pages = ("docs/how-to", "docs/tutorials", "docs/explanation", "docs/reference", "docs/theory")
    assert set(importers(pages, ".md", "examples")) <= {*OF_APPLICATIONS}
    assert not importers(pages, ".md", "(tests|tools)")
