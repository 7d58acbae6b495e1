"""Code and commands of the pages run as they are printed, and print what stands below them."""

import ast
import re
import runpy
import shlex
from glob import glob
from itertools import chain
from pathlib import Path
from shutil import copytree
from types import SimpleNamespace

import pytest

import warp_peri as wp
from tests.support import ROOT, filterwarnings, parametrize, shared, slow
from tests.support.problems import kernel, lattice, manufactured
from warp_peri.cli.main import main

check = SimpleNamespace(**runpy.run_path(str(ROOT / "docs" / "check.py")))
TEXT = {name.removesuffix(".md"): text for name, text in check.pages().items()}
"""Each page by its path below docs/, without suffix, as "how-to/cracks"."""
TEXT["README"] = (ROOT / "README.md").read_text("utf-8")
FENCED = re.compile(r"^```(\w*)\n(.*?)^```$(?:\n\n```text\n(.*?)^```$)?", re.DOTALL | re.MULTILINE)
"""A block with its language, none for commands, and what stands below it as printed."""
NOT_HERE = (
    r"(make|pip|source|python3 -m venv|\.venv/bin/pip|mpiexec|ase|tail) "
    r"|(\.venv/bin/)?python (examples/|-m pytest)"
)
"""What sets up an environment, is of others, or has a test of its own."""
ELSEWHERE = ("README", "tutorials/graphene")
"""Run by tests/examples, on graphene's own data."""
SLOW = """
how-to/arrays how-to/crystals how-to/error_bars how-to/flow how-to/free_edges how-to/heterogeneous
how-to/horizon how-to/large how-to/lattices how-to/neural how-to/strains how-to/tissue
tutorials/crystal tutorials/dic tutorials/dumps tutorials/torch
"""
"""Pages that take more than some 2 s."""


def commands(block):
    """What a shell block types, a line each, comments taken off."""
    lines = re.sub(r"\\\n\s*", "", block).splitlines()
    return [typed for line in lines if (typed := re.sub(r"(^|\s+)#.*", "", line).strip())]


def code(name):
    """The Python blocks of a page."""
    return [block for language, block, _ in FENCED.findall(TEXT[name]) if language == "python"]


TYPED = {
    name: [line for language, block, _ in FENCED.findall(text) if not language
           for line in commands(block)]
    for name, text in TEXT.items() if not name.startswith("papers/")
}  # fmt: skip
RUN = [
    pytest.param(name, marks=[slow] * (name in SLOW.split()))
    for name in TEXT
    if name not in ELSEWHERE and (code(name) or "warp-peri " in " ".join(TYPED.get(name, [])))
]


def test_pages_import_what_the_api_lists_and_name_what_is_there():
    shown = re.findall(r"^::: (warp_peri\S*)", "\n".join(TEXT.values()), re.MULTILINE)
    for page, text in TEXT.items():
        for node in ast.walk(ast.parse("".join(code(page)))):
            if isinstance(node, ast.Import | ast.ImportFrom):
                modules = [getattr(node, "module", None) or node.names[0].name]
                assert [m for m in modules if m.startswith("warp_peri") and m not in shown] == []
        for name in re.findall(r"`wp\.([\w.]+)\b(?!\.\w)[`(]", text):
            owner = wp
            for part in name.split("."):
                known = hasattr(owner, part) or part in getattr(owner, "__dataclass_fields__", ())
                assert known, f"{page}: {name}"
                owner = getattr(owner, part, None)


@shared
def home(tmp_path_factory):
    """A folder with small data in the place of graphene's, a model, and files of crystals."""
    import ase.build
    import ase.io

    folder, model = tmp_path_factory.mktemp("pages"), kernel("1/r", 12.5, spacing=5.0)
    sets = {}
    for seed, (name, count) in enumerate({"train": 8, "val": 2, "test": 2}.items()):
        s = manufactured(model, lattice(8, 25.0, 5.0), count, seed, wave_number=0.2)
        sets[name] = wp.Samples(s.points, 0.1 * s.u, 0.1 * s.loads, s.arrays)
    data = wp.Dataset(sets, thickness=3.35, density=2200.0)
    for place in ("data/graphene_0K.h5", "DATA.h5"):
        wp.save(folder / place, data)
    for place in ("runs/first/model.json", "runs/graphene_0K/model.json", "MODEL.json"):
        wp.save(folder / place, model)
    ase.io.write(folder / "Al.cif", ase.build.bulk("Al", cubic=True))
    ase.io.write(folder / "MoS2.cif", ase.build.mx2(a=3.16, vacuum=10))
    (folder / "examples").symlink_to(ROOT / "examples")
    return folder


@filterwarnings("ignore")
@parametrize("name", RUN)
def test_a_page_runs_in_turn_and_prints_what_it_shows(name, home, tmp_path, monkeypatch, capsys):
    """Code in the names of blocks before; of what commands print a tutorial shows some lines."""
    home = Path(copytree(home, tmp_path / "home", symlinks=True))
    monkeypatch.chdir(home)
    if name == "tutorials/dumps":
        from examples import own_material

        own_material.make_dumps(home / "runs" / "boron_nitride" / "dumps")
    names = {}
    for language, block, shown in FENCED.findall(TEXT[name]):
        capsys.readouterr()
        if language == "python":
            exec(compile(block, f"{name}.md", "exec"), names)
            assert not shown or capsys.readouterr().out == shown
        elif not language:
            for line in commands(block):
                if line.startswith("warp-peri "):
                    words = [sorted(glob(word)) or [word] for word in shlex.split(line)]  # a shell
                    words += [["--jobs", "1"]] if words[1] == ["sweep"] else []  # in this process
                    assert main([word for found in words for word in found][1:]) == 0, line
            printed = capsys.readouterr().out
            if name.startswith("tutorials/") and printed:
                lines = iter(printed.splitlines())
                for expected in shown.splitlines():
                    begin = expected.removesuffix("…")  # … is some lines, or the end of one
                    said = (
                        o == begin or (begin != expected and o.startswith(begin)) for o in lines
                    )
                    assert any(said), expected


def test_what_is_typed_runs_here_or_is_there():
    for line in chain(*TYPED.values()):
        assert line.startswith("warp-peri ") or re.match(NOT_HERE, line), line
        if script := re.match(r"(?:\.venv/bin/)?python (examples/\S+)(.*)", line):
            source = (ROOT / script[1]).read_text("utf-8")
            assert all(f'"{option}"' in source for option in re.findall(r"--[a-z-]+", script[2]))


def test_pages_keep_the_rules_and_their_size():
    """Links, sentences, tables, pictures, equations, and the menu."""
    assert check.faults() == []
    assert sum(len(text.split()) for text in check.pages().values()) <= 28_000
    assert len(TEXT["README"].split()) <= 600
    assert (ROOT / "CHANGELOG.md").stat().st_size <= 6_000


def test_sentences_links_and_anchors_are_found_as_a_reader_finds_them():
    text = (
        "# One `two`: three\n\nOne [a](b.md#c) two. Two, with $x = 1.5$ in it!\n\n- An item\n"
        "- Another ![p](q.png)\n\n| a | b |\n|---|---|\n| c | d |\n\n## By name {#named}\n\n"
        '<img src="r.png">\n\n$$x \\tag{N1}$$\n\n```\n# no heading\n[no](no.md)\n```\n'
    )
    assert check.sentences(text)[:3] == ["One a two.", "Two, with X in it!", "An item"]
    assert check.tables(text) == [1]
    assert check.links(text) == ["b.md#c", "q.png", "r.png"]
    assert check.anchors(text) == {"one-two-three", "named", "eq-N1"}
