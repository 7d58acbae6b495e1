"""Data walks one way: a file imports only what stands below it."""

import ast
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent / "warp_peri"
FLOORS = (
    ("errors",),
    ("launch", "files", "cluster", "shown"),
    ("kernels",),
    ("points",),
    ("contract",),
    ("core",),
    ("sources", "lps"),
    ("stability",),
    ("regression",),
    ("transfer",),
    ("statics", "dynamics"),
    ("damage", "micromodulus", "edges"),
    ("third_order", "tissue"),
    ("learning", "diffusion", "neural", "dressed", "prediction", "structures", "ranks"),
    ("choice", "plots", "export", "flow", "problems"),
    ("solving", "storage"),
    ("atoms", "methods", "proofs", "shapes", "transfers"),
    ("verification",),
    ("cli",),
)
FLOOR = {name: number for number, names in enumerate(FLOORS) for name in names}


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


@pytest.mark.parametrize("path", modules(), ids=str)
def test_a_file_imports_only_what_stands_below(path):
    own = path.with_suffix("").parts[0]
    for names in imported(path):
        assert names[0] == own or FLOOR[names[0]] < FLOOR[own], f"{path} imports {names}"


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


def test_the_way_through_the_wings_is_short():
    """The longest chain of wings that import one another."""
    wings = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    links = {wing: set() for wing in wings}
    for path in modules():
        if path.parts[0] in wings:
            links[path.parts[0]] |= {n[0] for n in imported(path)} & wings - {path.parts[0]}
    depth = {}
    for wing in TopologicalSorter(links).static_order():
        depth[wing] = 1 + max((depth[below] for below in links[wing]), default=0)
    assert max(depth.values()) <= 11
