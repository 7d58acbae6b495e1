"""Code of the pages runs in turn, imports what the API lists, and prints what stands below it.

Pages in folders run as they are, from their top. Others may take what is the reader's own: it
stands in GIVEN, and by name on the page.
"""

import ast
import builtins
import contextlib
import io
import re
from pathlib import Path

import numpy as np
import pytest

import warp_peri as wp
from tests.support.problems import kernel, lattice, manufactured, periodic, smooth
from tests.support.sheets import NEAREST, hgo_dictionary, square, waves

ROOT = Path(__file__).parent.parent.parent
DOCS = ROOT / "docs"
TEXT = {"README": (ROOT / "README.md").read_text(encoding="utf-8")} | {
    page.relative_to(DOCS).as_posix().removesuffix(".md"): page.read_text(encoding="utf-8")
    for page in sorted(DOCS.rglob("*.md"))
}
"""Each page by its path below docs/, without suffix, as "how-to/dressed"."""
BLOCK = re.compile(r"^```python\n(.*?)^```\n(?:\n```text\n(.*?)^```$)?", re.DOTALL | re.MULTILINE)
BLOCKS = {
    name: found
    for name, text in TEXT.items()
    if not name.startswith("archive/") and (found := BLOCK.findall(text))
}
"""The code of each page, and what stands below it as printed, or nothing."""
ELSEWHERE = ("README", "own_data", "influence", "learning")
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


def own_atoms():
    from ase.build import bulk
    from ase.calculators.emt import EMT

    return wp.micromodulus.from_calculator(bulk("Cu", a=3.59, cubic=True), EMT(), (3, 3, 3))


def of_dressed(home):
    sheet, _ = periodic((12, 12), 5.0)
    field = 0.01 * smooth(sheet.x, 4, wave_number=0.2)
    return {
        "atoms": own_atoms(),
        "samples": wp.Samples(sheet, field, field),
        "density": 1 - 0.02 * np.cos(2 * np.pi * sheet.x[:, 0] / 60.0) ** 2,
    }


def of_noise(home):
    train = wp.load(home / "data" / "graphene_0K.h5")["train"]
    random = np.random.default_rng(0)
    fields = 1e-4 * np.abs(train.u).max() * random.normal(size=(3, *train.u.shape[1:]))
    return {"train": train, "noise": wp.Samples(train.points, fields, np.zeros_like(fields))}


def of_tissue(home):
    """A small sheet of the published energy, and frames of a sheet with fibres."""
    terms = (wp.tissue.Term("plane_stress"), wp.tissue.Term("fibre_exponential", 1.1, 2.0))
    solid = wp.tissue.HyperelasticSolid(
        wp.tissue.Dictionary(3.0, (), NEAREST, terms), np.array([0.1] * 4 + [0.05, 0.15]), 0.1
    )
    points = square(5)
    bent = points.x @ np.array([[0.25, 0.05], [0.0, 0.2]])
    edges = np.array([bent + waves(points, 0.25, seed) for seed in range(4)])
    u = np.array([wp.solve(solid, wp.Dirichlet(points, None, field)).u for field in edges])
    train, held_out = wp.Samples(points, u[:3]), wp.Samples(points, u[3:])
    rows = "\n".join(",".join(map(str, row)) for row in np.hstack([points.x, u[0]]))
    (home / "frames").mkdir(exist_ok=True)
    (home / "frames" / "a.csv").write_text("x,y,u,v\n" + rows + "\n")
    hgo = wp.tissue.HyperelasticSolid(
        hgo_dictionary(), np.array([0.3] * 4 + [0.07, 0.08, 0.2]), 0.1
    )
    big = square(9)
    loads = [0.05 * waves(big, 1.0, seed) for seed in range(8)]
    held = np.zeros_like(big.x)
    moved = np.array([wp.solve(hgo, wp.Dirichlet(big, load, held)).u for load in loads])
    loaded = wp.Samples(big, moved, np.array(loads) * big.interior[:, None])
    sets = {"train": loaded, "disks": loaded}
    wp.save(home / "data" / "hgo.h5", wp.Dataset(sets, thickness=1.0, density=1000.0))
    rose = wp.tissue.rose(8, (2.0, 4.0))
    return {
        "train": train,
        "rose_dictionary": wp.tissue.Dictionary(3.0, (), NEAREST, (terms[0], *rose)),
        "frames_of_another_sheet": train,
        "held_out": held_out,
    }


GIVEN = {"tissue": of_tissue, "dressed": of_dressed, "noise": of_noise}
SHORTER = {"neural": ("epochs=150", "epochs=1")}
"""What would take hours or richer data, and what runs in its place."""
# Pages that take more than some 5 s.
SLOW = (
    "tissue", "atoms", "nonlinear", "neural", "noise", "dressed",
    "how-to/free_edges", "how-to/lattices", "how-to/error_bars",
    "how-to/pressure", "how-to/flow", "how-to/other_codes",
)  # fmt: skip


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
def test_the_blocks_of_a_page_run_in_turn(name, home, tmp_path, monkeypatch):
    """Each in the names of those before; what it prints is what the page shows below it."""
    names = {}
    if "/" in name:
        (tmp_path / "examples").symlink_to(ROOT / "examples")
        monkeypatch.chdir(tmp_path)
    else:
        monkeypatch.chdir(home)
        names = GIVEN[name](home) if name in GIVEN else {}
    missing = undefined([block for block, _ in BLOCKS[name]])
    assert set(missing) == set(names), (
        "what a page does not define is the reader's, and is in GIVEN"
    )
    prose = re.sub(r"```.*?```", "", TEXT[name], flags=re.DOTALL)
    for given in missing:
        assert re.search(rf"`{given}`", prose), f"{name}: nobody says what {given} is"
    for block, shown in BLOCKS[name]:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(block.replace(*SHORTER.get(name, ("", ""))), f"{name}.md", "exec"), names)
        assert not shown or printed.getvalue() == shown, f"{name}: it printed {printed.getvalue()}"


def test_pages_that_say_how_show_what_comes_out():
    for name in BLOCKS:
        if name.startswith(("tutorials/", "how-to/")):
            assert any(shown for _, shown in BLOCKS[name]), name
