"""The public face."""

import ast
import os
import pickle
import subprocess
import sys
from pathlib import Path

import pytest

import warp_peri

ROOT = Path(__file__).parent.parent.parent
FACE = ast.parse((ROOT / "warp_peri/__init__.py").read_text())


def fresh(code, *options, **environment):
    """What a new interpreter prints for some code."""
    process = subprocess.run(
        [sys.executable, *options, "-c", code],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)} | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    return process.stdout.strip()


def test_every_public_name_is_there_and_documented():
    for name in warp_peri.__all__:
        assert getattr(warp_peri, name).__doc__, name
    assert sorted(warp_peri.__all__) == warp_peri.__all__
    assert len(warp_peri.__all__) <= 32
    assert {*warp_peri.__all__, *warp_peri._MODULES, "__version__"} == set(dir(warp_peri))


def test_every_public_name_is_what_type_checkers_see():
    """Types are read from the imports under TYPE_CHECKING, the objects from another table."""
    imports = [
        (node.module, alias.name)
        for node in ast.walk(FACE)
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("warp_peri.")
        for alias in node.names
    ]
    assert sorted(name for _, name in imports) == warp_peri.__all__
    for module, name in imports:
        value = getattr(warp_peri, name)
        assert value is getattr(sys.modules[module], name)
        assert value.__module__ == module
        assert pickle.loads(pickle.dumps(value)) is value


def test_every_public_module_is_what_type_checkers_see():
    seen = [
        alias.name
        for node in ast.walk(FACE)
        if isinstance(node, ast.ImportFrom) and node.module == "warp_peri"
        for alias in node.names
    ]
    assert tuple(seen) == warp_peri._MODULES
    for name in seen:
        module = getattr(warp_peri, name)
        assert module is sys.modules[f"warp_peri.{name}"]
        assert module.__doc__, name
        for public in getattr(module, "__all__", ()):
            assert getattr(module, public).__doc__, f"{name}.{public}"


def test_the_package_alone_loads_neither_torch_nor_warp():
    code = (
        "import sys, warp_peri; before = set(sys.modules); warp_peri.load; "
        "print(*({'torch', 'warp', 'numpy'} & before), *({'torch', 'warp'} & set(sys.modules)))"
    )
    assert fresh(code) == ""


def test_help_and_info_load_neither_torch_nor_warp():
    code = (
        "import contextlib, io, sys; from warp_peri.cli.main import main\n"
        "for words in (['--help'], ['info', '--help'], ['info', 'nowhere.h5']):\n"
        "    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()):\n"
        "        main(words)\n"
        "    print(*({'torch', 'warp'} & set(sys.modules)))"
    )
    assert fresh(code) == ""


def test_linear_bodies_and_cracks_on_ranks_load_no_torch():
    """Each rank would hold another 185 MB."""
    code = "import sys, warp_peri.ranks.problems; print(*({'torch'} & set(sys.modules)))"
    assert fresh(code) == ""


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'warp_peri' has no attribute 'slove'"):
        _ = warp_peri.slove
    with pytest.raises(ImportError, match="cannot import name 'slove' from 'warp_peri'"):
        from warp_peri import slove  # noqa: F401


def test_a_missing_dependency_is_no_attribute_error():
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "import warp_peri\n"
        "try: warp_peri.fit\n"
        "except ModuleNotFoundError as error: print(error.name)"
    )
    assert fresh(code) == "torch"


def test_input_errors_are_value_errors():
    assert issubclass(warp_peri.InputError, ValueError)


@pytest.mark.parametrize("name", ["kernels", "kernels.lps"])
def test_kernels_refuse_to_be_imported_under_another_name(name):
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, '.'); import {name}"]
    process = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert process.returncode == 1
    assert "ImportError: import warp_peri.kernels, not kernels" in process.stderr


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: warp_peri.fit(None, 20.0), "fit: expected a model: LPS"),
        (lambda: warp_peri.fit(None, horizon=20.0), "fit: expected a model: LPS"),
        (lambda: warp_peri.solve(None, 3), "expected a problem: Dirichlet"),
        (lambda: warp_peri.move(None, 3), "expected a problem that moves"),
        (lambda: warp_peri.save("x.json", 3), "expected a data set or a material, got int"),
    ],
)
def test_a_call_of_something_else_says_what_is_expected(call, message):
    with pytest.raises(warp_peri.InputError, match=message):
        call()
