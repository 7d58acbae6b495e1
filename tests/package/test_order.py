"""Imports have one direction: no circle of files in a folder, none of folders."""

import ast
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent / "warp_peri"


def modules():
    """Every file of the package but the public face, by its place below warp_peri."""
    files = (path.relative_to(ROOT) for path in ROOT.rglob("*.py"))
    return sorted(path for path in files if path.stem not in ("__init__", "__main__"))


ABOVE = ("on", "learn", "save")
"""Methods of a law that name what stands above its numbers: operator, learning and file."""


def walked(node):
    """The tree without those methods, and without what is imported for type checkers alone."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef) and child.name in ABOVE:
            continue
        if isinstance(child, ast.If) and getattr(child.test, "id", "") == "TYPE_CHECKING":
            continue
        yield child
        yield from walked(child)


@cache
def imported(path):
    """What a file imports of the package, as tuples of names below warp_peri."""
    return tuple(names_of(path))


def names_of(path):
    for node in walked(ast.parse((ROOT / path).read_text())):
        if isinstance(node, ast.Import):
            named = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            named = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        yield from (tuple(name.split(".")[1:]) for name in named if name.startswith("warp_peri."))


@pytest.mark.parametrize("wing", sorted(path.parent.name for path in ROOT.glob("*/__init__.py")))
def test_no_circle_inside_a_wing(wing):
    inside = {path.stem: path for path in (ROOT / wing).glob("*.py")}
    links = {
        name: {used[1] for used in imported(path.relative_to(ROOT)) if used[0] == wing} & {*inside}
        for name, path in inside.items()
    }
    TopologicalSorter(links).prepare()  # raises CycleError naming the circle


def test_a_kernel_knows_no_more_than_kernels():
    for path in (ROOT / "kernels").rglob("*.py"):
        assert {names[0] for names in imported(path.relative_to(ROOT))} <= {"kernels"}


def test_no_circle_between_rooms():
    """Folders, and the files beside them, import one another in one direction."""
    links = {}
    for path in modules():
        room = path.with_suffix("").parts[0]
        links.setdefault(room, set()).update({n[0] for n in imported(path)} - {room})
    TopologicalSorter(links).prepare()  # raises CycleError naming the circle
