"""The public face: its names, what is said of them, and what an import loads."""

import ast
import doctest
import inspect
import subprocess
import sys
from functools import partial
from graphlib import TopologicalSorter
from importlib import import_module
from os import environ
from pickle import dumps, loads
from re import DOTALL, MULTILINE, findall, search
from signal import SIGINT

import pytest

import warp_peri as wp
from tests.support import ROOT, filterwarnings, parametrize, shared
from warp_peri.errors import InputError, exit_status

PACKAGE, API = ROOT / "warp_peri", ROOT / "docs" / "reference" / "api"
MODULES = {*dir(wp)} - {*wp.__all__}
SAYS_NO_ERROR = {"InputError", "Motion"}  # the error itself, a result that only has fields


def run(*words, status=0):
    """What a new interpreter prints, on either stream."""
    done = subprocess.run(
        [sys.executable, *map(str, words)], cwd=ROOT, env=environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == status, done.stdout
    return done.stdout.strip()


def test_names_are_those_that_type_checkers_see():
    seen = [
        (node.module, alias.name)
        for node in ast.walk(ast.parse((PACKAGE / "__init__.py").read_bytes()))
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("warp_peri")
        for alias in node.names
    ]
    assert {name for _, name in seen} == {*dir(wp)}
    assert (sorted(wp.__all__), len(wp.__all__) <= 32) == (wp.__all__, True)
    for module, name in seen:
        value = getattr(wp, name)
        assert value is getattr(sys.modules[module], name)
        assert inspect.ismodule(value) or loads(dumps(value)) is value


def test_the_api_lists_every_public_name_and_each_has_a_docstring():
    """Each `:::` of the pages with its members; a public module without members has its __all__."""
    shown = set()
    pages = "\n".join(page.read_text("utf-8") for page in API.glob("*.md"))
    for block in pages.split("\n::: ")[1:]:
        path, _, options = block.split("\n\n")[0].strip().partition("\n")
        members, module = search(r"members: \[(.*)\]", options), import_module(path)
        names = members[1].split(", ") if members else getattr(module, "__all__", vars(module))
        shown |= {id(getattr(module, name)) for name in names}
    for module in (wp, *(getattr(wp, name) for name in MODULES)):
        for name in getattr(module, "__all__", ()):
            assert id(getattr(module, name)) in shown, f"{module.__name__}.{name}"
            assert getattr(module, name).__doc__, name


@shared
def begun():
    """Names of what the page says that examples begin with."""
    page, known = (API / "index.md").read_text("utf-8"), {}
    exec(search(r"```python\n(.*?)```", page, DOTALL)[1], known)
    return known


@filterwarnings("ignore::UserWarning")
@parametrize("name", wp.__all__)
def test_a_docstring_has_arguments_errors_and_an_example_that_runs(name, begun, here):
    said = inspect.getdoc(getattr(wp, name))
    example = doctest.DocTestParser().get_doctest(said, begun, name, None, 0)
    assert 1 <= len(example.examples) <= 3
    printed, runner = [], doctest.DocTestRunner(False, False, doctest.IGNORE_EXCEPTION_DETAIL)
    assert not runner.run(example, out=printed.append).failed, "".join(printed)
    described = ", ".join(findall(r"^    ([\w, ]+): ", said, MULTILINE)).split(", ")
    assert {*inspect.signature(getattr(wp, name)).parameters} <= {*described}
    assert name in SAYS_NO_ERROR or search(r"[Rr]aises? InputError", " ".join(said.split()))


LOADED = "print(*({'torch', 'warp'} & {*sys.modules}))"
QUIET = (
    "import contextlib, io, sys; from warp_peri.cli.main import main\n"
    "for words in (['--help'], ['info', '--help'], ['info', 'nowhere.h5']):\n"
    "    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()),"
    " contextlib.redirect_stderr(io.StringIO()):\n        main(words)\n"
)
MISSING = "import sys; sys.modules['torch'] = None\nimport warp_peri\ntry: warp_peri.LPS\n"


@parametrize(
    ("code", "printed"),
    [
        (f"import sys, warp_peri; warp_peri.load; {LOADED}", ""),
        (QUIET + LOADED, ""),
        ("import sys, warp_peri.mpi.subdomain; print({'torch'} & {*sys.modules})", "set()"),
        (f"{MISSING}except ModuleNotFoundError as error: print(error.name)", "torch"),
    ],
)
def test_what_an_import_loads(code, printed):
    assert run("-c", code) == printed


def test_an_interrupt_while_the_command_is_imported_is_no_traceback():
    rings = (
        "import os, runpy, signal, sys\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "class Rings:\n    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'numpy': os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Rings())\nsys.argv = ['warp-peri', 'certify', 'no such model']\n"
        "runpy.run_module('warp_peri', run_name='__main__')"
    )
    assert run("-c", rings, status=-SIGINT) == ""


def test_an_error_is_one_printable_line_and_a_status(capsys):
    def fails(error):
        raise error

    long = f"x: expected 1\n2\x1b[1m{9000 * 'x'}"
    for error, status, words in (
        (KeyboardInterrupt(), 130, "interrupted; all is kept\n"),
        (InputError(long), 2, "tool: error: x: expected 1 2\\x1b"),
        (OSError("disk\n  full"), 1, "tool: error: disk full\n"),
    ):
        assert exit_status(partial(fails, error), "all is kept", name="tool") == status
        said = capsys.readouterr().err
        assert said.startswith(words)
        assert (said[:-1].isprintable(), len(said) < 2100) == (True, True)
    assert isinstance(InputError(""), ValueError)
    with pytest.raises(AttributeError, match="module 'warp_peri' has no attribute 'slove'"):
        _ = wp.slove


def imported(node):
    """What a tree imports of the package, but for type checkers."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING":
            continue
        if isinstance(child, ast.ImportFrom) and str(child.module).startswith("warp_peri"):
            yield from (f"{child.module}.{alias.name}".split(".")[1:] for alias in child.names)
        yield from imported(child)


def test_imports_have_one_direction_among_folders_and_inside_each():
    links = {}
    for path in PACKAGE.rglob("*.py"):
        room, *inner = path.relative_to(PACKAGE).with_suffix("").parts
        if path.stem in ("__init__", "__main__"):
            continue
        for other, *names in imported(ast.parse(path.read_bytes())):
            assert room != "kernels" or other == "kernels"
            if other != room:
                links.setdefault(room, set()).add(other)
            elif (PACKAGE / room / f"{names[0]}.py").exists() and names[0] != inner[0]:
                links.setdefault((room, inner[0]), set()).add((room, names[0]))
    TopologicalSorter(links).prepare()  # raises CycleError naming the circle
