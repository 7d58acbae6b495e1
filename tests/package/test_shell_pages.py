"""Shell blocks of the pages, in turn, in a folder of their own.

What is typed as `warp-peri …` runs through the command's own `main`. What does not run here stands
in NOT_HERE with its reason; what a page takes as the reader's own is made in GIVEN.
"""

import ast
import re
import shlex
from glob import glob
from pathlib import Path

import meshio
import numpy as np
import pytest

import warp_peri as wp
from examples import own_material
from tests.package.test_pages import ROOT, TEXT, home  # noqa: F401 (a fixture)
from tests.support.plates import plate
from tests.support.problems import lattice, manufactured
from warp_peri.cli.main import main

NOT_HERE = {
    r"(make|pip|source|python3 -m venv|\.venv/bin/pip) ": "sets up an environment",
    r"(\.venv/bin/)?python examples/": "of minutes: a test imports it",
    r"(\.venv/bin/)?python -m pytest": "this very suite",
    r"mpiexec ": "tests/ranks starts it",
    r"(ase|tail) ": "a program of others",
}
CHEAP = ("how-to/arrays", "how-to/export")
"""Pages whose commands take a second; the others are slow."""


def commands(text):
    """What the shell blocks of a page type, a line each, comments taken off."""
    found = re.findall(r"^```(\w*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    joined = [re.sub(r"\\\n\s*", "", block) for language, block in found if not language]
    lines = [line for block in joined for line in block.splitlines()]
    return [typed for line in lines if (typed := re.sub(r"(^|\s+)#.*", "", line).strip())]


TYPED = {
    name: found
    for name, text in TEXT.items()
    if not name.startswith("papers/") and (found := commands(text))
}
ELSEWHERE = ("tutorials/graphene",)
"""Run by tests/examples/test_examples.py, on graphene's own data."""
RUN = {
    name: [line for line in lines if line.startswith("warp-peri ")]
    for name, lines in TYPED.items()
    if name not in ELSEWHERE and any(line.startswith("warp-peri ") for line in lines)
}
FENCED = re.compile(r"^```(\w*)\n(.*?)^```$(?:\n\n```text\n(.*?)^```$)?", re.DOTALL | re.MULTILINE)
"""A block with its language, none for commands, and what stands below it as printed."""


def test_every_command_is_run_or_says_why_not():
    for name, lines in TYPED.items():
        for line in lines:
            known = line.startswith("warp-peri ") or any(re.match(each, line) for each in NOT_HERE)
            assert known, f"{name}: {line}"


def test_scripts_that_pages_type_are_there_with_their_options():
    for name, lines in TYPED.items():
        for line in lines:
            if script := re.match(r"(?:\.venv/bin/)?python (examples/\S+)(.*)", line):
                source = (ROOT / script[1]).read_text(encoding="utf-8")
                for option in re.findall(r"--[a-z-]+", script[2]):
                    assert f'"{option}"' in source, f"{name}: {line}"


def test_scripts_find_the_folders_beside_the_library():
    """Python looks in a script's own folder, not in the one it is started from."""
    for script in [path for top in ("examples", "tools") for path in (ROOT / top).rglob("*.py")]:
        source = script.read_text(encoding="utf-8")
        found = re.search(r"^(from|import) (examples|tools)", source, re.MULTILINE)
        if "__main__" in source and found is not None:
            assert "sys.path.insert(0, " in source[: found.start()], script


def scripts():
    """Paths of the scripts of examples/ that pages type."""
    typed = [
        re.match(r"(?:\.venv/bin/)?python (examples/\S+)", x) for y in TYPED.values() for x in y
    ]
    return sorted({found[1] for found in typed if found})


def test_scripts_that_pages_type_are_run_by_a_test():
    named = set()
    for path in (ROOT / "tests").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("examples"):
                named |= {node.module.split(".")[-1], *(alias.name for alias in node.names)}
            elif isinstance(node, ast.Constant) and re.fullmatch(r"\w+\.py", str(node.value)):
                named.add(Path(node.value).stem)
    assert {Path(script).stem for script in scripts()} - named == set()


def of_atoms(folder):
    import ase.build
    import ase.io

    ase.io.write("Al.cif", ase.build.bulk("Al", cubic=True))
    ase.io.write("MoS2.cif", ase.build.mx2(a=3.16, vacuum=10))


def of_bodies(folder):
    """A learned model, and a plate with a hole as Gmsh writes it."""
    wp.save("runs/graphene_0K/model.json", wp.load("runs/first/model.json"))
    mesh = plate(7.0, 60.0, 10, 48)
    left = [e for e in mesh.parts["sides"] if np.allclose(mesh.middle[e, 0], -60.0)]
    right = [e for e in mesh.parts["sides"] if np.allclose(mesh.middle[e, 0], 60.0)]
    tags = [np.repeat([1, 2], [len(left), len(right)]), np.full(len(mesh.triangles), 9)]
    meshio.Mesh(
        np.column_stack([mesh.x, np.zeros(len(mesh.x))]),
        [("line", mesh.edges[left + right]), ("triangle", mesh.triangles)],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={"left": np.array([1, 1]), "right": np.array([2, 1])},
    ).write("plate.msh", file_format="gmsh22", binary=False)


def of_any(folder):
    Path("MODEL.json").write_bytes(Path("runs/first/model.json").read_bytes())
    Path("DATA.h5").write_bytes(Path("data/graphene_0K.h5").read_bytes())
    r = np.linspace(0.5, 25.0, 50)
    np.savetxt(
        "K.csv", np.column_stack([r, np.exp(-r / 9)]), delimiter=",", header="r,K", comments=""
    )


def of_arrays(folder):
    """The data set that the page's code saves."""
    samples = manufactured(wp.load("runs/first/model.json"), lattice(8, 12.5, 5.0), 8, 0, 0.2)
    wp.save("mine.h5", wp.Dataset({"train": samples}, thickness=3.35, density=2150.0))


GIVEN = {
    "how-to/arrays": of_arrays,
    "how-to/crystals": of_atoms,
    "how-to/export": of_any,
    "how-to/free_edges": of_bodies,
    "how-to/horizon": of_any,
    "tutorials/crystal": of_atoms,
    "tutorials/dumps": lambda of: own_material.make_dumps(of / "runs" / "boron_nitride" / "dumps"),
}


@pytest.mark.parametrize(
    "name", [name if name in CHEAP else pytest.param(name, marks=pytest.mark.slow) for name in RUN]
)
@pytest.mark.filterwarnings("ignore")
def test_the_commands_of_a_page_run_in_turn(name, home, monkeypatch, capsys):  # noqa: F811
    monkeypatch.chdir(home)
    GIVEN.get(name, lambda folder: None)(home)
    run_as_typed(name, capsys)


def run_as_typed(name, capsys):
    """The commands of a page in turn; a tutorial shows lines that they print, in their order."""
    for language, block, shown in FENCED.findall(TEXT[name]):
        printed = ""
        for line in [] if language else commands(f"```\n{block}```"):
            if line.startswith("warp-peri "):
                words = [sorted(glob(word)) or [word] for word in shlex.split(line)]  # as a shell
                words += [["--jobs", "1"]] if words[1] == ["sweep"] else []  # in this process
                status = main([word for found in words for word in found][1:])
                out, error = capsys.readouterr()
                assert status == 0, f"{line}: {error}"
                printed += out
        if name.startswith("tutorials/") and printed:
            lines = iter(printed.splitlines())
            for expected in shown.splitlines():
                assert expected.strip() == "…" or expected in lines, f"{name}: {expected}"
