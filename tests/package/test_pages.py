"""Code of the pages runs in turn, imports what the API lists, and prints what stands below it.

Pages run as they are, from their top.
"""

import ast
import builtins
import contextlib
import io
import re
from pathlib import Path

import pytest

import warp_peri as wp
from tests.support.problems import kernel, lattice, manufactured

ROOT = Path(__file__).parent.parent.parent
DOCS = ROOT / "docs"
TEXT = {"README": (ROOT / "README.md").read_text(encoding="utf-8")} | {
    page.relative_to(DOCS).as_posix().removesuffix(".md"): page.read_text(encoding="utf-8")
    for page in sorted(DOCS.rglob("*.md"))
}
"""Each page by its path below docs/, without suffix, as "how-to/cracks"."""
BLOCK = re.compile(r"^```python\n(.*?)^```\n(?:\n```text\n(.*?)^```$)?", re.DOTALL | re.MULTILINE)
BLOCKS = {name: found for name, text in TEXT.items() if (found := BLOCK.findall(text))}
"""The code of each page, and what stands below it as printed, or nothing."""
ELSEWHERE = ("README", "tutorials/graphene")
"""Run by tests/examples/test_examples.py and test_docs.py, which look at what comes out."""
PUBLIC = {
    name
    for page, text in TEXT.items()
    if page.startswith(("api", "reference/api/"))
    for name in re.findall(r"^::: (warp_peri\S*)", text, re.MULTILINE)
}
HORIZON, WIDEST = 12.5, 25.0
"""Of the model that the data are made with, and of the laws that pages learn from them [Å]."""


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A folder with small data in the place of graphene's, and a model."""
    folder = tmp_path_factory.mktemp("pages")
    model = kernel("1/r", HORIZON, spacing=5.0)
    sets = {
        name: manufactured(model, lattice(8, WIDEST, 5.0), count, seed, wave_number=0.2)
        for seed, (name, count) in enumerate({"train": 8, "val": 2, "test": 2}.items())
    }
    sets = {
        name: wp.Samples(s.points, 0.1 * s.u, 0.1 * s.loads, s.arrays) for name, s in sets.items()
    }
    wp.save(folder / "data" / "graphene_0K.h5", wp.Dataset(sets, thickness=3.35, density=2200.0))
    wp.save(folder / "runs" / "first" / "model.json", model)
    (folder / "examples").symlink_to(ROOT / "examples")
    return folder


SLOW = (
    "how-to/arrays", "how-to/crystals", "how-to/error_bars", "how-to/flow",
    "how-to/free_edges",
    "how-to/heterogeneous", "how-to/horizon", "how-to/large", "how-to/lattices", "how-to/neural",
    "how-to/strains", "how-to/tissue", "tutorials/crystal", "tutorials/torch",
)  # fmt: skip
"""Pages that take more than some 2 s."""


def undefined(blocks):
    """Names that the blocks of a page read and nobody has defined before, in turn."""
    known, missing = {*dir(builtins)}, []
    for block in blocks:
        tree = ast.parse(block)
        bound = {
            node.id
            for node in ast.walk(tree)
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
        }
        for node in ast.walk(tree):
            if isinstance(node, (ast.Import, ast.ImportFrom)):
                bound |= {(alias.asname or alias.name).split(".")[0] for alias in node.names}
            elif isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                bound.add(node.name)
            elif isinstance(node, ast.arg):
                bound.add(node.arg)
            elif isinstance(node, ast.ExceptHandler) and node.name:
                bound.add(node.name)
        read = {
            node.id
            for node in ast.walk(tree)
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)
        }
        missing += sorted(read - bound - known)
        known |= bound | read
    return missing


@pytest.mark.parametrize("name", BLOCKS)
def test_imports_are_of_what_the_api_lists(name):
    for block, _ in BLOCKS[name]:
        for node in ast.walk(ast.parse(block)):
            modules = [node.module] if isinstance(node, ast.ImportFrom) else []
            if isinstance(node, ast.Import):
                modules = [alias.name for alias in node.names]
            for module in modules:
                assert not str(module).startswith("warp_peri") or module in PUBLIC, module


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name
        for name in BLOCKS
        if name not in ELSEWHERE
    ],
)
@pytest.mark.filterwarnings("ignore")
def test_the_blocks_of_a_page_run_in_turn(name, tmp_path, monkeypatch):
    """Each in the names of those before; what it prints is what the page shows below it."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    assert undefined([block for block, _ in BLOCKS[name]]) == []
    names = {}
    for block, shown in BLOCKS[name]:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(block, f"{name}.md", "exec"), names)
        assert not shown or printed.getvalue() == shown, f"{name}: it printed {printed.getvalue()}"


def test_pages_that_say_how_show_what_comes_out():
    for name in BLOCKS:
        if name.startswith(("tutorials/", "how-to/")):
            assert any(shown for _, shown in BLOCKS[name]), name
