"""How large the library is, and what is written twice: numbers that later changes only lower."""

import ast
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
LARGEST = {
    "lines of warp_peri": 48_153,
    "files of warp_peri": 200,
    "lines of kernels": 5_662,
    "lines of examples and tools": 27_708,
    "lines of tests": 32_175,
    "names of classes that stand twice": 0,
    "imports of warp_peri inside functions": 12,
    "asserts in warp_peri": 0,
}
"""Whoever lowers one writes the new number here."""


def files(*folders):
    """Python files below these; the kernels, which are linked to from warp_peri, are a folder."""
    for folder in folders:
        for path in sorted((ROOT / folder).rglob("*.py")):
            if folder == "kernels" or "kernels" not in path.relative_to(ROOT / folder).parts:
                yield path


def lines(*folders):
    return sum(path.read_bytes().count(b"\n") for path in files(*folders))


def trees():
    return [ast.parse(path.read_bytes()) for path in files("warp_peri")]


def twice():
    """Classes of the library by name, where several have one; private ones too."""
    names = Counter(
        node.name for tree in trees() for node in ast.walk(tree) if isinstance(node, ast.ClassDef)
    )
    return sorted(name for name, count in names.items() if count > 1)


def late(tree):
    """Imports of the library inside functions of a file, each once."""
    found = set()
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            for node in ast.walk(function):
                named = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                if isinstance(node, ast.ImportFrom):
                    named = ["warp_peri" if node.level else str(node.module)]
                if any(name.split(".")[0] == "warp_peri" for name in named):
                    found.add((node.lineno, node.col_offset))
    return len(found)


def counted():
    return {
        "lines of warp_peri": lines("warp_peri"),
        "files of warp_peri": len([*files("warp_peri")]),
        "lines of kernels": lines("kernels"),
        "lines of examples and tools": lines("examples", "tools"),
        "lines of tests": lines("tests"),
        "names of classes that stand twice": len(twice()),
        "imports of warp_peri inside functions": sum(map(late, trees())),
        "asserts in warp_peri": sum(
            isinstance(node, ast.Assert) for tree in trees() for node in ast.walk(tree)
        ),
    }


@pytest.fixture(scope="module")
def count():
    return counted()


@pytest.mark.parametrize("what", LARGEST)
def test_no_more_than_is_written_down(what, count):
    assert count[what] <= LARGEST[what]
