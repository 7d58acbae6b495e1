"""Calculators of forces by what is typed for them, or stands in a file of settings."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import inspect
import os
import re
import site
import sys
import sysconfig
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ase.calculators.calculator import BaseCalculator, FileIOCalculator
from ase.calculators.genericfileio import GenericFileIOCalculator

from warp_peri.errors import InputError
from warp_peri.structures.lammps import lammps_calculator

WITHIN = {
    f"ase.calculators.{name}"
    for name in ("acn", "eam", "emt", "idealgas", "lj", "morse", "tip3p", "tip4p")
}
"""Modules of ASE whose classes start no program and load no code, whatever they are given."""
WORD = re.compile(r"[\w+-]*")
"""Text that is no path, no command and no line of a program."""
TRUST = "--trust, or the calculator on the line, takes it"


def named_calculator(
    name: str,
    symbols: Sequence[str],
    potential: str | os.PathLike[str] | None = None,
    *,
    trusted: bool = True,
) -> Any:
    """An ASE calculator by name.

    Args:
        name: "lammps:pair_style sw", or "module:Class" or "module:function" with arguments behind
            it, as "ase.calculators.lj:LennardJones(sigma=3.4, epsilon=0.0104, rc=9.0)". They are
            read as literals. A function says that it returns a calculator, or uses one.
        symbols: of the atoms that it will see.
        potential: file of a LAMMPS potential.
        trusted: whether the name is the user's own. Any other runs no code: it may name classes of
            ASE that compute by themselves, and calculators of installed packages with arguments
            that are numbers or words.

    Raises InputError for a name that leads to no calculator, or to one that is not trusted, before
    anything is called; LammpsError without LAMMPS.
    """
    module, _, call = name.partition(":")
    if module == "lammps":
        return lammps_calculator(call, symbols, potential)
    if potential is not None:
        raise InputError(f"potential: it goes with lammps:…, got {name!r}")
    try:
        path, arguments, options = _parsed(call)
        if module.split(".")[0] in sys.stdlib_module_names:
            raise InputError("Python itself has no calculators")
        if not trusted:
            _check_installed(module)
        made = _found(module, path)
        if not trusted:
            _check_harmless(made, module, [*arguments, options])
        calculator = made(*arguments, **options)
    except Exception as error:  # constructors raise whatever they miss
        raise InputError(
            'calculator: expected lammps:"pair_style …" or module:Class(arguments), as '
            f"ase.calculators.emt:EMT, got {name!r} ({error})"
        ) from None
    if not _offers_forces(calculator):
        raise InputError(f"calculator: {name!r} makes no ASE calculator")
    return calculator


def _parsed(call: str) -> tuple[list[str], list[Any], dict[str, Any]]:
    """The names that lead to what is called, its arguments and its options."""
    tree = ast.parse(call, mode="eval").body
    path, arguments, options = tree, [], {}
    if isinstance(tree, ast.Call):
        path = tree.func
        arguments = [ast.literal_eval(argument) for argument in tree.args]
        options = {str(o.arg): ast.literal_eval(o.value) for o in tree.keywords}
    names = ast.unparse(path).split(".")
    if not all(name.isidentifier() and not name.startswith("_") for name in names):
        raise InputError("expected the name of a class or a function behind the colon")
    return names, arguments, options


def _found(module: str, path: Sequence[str]) -> Any:
    """The class or function that is named; InputError for anything that makes no calculator."""
    made: Any = importlib.import_module(module)
    for part in path:
        made = getattr(made, part)
        if inspect.ismodule(made):
            raise InputError(f"{part} is a module: expected it before the colon")
    if not _makes_calculators(made):
        raise InputError("it is no class of an ASE calculator, nor a function that returns one")
    return made


def _makes_calculators(made: Any) -> bool:
    if inspect.isclass(made):
        return _offers_forces(made)
    if inspect.ismethod(made):  # as Tersoff.from_lammps
        return inspect.isclass(made.__self__) and _offers_forces(made.__self__)
    function = inspect.unwrap(made) if callable(made) else None
    if not inspect.isfunction(function) or "." in function.__qualname__:
        return False
    try:
        returned = typing.get_type_hints(function).get("return")
    except NameError:
        returned = None
    names = function.__code__.co_names
    used = [returned, *(function.__globals__.get(name) for name in names)]
    return any(inspect.isclass(one) and _offers_forces(one) for one in used) or any(
        name.startswith("ase.calculators.")
        for name in names  # imported inside
    )


def _offers_forces(made: Any) -> bool:
    return hasattr(made, "get_property") or hasattr(made, "get_forces")


def _check_installed(module: str) -> None:
    """InputError for a module, not imported yet, that lies in no folder of installed packages."""
    names = module.split(".")
    if not all(name.isidentifier() and not name.startswith("_") for name in names):
        raise InputError("expected the name of a module")
    found = importlib.util.find_spec(names[0])
    origin = Path(found.origin).resolve() if found is not None and found.origin else Path()
    folders = [sysconfig.get_path("purelib"), sysconfig.get_path("platlib")]
    folders += [*site.getsitepackages(), site.getusersitepackages()]
    if not any(Path(folder).resolve() in origin.parents for folder in folders):
        raise InputError(f"{names[0]} is no installed package: {TRUST}")


def _check_harmless(made: Any, module: str, given: Sequence[Any]) -> None:
    """InputError for what could run a program or load code from a file."""
    if not (inspect.isclass(made) and issubclass(made, BaseCalculator)):
        raise InputError(f"it is no class of an ASE calculator: {TRUST}")
    if made.__module__ in WITHIN:
        return
    programs = (FileIOCalculator, GenericFileIOCalculator)
    own = made.__module__.split(".")[0] == module.split(".")[0] != "ase"
    if not own or issubclass(made, programs) or not _only_words(given):
        raise InputError(f"it could run a program or load a file: {TRUST}")


def _only_words(given: Any) -> bool:
    """Whether arguments are numbers, or words that name no file and no command."""
    if isinstance(given, dict):
        return not any("command" in str(key) for key in given) and _only_words([*given.values()])
    if isinstance(given, (list, tuple, set)):
        return all(map(_only_words, given))
    if isinstance(given, str):
        return bool(WORD.fullmatch(given)) and not Path(given).exists()
    return not isinstance(given, bytes)
