"""How much code the library is: one table of budgets, whose sums only fall.

A code line is a line of a Python file below warp_peri (kernels apart) that is neither blank nor
begins with # nor belongs to an import statement or to a string that is a statement; lines of a
table of text beside them count too. Lines can be joined, so tokens are held as well.
`python -m tests.package.test_budget` prints all.
"""

import ast
import io
import re
import tokenize
from collections import Counter
from functools import cache

from tests.support import ROOT

BUDGET = {
    "code lines": 19_169,
    "tokens": 234_997,
    "lines of warp_peri": 30_982,
    "files of warp_peri": 110,
    "lines of kernels": 1_012,
    "lines of warp_peri, kernels, examples and tools": 43_181,
    "lines of the longest file": 540,
    "lines of the longest function": 60,
    "parameters of one function": 10,
    "characters of the longest string": 1_621,
    "class names twice": 0,
    "imports of warp_peri inside functions": 0,
    "asserts in warp_peri": 0,
}
"""Largest allowed sums. Lower them in the commit that makes the library smaller."""
ROOMS = {
    "atoms": 2425,
    "cli": 829,
    "core": 1617,
    "face": 1123,
    "fe_coupling": 675,
    "files": 505,
    "fitting": 1048,
    "fracture": 1416,
    "materials": 4612,
    "neural": 596,
    "points": 1744,
    "prediction": 608,
    "mpi": 455,
    "solvers": 1516,
}
"""Largest allowed code lines of each folder of warp_peri; "face" has the files beside them."""
COUNTED = (tokenize.NAME, tokenize.NUMBER, tokenize.STRING, tokenize.OP)


def files(*folders):
    """Python files below these; kernels/, linked to from warp_peri, is a folder of its own."""
    for folder in folders:
        for path in sorted((ROOT / folder).rglob("*.py")):
            if folder == "kernels" or "kernels" not in path.relative_to(ROOT / folder).parts:
                yield path


def lines(*folders):
    return sum(path.read_bytes().count(b"\n") for path in files(*folders))


@cache
def tree(path):
    return ast.parse(path.read_bytes())


@cache
def every_node():
    return [node for path in files("warp_peri") for node in ast.walk(tree(path))]


def nodes(kind, inside=None):
    """Nodes of a kind in warp_peri, or in one part of it."""
    return (n for n in (ast.walk(inside) if inside else every_node()) if isinstance(n, kind))


@cache
def code_lines(path):
    """Numbers of the code lines of one file."""
    left_out = {
        line
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Import | ast.ImportFrom)
        or (isinstance(node, ast.Expr) and isinstance(getattr(node.value, "value", None), str))
        for line in range(node.lineno, node.end_lineno + 1)
    }
    written = enumerate(path.read_text(encoding="utf-8").split("\n"), 1)
    return {n for n, line in written if line.strip() and line.strip()[0] != "#"} - left_out


def tokens(path):
    """Number of names, numbers, strings and operators that start on code lines of one file."""
    counted = code_lines(path)
    stream = tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline)
    return sum(token.type in COUNTED and token.start[0] in counted for token in stream)


@cache
def rooms():
    """Code lines of each folder of warp_peri."""
    found = Counter()
    for path in files("warp_peri"):
        parts = path.relative_to(ROOT / "warp_peri").parts
        found["face" if len(parts) == 1 else parts[0]] += len(code_lines(path))
    for path in (ROOT / "warp_peri").rglob("*.txt"):  # tables that code reads count as code
        found[path.parent.name] += sum(map(bool, path.read_text("utf-8").split("\n")))
    return found


LATE = re.compile(r"(from|import) (warp_peri|\.)|.*import_module\(['\"]warp_peri")
"""How code that imports the library begins."""


@cache
def sums():
    functions = [*nodes(ast.FunctionDef | ast.AsyncFunctionDef)]
    late = (nodes(ast.Import | ast.ImportFrom | ast.Call, one) for one in functions)
    inner = {node for one in late for node in one if LATE.match(ast.unparse(node))}
    names = Counter(node.name for node in nodes(ast.ClassDef))
    texts = (node.value for node in nodes(ast.Constant) if isinstance(node.value, str))
    longest = max(path.read_bytes().count(b"\n") for path in files("warp_peri"))
    everything = lines("warp_peri", "kernels", "examples", "tools")
    return {
        "code lines": sum(rooms().values()),
        "tokens": sum(tokens(path) for path in files("warp_peri")),
        "lines of warp_peri": lines("warp_peri"),
        "files of warp_peri": len([*files("warp_peri")]),
        "lines of kernels": lines("kernels"),
        "lines of warp_peri, kernels, examples and tools": everything,
        "lines of the longest file": longest,
        "lines of the longest function": max(f.end_lineno - f.lineno + 1 for f in functions),
        "parameters of one function": max(
            len(f.args.posonlyargs + f.args.args + f.args.kwonlyargs) for f in functions
        ),
        "characters of the longest string": max(map(len, texts)),
        "class names twice": sum(count > 1 for count in names.values()),
        "imports of warp_peri inside functions": len(inner),
        "asserts in warp_peri": len([*nodes(ast.Assert)]),
    }


def test_all_stay_within_their_budgets():
    """A new room needs one, and a room that left keeps none."""
    found, allowed = sums() | rooms(), BUDGET | ROOMS
    assert found.keys() == allowed.keys()
    assert {what: size for what, size in found.items() if size > allowed[what]} == {}
    assert sum(ROOMS.values()) <= BUDGET["code lines"]


def test_code_lines_are_counted_as_defined(tmp_path):
    path = tmp_path / "one.py"
    prose = '"""Prose.\n\nMore."""\n\nimport os\nfrom a import (\n    b,\n)\n\n# why\n'
    path.write_text(prose + 'x = [\n    1,  # one\n]\ny = """two\n\nlines"""\n')
    assert code_lines(path) == {11, 12, 13, 14, 16}
    assert tokens(path) == 3 + 2 + 1 + 3


if __name__ == "__main__":
    for name, value in [*sums().items(), *sorted(rooms().items())]:
        print(f"{value:>8,}  {name}")
