"""How large the library is, and what is written twice: numbers that later changes only lower."""

import ast
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
LARGEST = {
    "lines of warp_peri": 55_343,
    "files of warp_peri": 200,
    "lines of kernels": 5_823,
    "lines of examples and tools": 31_680,
    "lines of tests": 36_841,
    "names of classes that stand twice": 0,
    "imports of warp_peri inside functions": 14,
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


@cache
def trees():
    return [ast.parse(path.read_bytes()) for path in files("warp_peri")]


def twice():
    """Classes of the library by name, where several have one; private ones too."""
    names = Counter(
        node.name for tree in trees() for node in ast.walk(tree) if isinstance(node, ast.ClassDef)
    )
    return sorted(name for name, count in names.items() if count > 1)


def of_library(node):
    """Whether a node is an import of the library, by statement or by importlib."""
    named = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
    if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
        named = [one.value for one in node.args if isinstance(one, ast.Constant)]
    if isinstance(node, ast.ImportFrom):
        named = ["warp_peri" if node.level else str(node.module)]
    return any(name.split(".")[0] == "warp_peri" for name in named)


def late(node, inside=False):
    """How many imports of the library stand inside functions of a tree."""
    inner = inside or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
    below = sum(late(child, inner) for child in ast.iter_child_nodes(node))
    return below + (inside and of_library(node))


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
